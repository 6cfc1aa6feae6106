"""Self-contact of hole boundaries as one more energy: the points of a hole's outline keep each other at a distance.

    E = kappa/2 sum_ij w_i w_j psi(d_ij / r_ij),   psi(s) = (1 - s)^3 / s for s < 1 and 0 beyond,   r_ij = min(range, D_ij / 3)

over all points of one hole, d and D their distances now and on the dry plate and w the lengths of dry outline they stand for. Two
parallel surfaces a gap g apart so press each other with kappa P(g / range), where P(3/4) = 0.169, P(1/2) = 1.25, P(1/4) = 5.62. Psi has two
continuous derivatives and grows beyond all bounds; neighbours, whose r is short, meet only where the outline folds onto itself.
Range and kappa are numerical; what they do to sample 7 at mu = -0.4, its corners closed (`python benchmarks/contact.py`): a third and three
times kappa move the core rotation of 89.55 degrees by 0.03, half the range by 0.18 and a quarter by 0.44, the energy by 7e-6 at most.
Where a wall cuts a hole, its mirror image at the wall completes it, which keeps the outline from passing the wall. Lengths in mm,
kappa in kT/v. Index letters: ``h`` hole, ``m`` point, ``n`` node of a hole, ``g`` image.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._memo import once_per_owner
from .._programs import program
from .._sizes import rung
from .._types import Array, Bool, Float, Int, Scalar
from .._validation import Inadmissible
from ..cloud import Topology
from ..discretisation import Body, Model, reaching_nodes
from ..geometry import edge_lines
from ..materials import AnyGel
from .local_gel import localised, mean_stiffness

RANGE = 0.5  # of the node spacing
STIFFNESS = 10.0  # of the network's Nv
NEIGHBOURS = 3.0  # dry distance over the range of a pair
ITSELF = 1e-9  # of the largest range: below it the pair is a point and its own image at the wall on which it lies, to round-off
SHARES = (16, 4, 1)  # parts of a hole's points, one of which is made room for in a tangent: the smallest that holds those that act
NO_NODE = 2**30
APPROACH = 0.5  # of a pair's distance, or range, that one Newton iteration leaves


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class ContactGroup:
    """Holes with equally many points and images."""

    holes: Int[Array, " h"]
    """(h,) their numbers."""
    points: Int[Array, "h m"]
    """(h, m) numbers of the contact points in ``model.outline``, along each outline."""
    joined: Bool[Array, "h m"]
    """(h, m) whether the outline goes on from a point to the next one."""
    nodes: Int[Array, "h n"]
    """(h, n) node numbers that the points depend on, ascending; padded with a number that no node has."""
    sign: Float[Array, "h g 2"]
    """(h, g, 2) images sign * y + shift of a point y, the first of which is itself."""
    shift: Float[Array, "h g 2"]
    """(h, g, 2) see ``sign``; mm."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Contact:
    """How hole boundaries repel each other."""

    range: Float[Array, ""]
    """Largest distance at which two points do, mm."""
    stiffness: Float[Array, ""]
    """kappa, kT/v."""
    groups: tuple[ContactGroup, ...]
    """The holes."""
    first: tuple[ContactGroup, ...]
    """Those that stand for all: of a symmetric plate the others are their images."""

    def standing_for_all(self, holes: Int[np.ndarray, " h"]) -> "Contact":
        """The same with the holes of these numbers that stand for all."""
        rows = [np.isin(group.holes, holes) for group in self.groups]
        chosen = [jax.tree.map(lambda v, some=some: v[some], group) for group, some in zip(self.groups, rows, strict=True) if some.any()]
        return dataclasses.replace(self, first=tuple(chosen))


def with_contact(model: Model, gel: AnyGel, *, range: Scalar | None = None, stiffness: Scalar | None = None) -> Model:  # noqa: A002
    """The model with self-contact of ``range`` (mm, half the node spacing by default) and ``stiffness`` kappa (kT/v, 10 times the mean Nv).

    It is returned as it is if it has no hole, or contact already and nothing is given.
    """
    if not model.lists.topology.outlines or (model.contact is not None and range is None and stiffness is None):
        return model
    range = RANGE * model.cloud.spacing if range is None else range  # noqa: A001
    stiffness = STIFFNESS * mean_stiffness(localised(model, gel), model) if stiffness is None else stiffness
    groups = contact_groups(model.lists.topology, model.dmax)
    return dataclasses.replace(model, contact=Contact(jnp.asarray(range, dtype=float), jnp.asarray(stiffness, dtype=float), groups, groups))


def contact_energy(x: Float[Array, "n 2"], model: Body) -> Float[Array, ""]:
    """Energy () of self-contact at nodal positions ``x`` (n, 2), kT/v mm^2; 0 where no outline comes close to itself."""
    return model.contact.stiffness * sum(jnp.sum(parts) for parts in _over_holes(_hole_energy, model, x, model.contact.groups))


