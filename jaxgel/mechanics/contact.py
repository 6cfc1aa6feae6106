"""Contact of a gel's surfaces with each other and with obstacles, as an energy of distances.

    E = kappa sum_(i,j) w_i w_j psi(d_ij / r_ij) + kappa r sum_(i,o) w_i psi(g_io / r),
    psi(s) = (1 - s)^3 / s for s < 1, 0 beyond

over pairs of points of one surface, r_ij = min(range, D_ij / 3), and over points and obstacles, r =
range; d and D are the distances now and on the dry plate, g the gap to an obstacle, and w the
lengths of dry surface that the points stand for. Two parallel surfaces a gap g apart so press each
other with kappa P(g / range), where P(3/4) = 0.169, P(1/2) = 1.25, P(1/4) = 5.62; an obstacle
presses with -kappa psi'(g / range): 0.28, 2.0, 13.5. Psi has two continuous derivatives and grows
beyond all bounds; neighbours, whose r is short, meet only where the surface folds onto itself.
Contact is without friction.

The sums have the points that are nearer than their range, which `surfaces` finds: without any,
contact costs and changes nothing. Points lie as close together as the range asks for: where the
nodes of a cloud are farther apart, on the straight sides between them. Range and kappa are
numerical; see docs/howto/contact.md for what they do to results. Where a wall cuts a surface, its
mirror image at the wall completes it, which keeps the surface from passing the wall. Lengths in mm,
kappa in kT/v. Index letters: ``q`` pair, ``s`` side of a surface or primitive of an obstacle, ``o``
obstacle.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._types import Array, Float, Int, Scalar
from ..discretisation import Body, Interpolation, Model, make_probe
from ..geometry import Primitives, gap, primitives_of
from ..materials import AnyGel
from .local_gel import localised, mean_stiffness
from .voids import free_edge_points

RANGE = 1 / 80  # of the plate's shorter side: half the default spacing of the nodes
STIFFNESS = 10.0  # of the network's Nv
NEIGHBOURS = 3.0  # dry distance over the range of a pair
FAR = 1e6  # mm


class ContactPoints(NamedTuple):
    """Points on the sides of surfaces; a pytree. Ends of sides are numbers of `surface_points`."""

    ends: Int[Array, "*q 2"]
    """The ends of the side on which a point lies."""
    fraction: Float[Array, " *q"]
    """Its place on the side, 0 at the first end."""
    sides: Int[Array, "*q 2 2"]
    """The ends of the two sides that meet there."""
    share: Float[Array, "*q 2"]
    """Share of the length of each of these sides that the point stands for."""

    def positions(self, points: Float[Any, "p 2"]) -> Any:
        """Positions (..., 2) at those of the `surface_points`."""
        start, end = points[self.ends[..., 0]], points[self.ends[..., 1]]
        return start + self.fraction[..., None] * (end - start)

    def lengths(self, dry: Float[Array, "p 2"]) -> Float[Array, " *q"]:
        """Lengths (...) of dry surface that they stand for, mm."""
        return jnp.sum(
            self.share * _length(dry[self.sides[..., 1]] - dry[self.sides[..., 0]]), axis=-1
        )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class ContactPairs:
    """Active contact: pairs of contact points, and points with obstacle primitives; a pytree.

    The second point of a pair may be an image: sign * y + sum_k coefficient_k * x(anchor_k) of a
    point at y, with two nodes as anchors.
    """

    pair: ContactPoints
    """The two points (q, 2) of each pair."""
    sign: Float[Array, "q 2"]
    """See above."""
    anchors: Int[Array, "q 2"]
    """Node numbers."""
    coefficient: Float[Array, "q 2 2"]
    """For each anchor and component."""
    multiplicity: Float[Array, " q"]
    """Weight of a pair: 1, half if it appears twice with points exchanged, 0 for padding."""
    point: ContactPoints
    """Points (m,) that touch an obstacle."""
    primitive: Int[Array, " m"]
    """The primitive nearest to each."""
    counts: Float[Array, " m"]
    """1, and 0 for padding."""

    def __len__(self) -> int:
        return self.multiplicity.shape[0] + self.counts.shape[0]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Contact:
    """How surfaces repel each other, and what touches; a pytree."""

    range: Float[Array, ""]
    """Largest distance at which two points repel each other, mm."""
    stiffness: Float[Array, ""]
    """kappa, kT/v."""
    obstacles: Primitives
    """The obstacles, where they are."""
    edges: Interpolation | None
    """Shape functions on free edges, see `voids.EdgePoints`; None without any."""
    pairs: ContactPairs
    """All that is nearer than its range in the states that are considered, see `Problem.touching`.

    At first nothing.
    """


def with_contact(
    model: Model,
    gel: AnyGel,
    *,
    range: Scalar | None = None,  # noqa: A002
    stiffness: Scalar | None = None,
) -> Model:
    """The model with contact of ``range`` (mm) and ``stiffness`` kappa (kT/v).

    The defaults are 1/80 of the plate's shorter side and 10 times the mean Nv. They do not depend
    on the cloud. If nothing is given it is returned as it is if it has contact already, and if it
    has neither holes nor obstacles: the flat free edges of a solid plate that is swollen beyond its
    surface instability would relax into creases as deep as the cloud allows.
    """
    plain = not model.lists.topology.outlines and not model.cloud.plate.obstacles
    if range is None and stiffness is None and (model.contact is not None or plain):
        return model
    plate = model.lists.topology.plate
    range = RANGE * min(plate.width, plate.height) if range is None else range  # noqa: A001
    stiffness = (
        STIFFNESS * mean_stiffness(localised(model, gel), model) if stiffness is None else stiffness
    )
    numbers, points = (
        (jnp.asarray(range, dtype=float), jnp.asarray(stiffness, dtype=float)),
        free_edge_points(model.lists.topology),
    )
    edges = (
        make_probe(model, points.on(model.nodes), points.on(model.lists.topology.nodes))
        if points.count
        else None
    )
    return dataclasses.replace(
        model,
        contact=Contact(*numbers, primitives_of(model.cloud.plate.obstacles), edges, no_pairs()),
    )


def no_points(*shape: int) -> ContactPoints:
    """`ContactPoints` of no surface."""
    return ContactPoints(
        np.zeros((*shape, 2), int),
        np.zeros(shape),
        np.zeros((*shape, 2, 2), int),
        np.zeros((*shape, 2)),
    )


def no_pairs() -> ContactPairs:
    """`ContactPairs` of surfaces that do not touch."""
    images = np.zeros((0, 2)), np.zeros((0, 2), int), np.zeros((0, 2, 2))
    return ContactPairs(
        no_points(0, 2), *images, np.zeros(0), no_points(0), np.zeros(0, int), np.zeros(0)
    )


def has_pairs(model: Body) -> bool:
    """Whether contact keeps any points of a model apart."""
    return model.contact is not None and len(model.contact.pairs) > 0


def surface_points(x: Float[Array, "n 2"], model: Body) -> Float[Array, "p 2"]:
    """Positions of outline points and of those on free edges, numbered from the end: -1 is last."""
    edges = model.contact.edges
    return (
        model.outline.position(x)
        if edges is None
        else jnp.concatenate([model.outline.position(x), edges.position(x)])
    )


def dry_points(model: Body) -> Float[Array, "p 2"]:
    """The dry `surface_points`, mm."""
    edges = model.contact.edges
    return (
        model.outline.points
        if edges is None
        else jnp.concatenate([model.outline.points, edges.points])
    )


def contact_energy(x: Float[Array, "n 2"], model: Body) -> Float[Array, ""]:
    """Contact energy () at nodal ``x`` (n, 2), kT/v mm^2.

    0 if no surfaces touch, nan inside an obstacle.
    """
    return (
        energy_of_points(surface_points(x, model), x, model) if has_pairs(model) else jnp.zeros(())
    )


def energy_of_points(
    points: Float[Array, "p 2"], x: Float[Array, "n 2"], model: Body
) -> Float[Array, ""]:
    """`contact_energy` at positions of the `surface_points`.

    Of the nodes ``x`` (n, 2) it takes the anchors of images alone.
    """
    pairs, contact = model.contact.pairs, model.contact
    of_pairs = _weights(model) * jax.vmap(pair_energy)(_between(points, x, pairs), _ranges(model))
    gaps = jax.vmap(gap)(pairs.point.positions(points), _touched(contact))
    return jnp.sum(of_pairs) + jnp.sum(
        _obstacle_weights(model) * jax.vmap(barrier, (0, None))(gaps, contact.range)
    )


contact_force: Callable[..., Array] = jax.grad(contact_energy)
"""Gradient (n, 2) of ``contact_energy`` with respect to the nodal positions, kT/v mm."""


@program(x="n")
def pair_hessians(
    x: Float[Array, "n 2"], model: Body
) -> tuple[Float[Array, "q 2 2"], Float[Array, "m 2 2"]]:
    """Second derivatives of ``contact_energy``, kT/v, by pair separations and point positions.

    The points are those at obstacles.
    """
    points, pairs, contact = surface_points(x, model), model.contact.pairs, model.contact
    of_pairs = jax.vmap(jax.hessian(pair_energy))(_between(points, x, pairs), _ranges(model))

    def at_obstacle(y, primitive):
        return barrier(gap(y, primitive), contact.range)

    of_points = jax.vmap(jax.hessian(at_obstacle))(pairs.point.positions(points), _touched(contact))
    return _weights(model)[:, None, None] * of_pairs, _obstacle_weights(model)[
        :, None, None
    ] * of_points


def pair_energy(delta: Float[Array, " 2"], reach: Scalar) -> Float[Array, ""]:
    """psi(|delta| / reach) () of a pair with separation ``delta`` (2,) and range ``reach`` ()."""
    square = jnp.sum(delta**2)
    acts = (square < reach**2) & (square > 0)
    s = jnp.sqrt(jnp.where(acts, square, 1.0)) / jnp.where(acts, reach, 1.0)
    return jnp.where(acts, (1 - s) ** 3 / s, 0.0)


def barrier(distance: Scalar, reach: Scalar) -> Float[Array, ""]:
    """psi(distance / reach) () of a gap; nan for one that is not above 0."""
    s = jnp.where(distance < reach, distance / reach, 1.0)
    return (1 - s) ** 3 / jnp.where(s > 0, s, jnp.nan)


def _between(points, x, pairs):
    """Separations (q, 2) at positions of surface points (p, 2) and nodes (n, 2)."""
    first, second = jnp.moveaxis(pairs.pair.positions(points), 1, 0)
    return first - pairs.sign * second - jnp.sum(pairs.coefficient * x[pairs.anchors], axis=1)


def _ranges(model):
    """Range (q,) of each pair, mm."""
    dry = _between(dry_points(model), model.nodes, model.contact.pairs)
    return jnp.minimum(_length(dry) / NEIGHBOURS, model.contact.range)


def _weights(model):
    """Product of the surface lengths (q,) of a pair's points, times kappa, kT/v mm^2."""
    pairs = model.contact.pairs
    return (
        model.contact.stiffness
        * pairs.multiplicity
        * jnp.prod(pairs.pair.lengths(dry_points(model)), axis=1)
    )


def _obstacle_weights(model):
    """Surface length (m,) of each point at an obstacle, times kappa and range, kT/v mm^2."""
    contact = model.contact
    return (
        contact.stiffness
        * contact.range
        * contact.pairs.counts
        * contact.pairs.point.lengths(dry_points(model))
    )


def _touched(contact):
    """The primitive that each point touches; far away for padding."""
    found = jax.tree.map(lambda v: v[contact.pairs.primitive], contact.obstacles)
    real = contact.pairs.counts > 0
    return found._replace(
        radius=jnp.where(real, found.radius, -FAR),
        normal=jnp.where(real[:, None], found.normal, 0.0),
    )


def _length(vectors):
    """Lengths of vectors (..., 2) with derivative 0 at 0."""
    square = jnp.sum(vectors**2, axis=-1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
