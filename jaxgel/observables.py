"""What is read off the states of a path: rotation, hole areas, volume ratios, stresses, surface stretch and gaps.

Every quantity is a pure function of one state, mapped over the k states of the path, and differentiable unless it says otherwise.
Angles in degrees, anticlockwise positive; lengths in mm; stresses in kT/v.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from scipy.spatial.distance import cdist

from .cloud import OUTLINE_SEGMENTS
from .contact import outline_loops
from .energy import all_volumes, by_block, volume_ratios
from .material import cauchy_stress as cauchy_stress_at
from .material import free_swelling, volume_ratio_at
from .midline import angle_of_extrema
from .probe import make_probe

SURFACE_ITERATIONS = 6  # for the volume ratio at a free surface; each gains a factor Nv over the bulk stiffness


def rotation_angle(path):
    """Rotation of the midline (k,), degrees: the angle to the x axis of the line through its highest and its lowest point.

    The midline is the part of y = 0 in the dry gel (Deng et al. 2020, section 5.5). The extrema are those of the interpolated line, not of
    samples, so the angle is a smooth function of the state until another extremum takes over. A level midline, such as that of the
    symmetric states of samples 4 and 7 and of the lattice, turns by 0 and has no derivative: differentiate ``core_rotation`` there.
    """
    return angle_of_extrema(jnp.asarray(path.x), path.model)


def core_rotation(path):
    """Polar rotation (k,) of the gel at ``plate.core``, degrees: the angle of R in F = R U; nan where the core lies in a hole."""
    return _over_states(_core_rotation, path)


def area_reduction(path):
    """Area reduction 1 - A/A0 (k,) of all holes together, measured on their deformed outlines; nan for a plate without holes.

    In a rigid box the cells give the same, (<J> - 1)(1 - phi)/phi with the porosity phi: to 5e-4 of it, until the holes are closed.
    """
    return _over_states(_area_reduction, path)


def area_reduction_per_hole(path):
    """Area reduction 1 - A/A0 (k, holes) of each hole."""
    return _over_states(_area_reduction_per_hole, path)


def aspect_ratio(path):
    """Length over width (k, holes) of each hole: the root of the ratio of its principal second moments of area; 2 for a 2:1 ellipse."""
    return _over_states(_aspect_ratio, path)


def outlines(path):
    """Deformed outline of each hole: a list over holes of closed loops (k, m, 2), mm, without repeating the first point.

    A hole cut by the plate's edge is closed along the edge.
    """
    return _over_states(outline_loops, path)


def dry_outlines(model):
    """Outline of each hole on the dry plate: a list over holes of closed loops (m, 2), mm."""
    return outline_loops(model.cloud.nodes, model)


def volume_ratio(path):
    """Volume ratio J (k, n_cells) of every cell, its mean over the cell."""
    return _over_states(_cell_volume_ratio, path)


def cell_volumes(model):
    """Dry volume (n_cells,) of every cell, mm^2 (per unit depth)."""
    volumes = jnp.zeros(model.n_cells)
    for block in model.blocks:
        volumes = volumes.at[block.cells].add(jnp.sum(block.weight, axis=1))
    return volumes


def free_stretch(path):
    """Stretch (k,) of the freely swelling gel at each mu; nan where there is none (see ``free_swelling``)."""
    return free_swelling(path.mu, path.gel)


def surface_ratio(path):
    """Largest ratio (k,) of normal to tangential stretch along the hole outlines; 1 for a plate without holes.

    The tangential stretch is that of the chord over one node spacing, the finest that the cloud resolves; the normal stretch follows
    from zero traction. The surface of a nearly incompressible block in plane strain creases at 2.4 (stretch 0.647; Hong, Zhao & Suo
    2009) and wrinkles at 3.4 (stretch 0.544; Biot 1963).
    """
    return jnp.max(surface_ratios(path), axis=1, initial=1.0)


def surface_ratios(path):
    """The ratio of `surface_ratio` at every fine outline vertex (k, m); none for a plate without holes."""
    return _surface_ratios(jnp.asarray(path.x), jnp.asarray(path.mu), path.gel, path.model)


def mean_surface_ratios(path, share):
    """Ratios (k, m) as in `surface_ratio` whose tangential stretch is the mean over arcs of ``share`` of a hole's outline.

    Unlike the ratio over one node spacing, which grows into every crease as the cloud is refined, they converge.
    """
    return _mean_surface_ratios(jnp.asarray(path.x), jnp.asarray(path.mu), path.gel, path.model, share)


def deformed_vertices(path):
    """Deformed positions (k, v, 2) of all vertices of the cells, mm, for pictures."""
    probe = make_probe(path.model, path.model.cloud.vertices, path.model.cloud.topology.partition.vertices)
    return jax.vmap(probe.position)(jnp.asarray(path.x))


def cauchy_stress(path):
    """Cauchy stress (k, n, 3) at the nodes, components xx, yy, xy, kT/v.

    The pressure at a node is the mean of those of the cells whose triangles it is a corner of, as the pressures are per cell; with the
    paper's quadrature of all cells that it reaches, weighted with its part in their stiffness.
    """
    model = path.model
    probe = make_probe(model, model.cloud.nodes, model.lists.topology.partition.vertices[model.lists.topology.node_vertices])
    mean, volumes = _node_mean(model), all_volumes(model)

    def one(x, p, mu):
        pressure = mean @ (_by_cell(p * volumes, model) / cell_volumes(model))
        F = probe.deformation_gradient(x)
        sigma = jax.vmap(lambda F, p: cauchy_stress_at(F, mu, path.gel, p))(F, pressure)
        return jnp.stack([sigma[:, 0, 0], sigma[:, 1, 1], sigma[:, 0, 1]], axis=1)

    return jax.vmap(one)(jnp.asarray(path.x), jnp.asarray(path.pressure), jnp.asarray(path.mu))


def min_gap(path):
    """Smallest gap (k,) between facing points of one hole's outline, mm; 0 where an outline crosses itself. Not differentiable.

    Points face each other if the line between them leaves both surfaces at less than 60 degrees to the normal; pairs closer than
    two node spacings on the dry plate are neighbours and do not count. inf for a plate without holes.
    """
    dry = [np.asarray(loop) for loop in dry_outlines(path.model)]
    loops = [np.asarray(loop) for loop in outlines(path)]
    near = [_near_pairs(loop, 2 * path.model.cloud.spacing) for loop in dry]
    gaps = [[_gap(states[k], pairs) for states, pairs in zip(loops, near, strict=True)] for k in range(len(path.mu))]
    return np.array([min(gap, default=np.inf) for gap in gaps])


# --- one state ---------------------------------------------------------------------------------------------------------------


def _over_states(function, path):
    """``function(x, model)`` at every state of the path."""
    return _mapped(function)(jnp.asarray(path.x), path.model)


@functools.cache
def _mapped(function):
    return jax.jit(jax.vmap(function, in_axes=(0, None)))


def _core_rotation(x, model):
    F = model.core.deformation_gradient(x)[0]
    return jnp.degrees(jnp.arctan2(F[1, 0] - F[0, 1], F[0, 0] + F[1, 1]))


def _hole_areas(x, model):
    """Area (holes,) inside each hole's outline, mm^2: a polygon's by the shoelace formula, and that between its sides and the outline.

    The latter is taken up to the cubic arcs that have the outline's tangents F dX at the ends of each side. Without it sample 4 misses
    2e-4 of its dry holes where they close, at mu = -0.2678: a third of what outlines and cells then disagree by.
    """
    loops, (start, end, hole) = outline_loops(x, model), _sides(model.lists.topology)
    if not loops:
        return jnp.zeros(0)
    polygons = [0.5 * jnp.sum(_cross(loop, jnp.roll(loop, -1, axis=0))) for loop in loops]
    y, F, dX = model.outline.position(x), model.outline.deformation_gradient(x), model.outline.points[end] - model.outline.points[start]
    first, last = (jnp.einsum("mij,mj->mi", F[at], dX) for at in (start, end))
    beyond = _cross(y[end] - y[start], last - first) / 10 - _cross(first, last) / 60
    return jnp.stack(polygons) + jax.ops.segment_sum(beyond, hole, len(loops))


def _cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


@functools.lru_cache(maxsize=8)
def _sides(topology):
    """First and last vertex (m,), (m,) of each side of the outlines, in the numbering of ``model.outline``, and its hole (m,)."""
    first, sides = 0, [np.zeros((3, 0), dtype=int)]
    for outline in topology.outlines:
        number = first + np.arange(len(outline.s))
        first += len(outline.s)
        start, end = (number, np.roll(number, -1)) if outline.closed else (number[:-1], number[1:])
        sides.append(np.stack([start, end, np.full(len(start), outline.arc.hole)]))
    return np.concatenate(sides, axis=1)


def _area_reduction(x, model):
    return 1 - jnp.sum(_hole_areas(x, model)) / jnp.sum(_hole_areas(model.cloud.nodes, model))


def _area_reduction_per_hole(x, model):
    return 1 - _hole_areas(x, model) / _hole_areas(model.cloud.nodes, model)


def _aspect_ratio(x, model):
    return jnp.stack([_length_over_width(loop) for loop in outline_loops(x, model)])


def _length_over_width(loop):
    """Aspect ratio () of the ellipse with the second moments of a polygon (m, 2), by Green's theorem edge by edge."""
    a, b = loop - jnp.mean(loop, axis=0), jnp.roll(loop - jnp.mean(loop, axis=0), -1, axis=0)
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area, first = jnp.sum(twice) / 2, twice @ (a + b) / 6
    total = a + b
    second = (
        jnp.einsum("m,mi,mj->ij", twice, total, total) + jnp.einsum("m,mi,mj->ij", twice, a, a) + jnp.einsum("m,mi,mj->ij", twice, b, b)
    ) / 24
    second = second - jnp.outer(first, first) / area
    mean, spread = (second[0, 0] + second[1, 1]) / 2, _hypot((second[0, 0] - second[1, 1]) / 2, second[0, 1])
    return jnp.sqrt((mean + spread) / (mean - spread))


