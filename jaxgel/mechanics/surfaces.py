"""Contact points on the surfaces of a gel, and which of them are near each other or an obstacle.

NumPy on the host. The surface of one void may touch itself: the outline of a hole, or free edges
with the holes that are open to them. A wall on which it ends mirrors it, a periodic edge repeats
it. Neighbours are found by a KD-tree at every state anew: that costs less than to test whether an
older list still holds.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
import shapely
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._primitives import differentiated_value
from .._tracing import is_traced
from .._types import Array, Bool, Float, Int
from .._validation import Inadmissible
from ..cloud import Topology
from ..discretisation import Body, Model
from ..geometry import Primitives
from .contact import (
    NEIGHBOURS,
    ContactPairs,
    ContactPoints,
    dry_points,
    no_pairs,
    no_points,
    surface_points,
)
from .outlines import outline_rows
from .voids import Image, lines_of_voids

# of the range: below it the pair is a point and its own image at the wall on which it lies, to
# round-off
ITSELF = 1e-9
SIZES = (256, 4)  # room for pairs: the first size, and the ratio of one size to the next
TREE = dict(balanced_tree=False, compact_nodes=False)  # quick to build
DENSITY = 0.4  # largest distance of dry contact points along a surface, over the range
ROUND_OFF = 1e-9  # of a length


@dataclasses.dataclass(frozen=True, eq=False)
class Surfaces:
    """The contact points of a plate; hashed by identity."""

    points: ContactPoints
    """The points (m,)."""
    void: Int[np.ndarray, " m"]
    """The void on whose surface each lies."""
    images: tuple[Image, ...]
    """How surfaces appear to themselves, the identity first."""

    def positions(self, points: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "m 2"]:
        """Positions of the contact points at those of the `surface_points`."""
        return (
            self.points.positions(points)
            if self.points.fraction.any()
            else points[self.points.ends[:, 0]]
        )

    def of_images(self, numbers: Int[np.ndarray, " q"]) -> list[np.ndarray]:
        """Sign, anchors and coefficient of the images with these numbers."""
        return [
            np.stack([getattr(one, name) for one in self.images])[numbers]
            for name in ("sign", "anchors", "coefficient")
        ]

    def pairs(
        self, numbers: Int[np.ndarray, "q 3"], at_obstacles: Int[np.ndarray, "m 2"]
    ) -> ContactPairs:
        """`ContactPairs` of these images and first and second points, and of points and primitives.

        With room for more.
        """
        image, point, primitive = numbers[:, 0], *at_obstacles.T
        pair, single = (
            ContactPoints(*(part[rows] for part in self.points)) for rows in (numbers[:, 1:], point)
        )
        of_pairs = (
            pair,
            *self.of_images(image),
            np.where([one.twice for one in self.images], 0.5, 1.0)[image],
        )
        found = [
            jax.tree.map(_with_room, part)
            for part in (of_pairs, (single, primitive, np.ones(len(point))))
        ]
        return ContactPairs(*found[0], *found[1])


def _with_room(values):
    size, ratio = SIZES
    while size < len(values):
        size *= ratio
    return (
        np.concatenate([values, np.zeros((size - len(values), *values.shape[1:]), values.dtype)])
        if len(values)
        else values
    )


def near(
    surfaces: Surfaces,
    dry: tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, "n 2"]],
    now: tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, "n 2"]],
    reach: float,
    apart: float = 0.0,
    share: float = 1.0,
) -> tuple[Int[np.ndarray, "q 3"], Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Pairs (q, 3), image and points, distances (q,) below ``share`` of ranges (q,), ``apart``.

    The points are the first and the second. ``dry`` and ``now`` are the positions of surface points
    and nodes, ``reach`` is the largest range, mm.
    """
    X, y = surfaces.positions(dry[0]), surfaces.positions(now[0])
    far, found = share * reach + apart, []
    if not len(y) or not np.isfinite(y).all():
        return np.zeros((0, 3), int), np.zeros(0), np.zeros(0)
    tree = cKDTree(y, **TREE)
    for number, image in enumerate(surfaces.images):
        shift = [
            np.sum(image.coefficient * nodes[image.anchors], axis=0) for nodes in (now[1], dry[1])
        ]
        if number == 0:
            first, second = tree.query_pairs(far, output_type="ndarray").T
        else:
            rows = np.flatnonzero(np.isin(surfaces.void, image.voids))
            close = cKDTree(image.sign * y[rows] + shift[0], **TREE).sparse_distance_matrix(
                tree, far, output_type="ndarray"
            )
            first, second = close["j"], rows[close["i"]]
        same = surfaces.void.take(first) == surfaces.void.take(second)
        first, second = first[same], second[same]
        between = (
            at.take(first, axis=0) - image.sign * at.take(second, axis=0) - by
            for at, by in zip((y, X), shift, strict=True)
        )
        d, D = (np.hypot(*vectors.T) for vectors in between)
        r = np.minimum(D / NEIGHBOURS, reach)
        kept = (d < share * r + apart) & (r > ITSELF * reach)
        found.append(
            (np.stack([np.full(len(d), number), first, second], axis=1)[kept], d[kept], r[kept])
        )
    numbers, d, r = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.lexsort(numbers.T[::-1])
    return numbers[order], d[order], r[order]


