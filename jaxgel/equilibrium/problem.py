"""A model with its gel and loads, prepared for Newton's method."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from ..materials import osmotic
from ..mechanics import all_volumes, closest, constants, crosses, free_dofs, outline_loops, start_positions, tangent_pattern, volume_ratios


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """A model with its gel and loads, prepared for Newton's method."""

    model: object
    """The ``Model``."""
    gel: object
    """The ``Gel``."""
    loads: jax.Array
    """(n, 2) dead nodal loads, kT/v mm."""
    fixed: object
    """``mixed.Constants`` of the model."""
    apart: object = None
    """The same ``Problem`` without self-contact, for states in which no outline is near itself; None where there is no contact."""

    @functools.cached_property
    def free(self):
        """(f,) numbers of the free degrees of freedom."""
        return free_dofs(self.model.lists.topology)

    @functools.cached_property
    def pattern(self):
        """Pattern of the tangent; that of contact, made when first asked for, couples all nodes near a hole and takes the longer."""
        return tangent_pattern(self.model.lists, self.free, self.model.contact, self.model.solver)


def prepare(model, gel, loads=None):
    """``Problem`` for a model; ``loads`` (n, 2) are dead nodal forces in kT/v mm, none by default."""
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else jnp.asarray(loads)
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    apart = None if model.contact is None else prepare(dataclasses.replace(model, contact=None), gel, loads)
    return Problem(model, gel, loads, constants(model) if apart is None else apart.fixed, apart)


@jax.jit
def dry_state(model, gel, mu=None):
    """Positions (n, 2) and pressures (g,) to start from without a previous state: the dry nodes, moved as the edges are, and p = -Nv.

    With ``mu`` (kT) the pressures are higher where the moved edges leave the gel more room than that.
    """
    x, pressure = start_positions(model.lists.topology, model.cloud.nodes), -gel.Nv * jnp.ones_like(all_volumes(model))
    plate = model.lists.topology.plate
    if mu is None or not plate.moved:
        return x, pressure
    J = volume_ratios(x, model)
    return x, jnp.where(J > 1, jnp.maximum(osmotic(jnp.where(J > 1, J, 2.0), mu, gel), pressure), pressure)


def acting(problem, state):
    """The problem that the ``Equilibrium`` solves: the one without contact where contact was not needed."""
    return problem.apart if state.apart else problem


def touches(model, x):
    """Whether an outline comes so near itself that contact acts."""
    return not float(_closest(x, model)) >= 1.0


def overlaps(model, x):
    """Whether a hole's outline crosses itself, another one or a wall."""
    return crosses([np.asarray(loop) for loop in _loops(x, model)], model.lists.topology.plate)


_closest = jax.jit(closest)
_loops = jax.jit(outline_loops)