def _hypot(a, b):
    """sqrt(a^2 + b^2) (), with derivative 0 at 0."""
    square = a**2 + b**2
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def _cell_volume_ratio(x, model):
    J = volume_ratios(x, model)
    if model.method == "mixed":
        return _by_cell(J, model)
    return _by_cell(J * all_volumes(model), model) / cell_volumes(model)


def _by_cell(values, model):
    """Values (n_cells,) in the order of the cells, summed over their volume groups, from values (g,) of all groups."""
    by_cell = jnp.zeros(model.n_cells)
    for block, part in zip(model.blocks, by_block(values, model), strict=True):
        by_cell = by_cell.at[block.cells].add(jnp.sum(part, axis=1))
    return by_cell


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, 0, None, None))
def _surface_ratios(x, mu, gel, model):
    chords = _chords(model.lists.topology)
    if len(chords) == 0:
        return jnp.zeros(0)
    dry, deformed = (_lengths(model.outline.position(y), chords) for y in (model.cloud.nodes, x))
    return _surface_ratio(deformed / dry, mu, gel)


@functools.partial(jax.jit, static_argnums=4)
@functools.partial(jax.vmap, in_axes=(0, 0, None, None, None))
def _mean_surface_ratios(x, mu, gel, model, share):
    segments, ends = _arcs(model.lists.topology, share)
    if len(segments) == 0:
        return jnp.zeros(0)
    sums = [jnp.append(0.0, jnp.cumsum(_lengths(model.outline.position(y), segments))) for y in (model.cloud.nodes, x)]
    dry, deformed = (total[ends[:, 1]] - total[ends[:, 0]] for total in sums)
    return _surface_ratio(deformed / dry, mu, gel)