def near_obstacles(
    surfaces: Surfaces, obstacles: Primitives, points: Float[np.ndarray, "p 2"], within: float
) -> tuple[Int[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Contact points and nearest obstacle primitives (m, 2) with gaps (m,) below ``within``, mm."""
    y, found = surfaces.positions(points), [(np.zeros((0, 2), int), np.zeros(0))]
    gaps = _gaps(y, jax.tree.map(np.asarray, obstacles))
    for owner in np.unique(obstacles.owner):
        own = np.flatnonzero(obstacles.owner == owner)
        nearest = own[np.argmin(gaps[:, own], axis=1)]
        least = gaps[np.arange(len(y)), nearest]
        at = np.flatnonzero(least < within)
        found.append((np.stack([at, nearest[at]], axis=1), least[at]))
    return np.concatenate([pairs for pairs, _ in found]), np.concatenate(
        [least for _, least in found]
    )


def _gaps(y, obstacles):
    """Gaps (m, s) of points (m, 2) to all primitives; `geometry.gap` in NumPy."""
    along, away = obstacles.end - obstacles.start, y[:, None] - obstacles.start
    square = np.sum(along**2, axis=1)
    share = np.clip(np.sum(away * along, axis=2) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    away = away - share[:, :, None] * along
    flat = np.any(obstacles.normal != 0, axis=1)
    return np.where(
        flat,
        np.sum(obstacles.normal * away, axis=2),
        np.linalg.norm(away, axis=2) - obstacles.radius,
    )


# --- of a model -----------------------------------------------------------------------------------


def surfaces_of(model: Model) -> Surfaces:
    """The ``Surfaces`` of a model."""
    return _surfaces(model.lists.topology, float(model.contact.range))


def surface_lengths(model: Model) -> Float[Array, " p"]:
    """Length (p,) of dry surface of each of the `surface_points`, mm: half of both sides."""
    dry, at = dry_points(model), surfaces_of(model).points
    parts = jnp.stack([1 - at.fraction, at.fraction], axis=1) * at.lengths(dry)[:, None]
    return jnp.zeros(len(dry)).at[at.ends].add(parts)


def host_points(
    model: Model, x: Float[Array, "n 2"]
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, "n 2"]]:
    """Positions of the `surface_points`, and the nodes."""
    x = np.asarray(x)
    return np.concatenate([rows @ x for rows in surface_rows(model)]), x


def surface_rows(model: Model) -> list[sp.csr_array]:
    """Matrices (p, n) of the shape functions at the outline points and the points on free edges."""
    return [
        outline_rows(one, model.n_nodes)
        for one in (model.outline, model.contact.edges)
        if one is not None
    ]


def near_pairs(
    model: Model, x: Float[Array, "n 2"], **options: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`near` at nodal positions ``x`` (n, 2) of a model with contact."""
    dry = np.asarray(dry_points(model)), np.asarray(model.nodes)
    return near(
        surfaces_of(model), dry, host_points(model, x), float(model.contact.range), **options
    )


def touched_obstacles(
    model: Model, x: Float[Array, "n 2"], within: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """`near_obstacles` at nodal ``x`` (n, 2) of a model with contact, by default within range."""
    contact = model.contact
    if not len(contact.obstacles.owner):
        return np.zeros((0, 2), int), np.zeros(0)
    within = float(contact.range) if within is None else within
    return near_obstacles(surfaces_of(model), contact.obstacles, host_points(model, x)[0], within)


def crosses_lines(x: Float[Array, "n 2"], model: Model) -> bool:
    """Whether a surface crosses an obstacle that is a line, at nodal ``x`` (n, 2)."""
    obstacles = jax.tree.map(np.asarray, model.contact.obstacles)
    pieces = np.flatnonzero((obstacles.radius == 0) & ~obstacles.normal.any(axis=1))
    if not len(pieces):
        return False
    points = host_points(model, x)[0]
    numbers = [
        np.append(line.numbers, line.numbers[: line.closed])
        for line in lines_of_voids(model.lists.topology)[0]
    ]
    surfaces = shapely.multilinestrings([shapely.linestrings(points[some]) for some in numbers])
    lines = shapely.linestrings(np.stack([obstacles.start[pieces], obstacles.end[pieces]], axis=1))
    return bool(shapely.intersects(surfaces, lines).any())


def check_obstacles(model: Model) -> None:
    """ValueError, one line, for an obstacle that the dry gel overlaps; traced ones pass."""
    if model.contact is None or is_traced(model):
        return
    pairs, _ = touched_obstacles(model, model.nodes, 0.0)
    if len(pairs):
        raise Inadmissible(
            f"obstacles[{int(np.asarray(model.contact.obstacles.owner)[pairs[0, 1]])}]: it "
            "overlaps the dry gel; move it away"
        )


def touches(x: Float[Array, "n 2"], model: Model) -> bool:
    """Whether surfaces of a model with contact are in contact or near an obstacle.

    So near that contact acts.
    """
    return len(near_pairs(model, x)[0]) + len(touched_obstacles(model, x)[0]) > 0


def touches_in_program(topology: Topology, x: Float[Array, "n 2"], model: Body) -> Bool[Array, ""]:
    """`touches` inside a compiled program, by a call of the host; false without contact."""
    if model.contact is None:
        return jnp.zeros((), bool)

    def on_host(dry, nodes, points, x, reach, obstacles):
        surfaces, obstacles = _surfaces(topology, float(reach)), Primitives(*obstacles)
        found = (
            len(near_obstacles(surfaces, obstacles, points, float(reach))[0])
            if len(obstacles.owner)
            else 0
        )
        return np.asarray(
            len(near(surfaces, (dry, nodes), (points, x), float(reach))[0]) + found > 0
        )

    arguments = (
        dry_points(model),
        model.nodes,
        surface_points(x, model),
        x,
        model.contact.range,
        tuple(model.contact.obstacles),
    )
    arguments = jax.lax.stop_gradient(jax.tree.map(jnp.asarray, arguments))
    answer = jax.ShapeDtypeStruct((), bool)
    return jax.pure_callback(
        lambda *given: on_host(*jax.tree.map(np.asarray, given)),
        answer,
        *arguments,
        vmap_method="sequential",
    )


def closest(x: Float[Array, "n 2"], model: Model, within: float = 4.0) -> float:
    """Smallest distance over range among all pairs, ``within`` or more; contact acts below 1."""
    _, d, r = near_pairs(model, x, share=within)
    return float(np.min(d / r, initial=within))


def pairs_touching(x: Sequence[Float[Array, "n 2"]], models: Sequence[Model]) -> ContactPairs:
    """All contact at any of the nodal positions ``x`` (n, 2) of a model, with moving obstacles.

    They may have moved from one to the next; the model's own pairs in compiled programs. The
    outline keeps those that were found last.
    """
    if is_traced(x, models):
        x, models = jax.tree.map(differentiated_value, (x, models))
    model = models[0]
    if is_traced(x, models) or not len(surfaces_of(model).void):
        return model.contact.pairs
    key, last = (
        (model.contact.range, *(one.contact.obstacles for one in models), *x),
        model.outline.__dict__.get("_touching", ((), None)),
    )
    if len(key) != len(last[0]) or any(
        one is not other for one, other in zip(key, last[0], strict=True)
    ):
        numbers = [
            np.zeros((0, 3), int),
            *(near_pairs(*one)[0] for one in zip(models, x, strict=True)),
        ]
        at_obstacles = [
            np.zeros((0, 2), int),
            *(touched_obstacles(*one)[0] for one in zip(models, x, strict=True)),
        ]
        found = [np.unique(np.concatenate(part), axis=0) for part in (numbers, at_obstacles)]
        pairs = surfaces_of(model).pairs(*found) if sum(map(len, found)) else no_pairs()
        last = model.outline.__dict__["_touching"] = key, pairs
    return last[1]


@once_per_owner
def _surfaces(topology: Topology, reach: float) -> Surfaces:
    """Contact points on all surfaces, at most ``DENSITY`` times ``reach`` apart.

    That is the range; along them.
    """
    lines, images = lines_of_voids(topology)
    parts, voids = [no_points(0)], [np.zeros(0, int)]
    for line in lines:
        m = len(line.numbers)
        sides = np.stack([line.numbers, np.roll(line.numbers, -1)], axis=1)
        length = np.linalg.norm(np.roll(line.points, -1, axis=0) - line.points, axis=1)
        count = np.maximum(1, np.ceil(length / (DENSITY * reach) * (1 - ROUND_OFF))).astype(int)
        real = np.ones(m)
        if not line.closed:
            count[-1], real[-1] = 1, 0.0
        side = np.repeat(np.arange(m), count)
        place = np.arange(len(side)) - np.repeat(np.cumsum(count) - count, count)
        earlier = np.where(place == 0, side - 1, side)
        share = 0.5 * (real / count)[np.stack([earlier, side], axis=1)]
        parts.append(
            ContactPoints(
                sides[side],
                place / count[side],
                np.stack([sides[earlier], sides[side]], axis=1),
                share,
            )
        )
        voids.append(np.full(len(side), line.void))
    return Surfaces(
        ContactPoints(*map(np.concatenate, zip(*parts, strict=True))), np.concatenate(voids), images
    )