@program(x="n")
def touches(x: Float[Array, "n 2"], model: Body) -> Bool[Array, ""]:
    """Whether an outline comes so near itself that contact acts."""
    return ~(closest(x, model) >= 1.0)


contact_force: Callable[..., Array] = jax.grad(contact_energy)
"""Gradient (n, 2) of ``contact_energy`` with respect to the nodal positions, kT/v mm."""


def contact_tangents(x: Float[Array, "n 2"], model: Body) -> list[Array]:
    """Hessian of ``contact_energy``: for each of `contact_groups` the blocks (h, n, n, 2, 2) of its nodes, kT/v."""
    return [model.contact.stiffness * blocks for blocks in _over_holes(_hole_tangent, model, x, model.contact.groups)]


def closest(x: Float[Array, "n 2"], model: Body) -> Float[Array, ""]:
    """Smallest distance over range () among all pairs; contact acts below 1."""
    return jnp.min(jnp.stack([jnp.min(parts) for parts in _over_holes(_hole_closest, model, x, model.contact.first)]))


def step_limit(x: Float[Array, "n 2"], dx: Float[Array, "n 2"], model: Body) -> Float[Array, ""]:
    """Share () of the step ``dx`` (n, 2), at most 1, that leaves every pair ``APPROACH`` times its distance, or its range if less."""
    return jnp.min(jnp.stack([jnp.min(parts) for parts in _over_holes(_hole_limit, model, x, model.contact.first, dx)]))


def pair_energy(delta: Float[Array, " 2"], reach: Scalar) -> Float[Array, ""]:
    """psi(|delta| / reach) () of a pair with separation ``delta`` (2,) and range ``reach`` ()."""
    square = jnp.sum(delta**2)
    acts = (square < reach**2) & (square > 0)
    s = jnp.sqrt(jnp.where(acts, square, 1.0)) / jnp.where(acts, reach, 1.0)
    return jnp.where(acts, (1 - s) ** 3 / s, 0.0)


def _each_pair(function):
    return jax.vmap(jax.vmap(jax.vmap(function)))  # images, points, points


def _over_holes(function, model, x, groups, *fields):
    """``function(hole, *fields at its points)`` of every hole of the groups, ``x`` and others, stacked; one hole in memory at a time."""
    dry, values = model.outline.points, [model.outline.position(field) for field in (x, *fields)]

    def one(arrays):
        points, joined, nodes, sign, shift = arrays
        weight, reach = _weights_and_ranges(dry[points], joined, sign, shift, model.contact.range)
        return function(_HoleState(model, points, nodes, sign, shift, weight, reach), *(value[points] for value in values))

    for group in groups:
        yield lax.map(jax.checkpoint(one), (group.points, group.joined, group.nodes, group.sign, group.shift))


def _weights_and_ranges(dry, joined, sign, shift, most):
    """Weights (m, m) and ranges (g, m, m) of the pairs of dry points (m, 2)."""
    length = _root(jnp.sum((jnp.roll(dry, -1, axis=0) - dry) ** 2, axis=-1)) * joined
    weight = 0.5 * (length + jnp.roll(length, 1))
    reach = jnp.minimum(_root(_squares(dry, sign, shift)) / NEIGHBOURS, most)
    return weight[:, None] * weight, jnp.where(reach > ITSELF * most, reach, 0.0)


def _root(square):
    """Square roots with derivative 0 at 0."""
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


@dataclasses.dataclass(frozen=True)
class _HoleState:
    """One hole's contact points with the model."""

    model: object
    points: Array
    nodes: Array
    sign: Array
    shift: Array
    weight: Array
    """(m, m) product of the lengths of outline that two points stand for, mm^2."""
    reach: Array
    """(g, m, m) ranges of the pairs, mm; 0 for a point with itself."""


def _separations(points, sign, shift):
    """Vectors (g, m, m, 2) to each of the ``points`` (m, 2) from every image of each."""
    return points[:, None] - (sign[:, None] * points + shift[:, None])[:, None]


def _squares(points, sign, shift):
    """Squared lengths (g, m, m) of the ``_separations``, by components: the form that XLA vectorises."""
    x, y = ((v[:, None] - (sign[:, None, i] * v + shift[:, None, i])[:, None]) ** 2 for i, v in enumerate(points.T))
    return x + y


def _hole_energy(hole, points):
    energies = _each_pair(pair_energy)(_separations(points, hole.sign, hole.shift), hole.reach)
    return 0.5 * jnp.sum(hole.weight * energies)