def _lengths(points, chords):
    """Lengths (m,) of the ``chords`` (m, 2) between numbered ``points`` (p, 2)."""
    return jnp.linalg.norm(points[chords[:, 1]] - points[chords[:, 0]], axis=1)


def _surface_ratio(tangential, mu, gel):
    """Ratio (m,) of normal to ``tangential`` stretch (m,) of a surface without traction."""

    def better(J, _):  # p = -(dnetwork/dstretch_n) / stretch_t with stretch_n = J / stretch_t
        force = jax.vmap(lambda t, n: jax.grad(gel.network)(jnp.diag(jnp.stack([t, n])), gel)[1, 1])
        return volume_ratio_at(-force(tangential, J / tangential) / tangential, mu, gel), None

    start = jnp.broadcast_to(volume_ratio_at(-gel.Nv, mu, gel), tangential.shape)
    J, _ = jax.lax.scan(better, start, length=SURFACE_ITERATIONS)  # a loop: unrolled it compiles five times as long
    return J / tangential**2


@functools.lru_cache(maxsize=8)
def _chords(topology):
    """Outline vertices (m, 2), in the numbering of ``model.outline``, that lie half a node spacing to either side of each vertex."""
    half, first, chords = OUTLINE_SEGMENTS // 2, 0, []
    for outline in topology.outlines:
        number = first + np.arange(len(outline.s))
        first += len(outline.s)
        if outline.closed:
            chords.append(np.stack([np.roll(number, half), np.roll(number, -half)], axis=1))
        else:
            chords.append(np.stack([number[: -2 * half], number[2 * half :]], axis=1))
    return np.concatenate(chords) if chords else np.zeros((0, 2), dtype=int)


