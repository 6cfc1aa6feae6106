"""Forces and pressures of contact: on obstacles, and along the surfaces of the gel."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._types import Array, Float
from ..continuation import Path
from ..discretisation import Body
from ..geometry import gap
from ..mechanics import contact_energy, energy_of_points, surface_lengths, surface_points
from .states import of_path


@of_path
def obstacle_force(path: Path) -> Float[Array, "k o 2"]:
    """Total force (k, o, 2) of the gel on each obstacle of the plate, kT/v mm.

    Arguments:

    - `path`: the `Path` of k states on a plate with o obstacles.

    Returns minus the derivative of the energy of each state by the displacement of the obstacle; it
    has derivatives. 0 for a problem without contact.

    Example: docs/howto/contact.md.
    """
    count = len(path.model.cloud.plate.obstacles)
    if not path.problem.has_contact or not count:
        return jnp.zeros((len(path.x), count, 2))
    owner = path.model.contact.obstacles.owner
    models = [
        path.problem.at(value)[0].touching(x).model
        for x, value in zip(path.x, path.value, strict=True)
    ]
    forces = jnp.stack(
        [_primitive_forces(x, model) for x, model in zip(path.x, models, strict=True)]
    )
    return jnp.zeros((len(path.x), count, 2)).at[:, owner].add(forces)


@program(x="n")
def _primitive_forces(x: Float[Array, "n 2"], model: Body) -> Float[Array, "s 2"]:
    """Forces on the primitives of the obstacles, kT/v mm."""
    contact: Any = model.contact

    def energy(by):
        moved = contact.obstacles._replace(
            start=contact.obstacles.start + by, end=contact.obstacles.end + by
        )
        return contact_energy(
            x, dataclasses.replace(model, contact=dataclasses.replace(contact, obstacles=moved))
        )

    return -jax.grad(energy)(jnp.zeros_like(contact.obstacles.start))


@of_path
def total_obstacle_force(path: Path) -> Float[Array, " k"]:
    """Sum (k,) of the magnitudes of the forces on all obstacles, kT/v mm.

    Twice the force of a gel that two walls press.
    """
    square = jnp.sum(obstacle_force(path) ** 2, axis=2)
    return jnp.sum(jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0), axis=1)


@of_path
def leak_area(path: Path) -> Float[Array, " k"]:
    """Open area (k,) between gel and obstacles, mm^2 per mm of depth; 0 if all are touched.

    That is, if the gel touches all of them. Arguments:

    - `path`: the `Path` of k states.

    Returns the sum over the obstacles of the smallest distance of the gel's surface from each
    beyond the range of contact: what is open of a channel whose walls they are. It has derivatives.
    nan for a plate without obstacles.

    Example: design/channel.toml.
    """
    if not path.model.cloud.plate.obstacles:
        return jnp.full(len(path.x), jnp.nan)
    models = [path.problem.at(value)[0].model for value in path.value]
    return jnp.stack([_opening(x, model) for x, model in zip(path.x, models, strict=True)])


def _opening(x, model):
    contact, points = model.contact, surface_points(x, model)
    gaps = jax.vmap(lambda primitive: jnp.min(jax.vmap(gap, (0, None))(points, primitive)))(
        contact.obstacles
    )
    count = len(model.cloud.plate.obstacles)
    return jnp.sum(
        jnp.maximum(jax.ops.segment_min(gaps, contact.obstacles.owner, count) - contact.range, 0.0)
    )


def obstacle_displacement(path: Path) -> Float[np.ndarray, "k o 2"]:
    """Displacement (k, o, 2) of each obstacle by the control in a path's states, mm; NumPy."""
    found = np.zeros((len(path.x), len(path.model.cloud.plate.obstacles), 2))
    if path.problem.changes.obstacles:
        for state, value in zip(found, path.value, strict=True):
            for number, vector in path.control(value, path.gel).obstacles.items():
                state[number] = vector
    return found


@of_path
def contact_pressure(path: Path, state: int = -1) -> tuple[Float[Array, "m 2"], Float[Array, " m"]]:
    """Pressure of contact at the surface points of one state: their positions, and the values.

    Arguments:

    - `path`: the `Path`.
    - `state`: number of the state; the last one by default.

    Returns positions (m, 2), mm, and pressures (m,), force per dry length of all that touches,
    kT/v; 0 at points without contact, and for a problem without contact. They have derivatives.

    See docs/howto/contact.md.
    """
    x, value = path.x[state], path.value[state]
    if not path.problem.has_contact:
        points = path.model.outline.position(x)
        return points, jnp.zeros(len(points))
    model = path.problem.at(value)[0].touching(x).model
    points = surface_points(x, model)
    if not len(model.contact.pairs):
        return points, jnp.zeros(len(points))
    square = jnp.sum(jax.grad(energy_of_points)(points, x, model) ** 2, axis=1)
    acts = square > 0
    return points, jnp.where(
        acts,
        jnp.sqrt(jnp.where(acts, square, 1.0)) / jnp.where(acts, surface_lengths(model), 1.0),
        0.0,
    )