def _hole_tangent(hole, points):
    """Blocks (n, n, 2, 2): the Hessian of each pair in its separation, taken to the points and from there to the nodes.

    Where surfaces touch few points act, and all others are left out: the products cost their number times the square of the nodes'.
    """
    square = _squares(points, hole.sign, hole.shift)
    acts = (square < hole.reach**2) & (square > 0)
    acting = jnp.any(acts, axis=(0, 1)) | jnp.any(acts, axis=(0, 2))
    first = jnp.argsort(~acting)  # a stable sort: those that act, along the outline, and then the others
    sizes = sorted({-(-len(points) // share) for share in SHARES})
    enough = jnp.searchsorted(jnp.asarray(sizes), jnp.sum(acting))
    return lax.switch(enough, [functools.partial(_tangent_of, hole, points, size) for size in sizes], first)


def _tangent_of(hole, points, size, first):
    """Blocks (n, n, 2, 2) of the first ``size`` points in that order (m,)."""
    some = first[:size]
    separations = _separations(points[some], hole.sign, hole.shift)
    H = _each_pair(jax.hessian(pair_energy))(separations, hole.reach[:, some[:, None], some])
    H = hole.weight[some[:, None], some][:, :, None, None] * H
    at_points = -jnp.einsum("gmpij,gj->mpij", H, hole.sign)  # a pair and its mirror image act alike, which takes up the half
    number, outline = jnp.arange(size), hole.model.outline
    at_points = at_points.at[number, number].add(jnp.sum(H, axis=(0, 2)))
    column = jnp.searchsorted(hole.nodes, jnp.asarray(outline.nodes)[hole.points[some]])
    phi = jnp.zeros((size, len(hole.nodes))).at[number[:, None], column].add(outline.phi[hole.points[some]])
    return jnp.einsum("ma,mbij->abij", phi, jnp.einsum("mpij,pb->mbij", at_points, phi))


def _hole_closest(hole, points):
    square = _squares(points, hole.sign, hole.shift)
    return jnp.sqrt(jnp.min(jnp.where(hole.reach > 0, square / jnp.where(hole.reach > 0, hole.reach, 1.0) ** 2, jnp.inf)))


def _hole_limit(hole, points, step):
    distance = jnp.sqrt(_squares(points, hole.sign, hole.shift))
    approach = jnp.sqrt(_squares(step, hole.sign, 0.0 * hole.shift))
    room = distance - APPROACH * jnp.minimum(distance, hole.reach)
    tight = (hole.reach > 0) & (approach > room)
    return jnp.min(jnp.where(tight, room / jnp.where(tight, approach, 1.0), 1.0))


@once_per_owner
def contact_groups(topology: Topology, dmax: float) -> tuple[ContactGroup, ...]:
    """`ContactGroup`s of the holes of a topology, for shape functions of the support radius ``dmax`` over the spacing."""
    stops = np.cumsum([0] + [len(o.s) for o in topology.outlines])
    support = dmax * topology.node_spacing
    found = {}
    for k in range(len(topology.plate.holes)):
        own = [i for i, o in enumerate(topology.outlines) if o.arc.hole == k]
        if not own:
            continue
        points = [np.arange(stops[i], stops[i + 1]) for i in own]
        joined = [np.arange(len(p)) < len(p) - (not topology.outlines[i].closed) for p, i in zip(points, own, strict=True)]
        points, joined = np.concatenate(points), np.concatenate(joined)
        vertices = np.concatenate([o.vertices for o in topology.outlines])[points]
        reference = topology.partition.vertices[vertices]
        nodes, _ = reaching_nodes(topology, reference, np.zeros(len(points), dtype=int), topology.regions_at(reference), support)
        images = _images(topology.plate, [topology.outlines[i].arc for i in own])
        found.setdefault((len(points), len(images)), []).append((k, points, joined, nodes, *np.moveaxis(images, 1, 0)))
    return tuple(map(_group, found.values()))


def _group(holes):
    """`ContactGroup` from tuples in the order of its fields."""
    numbers, points, joined, nodes, sign, shift = zip(*holes, strict=True)
    most = rung(max(map(len, nodes)))
    padded = [np.append(some, np.full(most - len(some), NO_NODE)) for some in nodes]
    return ContactGroup(*map(np.stack, (numbers, points, joined, padded, sign, shift)))


def _images(plate, arcs):
    """Signs and shifts (g, 2, 2) of a hole and its images at the walls on which its arcs end, and at a corner behind both."""
    lines, walls = edge_lines(plate), {edge for arc in arcs for edge in (arc.start_edge, arc.end_edge)} - {None}
    by_axis = [[(1.0, 0.0)], [(1.0, 0.0)]]
    for edge in (edge for edge in sorted(walls) if plate.edges[edge] != "free"):
        axis, coordinate = lines[edge]
        if plate.deformation[axis][1 - axis] != 0:
            raise Inadmissible(f"deformation: it turns the {edge} edge, to which a hole is open; contact there must be 'off'")
        by_axis[axis].append((-1.0, 2 * (plate.deformation[axis][axis] * coordinate + plate.displacement[edge][axis])))
    return np.array([np.transpose(pair) for pair in itertools.product(*by_axis)])