@functools.cache
def _arcs(topology, share):
    """Fine outline segments (s, 2), in the numbering of ``model.outline``, and the first and last (m, 2) of arcs of ``share``, exclusive.

    The segments at which a closed outline begins are repeated at its end.
    """
    first, segments, ends = 0, [np.zeros((0, 2), dtype=int)], [np.zeros((0, 2), dtype=int)]
    for outline in topology.outlines:
        n, span, before = len(outline.s), max(1, round(share * len(outline.s))), sum(map(len, segments))
        number = first + (np.arange(n + span) % n if outline.closed else np.arange(n))
        first += n
        segments.append(np.stack([number[:-1], number[1:]], axis=1))
        starts = before + np.arange(len(number) - span)
        ends.append(np.stack([starts, starts + span], axis=1))
    return np.concatenate(segments), np.concatenate(ends)


def _node_mean(model):
    """Matrix (n, n_cells) that averages over the cells about a node, see `cauchy_stress`."""
    if model.quadrature == "paper":
        touches = jnp.zeros((model.n_nodes, model.n_cells))
        for block in model.blocks:
            part = jnp.einsum("cq,cqai->ca", block.weight, block.dphi**2)
            touches = touches.at[block.nodes, block.cells[:, None]].add(part)
        return touches / touches.sum(axis=1, keepdims=True)
    topology, part = model.lists.topology, model.lists.topology.partition
    number = np.full(len(part.vertices), -1)
    number[topology.node_vertices] = np.arange(model.n_nodes)
    touches = np.zeros((model.n_nodes, model.n_cells))
    node = number[part.triangles]
    cell = np.broadcast_to(part.cell_of_triangle[:, None], node.shape)
    touches[node[node >= 0], cell[node >= 0]] = 1.0
    return jnp.asarray(touches / touches.sum(axis=1, keepdims=True))


def _near_pairs(loop, distance):
    return cdist(loop, loop) < distance


def _gap(loop, near):
    """Smallest distance between facing points of a closed loop (m, 2), gel outside; 0 if it crosses itself."""
    if not shapely.LinearRing(loop).is_simple:
        return 0.0
    tangent = np.roll(loop, -1, axis=0) - np.roll(loop, 1, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance, height = cdist(loop, loop), normal @ loop.T  # over the tangent at each point, from the origin
    leaving = height - np.diagonal(height)[:, None] > 0.5 * distance
    facing = leaving & leaving.T & ~near
    return float(distance[facing].min(initial=np.inf))
