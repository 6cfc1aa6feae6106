"""Gaps: smallest widths of the holes, and status texts as in ``history.csv``.

The gap of a hole is its shortest double normal: the shortest straight line through the hole that
meets its surface along the normal at both ends, see `double_normals`. That of a convex hole is its
width, that of a slit the distance of its sides, that of a hole that closes its neck; the two sides
of a corner do not face each other. An edge that is held or moved closes a hole as a wall, and the
gap to it counts. At a free edge a hole is open, and its mouth is a gap between the two ends of its
outline. Holes, and images of one in a periodic cell, have gel between them and no gap to each
other.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._memo import once_per_owner
from .._tracing import is_traced
from .._types import Array, Float
from ..continuation import Path
from ..equilibrium import Change, Status
from ..geometry import Plate, edge_lines
from ..mechanics import loops_of
from .areas import dry_outlines, dry_points_on_loops, outlines, points_on_loops
from .double_normals import OPEN, WALL, Pair, kinds_of_sides, shortest_double_normal
from .fields import membrane_stress
from .states import States, of_path

SELF_CONTACT = "invalid: self-contact"
IN_CONTACT = "a hole's sides touch"
SWITCHED = {
    Change.BIFURCATION: "switched to the stable branch",
    Change.RELAXATION: "relaxed to another branch",
    Change.PHASE: "changed its phase",
}
WRINKLES = "a thin film wrinkles out of its plane"
ROUND_OFF = 1e-9  # kT/v: compression of a film that is none


@of_path
def min_gap(path: States) -> Float[np.ndarray, " k"]:
    """Smallest gap (k,) of all holes, mm: the width at which opposite sides of a hole are nearest.

    Arguments:

    - `path`: the `Path` of k states.

    Returns NumPy values: 0 if an outline crosses itself, inf if no hole has a gap and for a plate
    without holes. It has no derivatives, unlike `gap`, and needs no compilation.

    >>> import types, jaxgel
    >>> hole = jaxgel.Ellipse((0.0, 0.0), (0.5, 0.25))
    >>> model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(2.0, 2.0, [hole]), spacing=0.5))
    >>> states = types.SimpleNamespace(model=model, x=0.9 * model.nodes[None])  # a path has more
    >>> min_gap(states).round(2)
    array([0.45])
    """
    edges = _edges(path.model.lists.topology.plate)
    pairs = _pairs(edges, dry_outlines(path.model), outlines(path))
    return np.min(
        [
            np.full(len(path.x), np.inf),
            *(np.array([pair.length for pair in states]) for states in pairs),
        ],
        axis=0,
    )


@of_path
def gap(path: States) -> Float[Array, " k"]:
    """Smallest gap (k,) of all holes, mm, with its derivatives.

    It is `min_gap`, or the plate's shorter side if no hole has a gap. Derivatives are those of the
    distance of the two material points at the ends of the line, which is exact: to first order its
    length does not change with its ends along the outline. They are those of one line if several
    are equally short, and nan if an outline crosses itself.
    """
    plate = path.model.lists.topology.plate
    loops, largest = loops_of(path.model)[1], min(plate.width, plate.height)
    if not loops:
        return jnp.full(len(path.x), largest)
    points, dry = points_on_loops(path), dry_points_on_loops(path.model)
    places = len(path.x), len(loops)
    shapes = jax.ShapeDtypeStruct((*places, 3), int), *[jax.ShapeDtypeStruct(places, float)] * 2
    pairs, arguments = (
        functools.partial(_numbered_pairs, loops, _edges(plate)),
        jax.lax.stop_gradient((dry, points)),
    )
    pairs = (
        jax.pure_callback(pairs, shapes, *arguments, vmap_method="sequential")
        if is_traced(arguments)
        else pairs(*arguments)
    )
    return _smallest_length(points, *pairs, float(largest))


min_gap_once = once_per_owner(min_gap)
"""`min_gap`, evaluated once for a path: two columns of the table depend on it."""


@of_path
def status_texts(path: Path) -> list[str]:
    """Status of each state (k): of Newton's method, a change of branch, or contact.

    A change is to another branch than that of the state before. With contact, a state is in contact
    if a gap is below the range of contact. Without, all states from the first one on in which a
    hole's boundary crosses itself are ``SELF_CONTACT``. A film that is compressed in its plane
    would wrinkle out of it; its smallest stress is given, see `membrane_stress`.
    """
    smallest = min_gap_once(path)
    crossed = np.logical_or.accumulate(smallest <= 0)
    touching = smallest < (0.0 if path.model.contact is None else float(path.model.contact.range))
    stress = membrane_stress(path) if path.model.film else np.zeros(len(path.mu))
    texts = []
    for status, least, change, touches in zip(
        path.status, np.asarray(stress), path.switched, touching, strict=True
    ):
        found = ([SWITCHED[Change(int(change))]] if change else []) + (
            [IN_CONTACT] if touches else []
        )
        found += [f"{WRINKLES} ({least:.2g} kT/v)"] if least < -ROUND_OFF else []
        texts.append(", ".join(found) or Status(int(status)).name.lower().replace("_", " "))
    return [SELF_CONTACT if c else text for text, c in zip(texts, crossed, strict=True)]


def _edges(plate: Plate) -> Float[np.ndarray, "4 3"]:
    """Axis, coordinate in mm and kind of each edge of the plate, for `kinds_of_sides`."""
    moves_freely = ("free", "periodic")
    return np.array(
        [
            (*line, OPEN if plate.edges[edge] in moves_freely else WALL)
            for edge, line in edge_lines(plate).items()
        ],
        dtype=float,
    )


def _pairs(edges: Array, dry: list[Array], loops: list[Array]) -> list[list[Pair]]:
    """Shortest double normals of each hole, ``dry`` (m, 2) and in ``loops`` (k, m, 2); host.

    The dry outline, and that of all states.
    """
    kinds = [kinds_of_sides(np.asarray(loop), np.asarray(edges)) for loop in dry]
    return [
        [shortest_double_normal(loop, sides) for loop in np.asarray(states)]
        for states, sides in zip(loops, kinds, strict=True)
    ]


def _numbered_pairs(
    loops: list[np.ndarray], edges: Array, dry: Array, points: Array
) -> tuple[np.ndarray, ...]:
    """`_pairs` of loops through numbered ``points``: vertices (k, l, 3), fractions, lengths.

    They are arrays; fractions and lengths are (k, l).
    """
    dry, points = np.asarray(dry), np.asarray(points)
    found = _pairs(edges, [dry[loop] for loop in loops], [points[:, loop] for loop in loops])
    vertices = [
        loop[np.array([pair.vertices for pair in states])]
        for loop, states in zip(loops, found, strict=True)
    ]
    rest = [[(pair.fraction, pair.length) for pair in states] for states in found]
    return np.stack(vertices, axis=1), *np.moveaxis(np.array(rest, float), (0, 1, 2), (2, 1, 0))


@compiled()
def _smallest_length(points, vertices, fraction, length, largest):
    """The least (k,) of the lengths of the `Pair`s of each state and of ``largest``.

    Without derivatives of no length.
    """

    def of_state(points, vertices, fraction, length):
        start, before, after = jnp.moveaxis(points[vertices], 1, 0)
        exists = length != jnp.inf
        squared = jnp.sum((start - before - fraction[:, None] * (after - before)) ** 2, axis=1)
        return jnp.min(
            jnp.where(exists, jnp.sqrt(jnp.where(exists, squared, 1.0)), jnp.inf), initial=largest
        )

    return jax.vmap(of_state)(points, vertices, fraction, length)
