"""Stretch of the hole surfaces, and the limit at which they crease.

A surface without traction has the tangential stretch of a chord or an arc; its normal stretch, and
the stretch of the thickness of a film, follow from the gel there.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._memo import once_per_owner
from .._sizes import padded, resized, rung
from .._tracing import everywhere
from .._types import Array, Float, Int, Scalar
from ..cloud import OUTLINE_SEGMENTS, Topology
from ..continuation import Path
from ..discretisation import Body
from ..materials import (
    VolumeLaw,
    elementwise,
    film_edge_volume_ratio,
    gel_on_outline,
    network_at,
    osmotic,
    rises_always,
    stiff_until,
    surface_volume_ratio,
    takes_solvent,
)
from ..mechanics import Equations, Problem, least_stiffness, volume_law
from .states import of_path, outlines_of, with_room

VERTICES = 512  # to a multiple of which the places at which surface ratios are found are padded
# of Newton's method, for that at the free surface of a swollen gel in a poor solvent
PHASE_ITERATIONS = 6
# ratio of the in-plane principal stretches at which a plane-strain surface creases, stretch 0.647
# (Hong et al. 2009)
CREASE_RATIO = 2.4
SHARPNESS = 40.0  # of the softened maximum of the surface ratio
# of a hole's outline over which the stretch is averaged; sample 1 then has 1.66 with 568 to 2992
# nodes
CREASE_SHARE = 0.1


@of_path
def surface_ratio(path: Path) -> Float[Array, " k"]:
    """Largest ratio (k,) of normal to tangential stretch along the hole outlines, dimensionless.

    Arguments:

    - `path`: the `Path` of k states.

    Returns 1 for other than plane strain, and without holes. The tangential stretch is that of the
    chord over one node spacing, the finest that the cloud resolves; the normal stretch follows from
    zero traction. The surface of a nearly incompressible block in plane strain creases at 2.4
    (stretch 0.647). Where a surface wrinkles depends on the gel, see `surface_stability`.

    Source: Hong, Zhao & Suo (2009).

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> surface_ratio(jaxgel.sweep(problem, [-0.4]))  # no holes
    Array([1.], dtype=float64)
    """
    return _largest(_chord_ratios(path)[1])


@compiled()
def _largest(ratios):
    return jnp.max(ratios, axis=1, initial=1.0)


@of_path
def surface_ratios(path: Path) -> Float[Array, "k m"]:
    """The ratio of `surface_ratio` at every fine outline vertex (k, m).

    None for other than plane strain, and without holes.
    """
    count, ratios = _chord_ratios(path)
    return resized(ratios, (len(path.x), count))


@of_path
def mean_surface_ratios(path: Path, share: float) -> Float[Array, "k m"]:
    """`surface_ratio` (k, m) with tangential stretch averaged over arcs of ``share``.

    The arcs are those of a hole's outline. They converge as the cloud is refined; the ratio over
    one node spacing grows at every crease.
    """
    count, ratios = _arc_ratios(path, share)
    return resized(ratios, (len(path.x), count))


def _chord_ratios(path):
    """Number m of chords, and their ratios with those of padding, the last one again."""
    chords = chords_of(path.model.lists.topology)
    if len(chords) == 0 or not _has_surface_ratios(path.model):
        return 0, jnp.zeros((len(path.x), 0))
    return len(chords), _ratio(
        *_chord_stretches(
            with_room(path.x), path.value, on_outlines(path.problem), padded_ends(chords)
        )
    )


def _arc_ratios(path, share):
    """The same of arcs."""
    segments, ends = _arcs(path.model.lists.topology, share)
    if len(ends) == 0 or not _has_surface_ratios(path.model):
        return 0, jnp.zeros((len(path.x), 0))
    arcs = padded(segments, rung(len(segments))), padded_ends(ends)
    return len(ends), _ratio(
        *_arc_stretches(with_room(path.x), path.value, on_outlines(path.problem), *arcs)
    )


def on_outlines(problem: Problem) -> Equations:
    """Shared equations of a problem with nodes and outlines alone, see `outlines_of`."""
    shared = problem.shared
    return shared.replace(model=outlines_of(shared.model), operators=None)


def _has_surface_ratios(model):
    return not model.film and model.axial_stretch is None


@compiled()
def _ratio(tangential, near, law):
    return surface_swelling(tangential, near, law) / tangential**2


@compiled()
@functools.partial(jax.vmap, in_axes=(0, 0, None, None))
def _chord_stretches(x: Any, at: Any, problem: Equations, chords: Any) -> Any:
    """The arguments of `surface_swelling` for chords."""
    model = problem.model
    dry, deformed = (lengths(model.outline.position(y), chords) for y in (model.nodes, x))
    now, mu = problem.at(at)
    return (
        deformed / dry,
        areal_stretches(x, model, chords),
        volume_law(model, gel_on_outline(now.gel, chords), mu),
    )


@compiled()
@functools.partial(jax.vmap, in_axes=(0, 0, None, None, None))
def _arc_stretches(x: Any, at: Any, problem: Equations, segments: Any, ends: Any) -> Any:
    """The arguments of `surface_swelling` for arcs."""
    model = problem.model
    sums = [
        jnp.append(0.0, jnp.cumsum(lengths(model.outline.position(y), segments)))
        for y in (model.nodes, x)
    ]
    dry, deformed = (total[ends[:, 1]] - total[ends[:, 0]] for total in sums)
    ends, (now, mu) = (
        jnp.stack([segments[ends[:, 0], 0], segments[ends[:, 1] - 1, 1]], axis=1),
        problem.at(at),
    )
    return (
        deformed / dry,
        areal_stretches(x, model, ends),
        volume_law(model, gel_on_outline(now.gel, ends), mu),
    )


def padded_ends(ends: Int[np.ndarray, "m 2"]) -> Int[np.ndarray, "p 2"]:
    """Padded ends of chords or arcs: one program of `surface_swelling` serves many plates.

    The last ones are repeated.
    """
    return np.pad(ends, ((0, -len(ends) % VERTICES), (0, 0)), mode="edge")


def areal_stretches(
    x: Float[Array, "n 2"], model: Body, ends: Int[Array, "m 2"]
) -> Float[Array, " m"]:
    """Areal stretches (m,) of the gel at ``ends`` (m, 2) of arcs, without derivatives.

    The mean of both: near those of the surface.
    """
    return jax.lax.stop_gradient(
        jnp.linalg.det(model.outline.deformation_gradient(x))[ends].mean(axis=1)
    )


def lengths(points: Float[Array, "p 2"], chords: Int[Array, "m 2"]) -> Float[Array, " m"]:
    """Lengths of the ``chords`` between numbered ``points``."""
    return jnp.linalg.norm(points[chords[:, 1]] - points[chords[:, 0]], axis=1)


@compiled()
@jax.vmap
def surface_swelling(
    tangential: Float[Array, " m"], near: Float[Array, " m"], law: VolumeLaw
) -> Float[Array, " m"]:
    """Volume ratio at a traction-free surface of ``tangential`` stretch, in the phase of ``near``.

    That is the areal stretch next to it.
    """
    mu, gel = law.mu, law.gel
    stiff = (
        film_edge_volume_ratio(tangential, mu, gel)
        if law.film
        else surface_volume_ratio(tangential, mu, gel, law.axial)
    )

    def newton(J, _):
        def off(J):
            normal, out_of_plane = normal_stretch(tangential, J, law)
            return (
                osmotic(J, mu, gel) - traction_free_pressure(tangential, normal, law) / out_of_plane
            )

        miss, slope = jax.jvp(off, (J,), (jnp.ones_like(J),))
        return J - miss / slope, None

    def in_its_phase():
        J = law.volume_ratio(near)
        soft = takes_solvent(gel) & (stiff_until(least_stiffness(gel), gel) <= J)
        return jnp.where(
            soft, jax.lax.scan(newton, jnp.where(soft, J, 2.0), length=PHASE_ITERATIONS)[0], stiff
        )

    rises = rises_always(gel)
    if rises is False:
        return in_its_phase()
    return jax.lax.cond(everywhere(rises), lambda: stiff, in_its_phase)


def normal_stretch(
    tangential: Float[Array, " m"], J: Float[Array, " m"], law: VolumeLaw
) -> tuple[Float[Array, " m"], Float[Array, " m"] | Scalar]:
    """Stretches (m,) normal to the surface and out of plane.

    In a film, in uniaxial stress there, they are the same.
    """
    if law.film:
        return (jnp.sqrt(J / tangential),) * 2
    out_of_plane = 1.0 if law.axial is None else law.axial
    return J / (tangential * out_of_plane), out_of_plane


def traction_free_pressure(
    tangential: Float[Array, " m"], normal: Float[Array, " m"], law: VolumeLaw
) -> Float[Array, " m"]:
    """In-plane pressure (m,) of zero traction: -(dnetwork/dstretch_n) / stretch_t.

    The derivative by the areal stretch.
    """
    network = network_at(law.gel, law.axial)
    F = jnp.stack([tangential, normal], axis=1)[:, :, None] * jnp.eye(2)
    return (
        -elementwise(
            lambda F, gel: jax.grad(network)(F, gel)[1, 1], F, law.gel, signature="(i,j)->()"
        )
        / tangential
    )


@once_per_owner
def chords_of(topology: Topology) -> Int[np.ndarray, "m 2"]:
    """Outline vertices (m, 2) half a node spacing to either side of each vertex.

    Vertices are numbered as in ``model.outline``.
    """
    half, first, chords = OUTLINE_SEGMENTS // 2, 0, []
    for outline in topology.outlines:
        number = first + np.arange(len(outline.s))
        first += len(outline.s)
        if outline.closed:
            chords.append(np.stack([np.roll(number, half), np.roll(number, -half)], axis=1))
        else:
            chords.append(np.stack([number[: -2 * half], number[2 * half :]], axis=1))
    return np.concatenate(chords) if chords else np.zeros((0, 2), dtype=int)


@once_per_owner
def _arcs(
    topology: Topology, share: float
) -> tuple[Int[np.ndarray, "s 2"], Int[np.ndarray, "m 2"]]:
    """Fine outline segments (s, 2), and first and last (m, 2) of arcs of ``share``.

    They are numbered as in ``model.outline``; the last one is exclusive. The segments at which a
    closed outline begins are repeated at its end.
    """
    first, segments, ends = 0, [np.zeros((0, 2), dtype=int)], [np.zeros((0, 2), dtype=int)]
    for outline in topology.outlines:
        n, span, before = (
            len(outline.s),
            max(1, round(share * len(outline.s))),
            sum(map(len, segments)),
        )
        number = first + (np.arange(n + span) % n if outline.closed else np.arange(n))
        first += n
        segments.append(np.stack([number[:-1], number[1:]], axis=1))
        starts = before + np.arange(len(number) - span)
        ends.append(np.stack([starts, starts + span], axis=1))
    return np.concatenate(segments), np.concatenate(ends)


@of_path
def crease_indicator(path: Path) -> Float[Array, " k"]:
    """Soft maximum (k,) of the surface ratio: log(mean exp(a r)) / a with a = ``SHARPNESS``.

    Along the hole outlines. The ratio is that of the mean stretch over ``CREASE_SHARE`` of a hole's
    outline: over one node spacing it grows at every crease as the cloud is refined, so that an
    optimum would depend on the cloud. The plain maximum jumps from place to place while a design
    improves, and quasi-Newton methods fail on it; the softened one is smooth and lies below the
    maximum by at most log(m) / a, if one of m points has a larger ratio than all others, and by 0
    if all m are equal.
    """
    return _softened_maximum(*_arc_ratios(path, CREASE_SHARE))


@compiled()
def _softened_maximum(count, ratios):
    """That of the first ``count`` of the ratios (k, m)."""
    ratios = jnp.where(jnp.arange(ratios.shape[1]) < count, ratios, -jnp.inf)
    return (
        jax.nn.logsumexp(SHARPNESS * ratios, axis=1) / SHARPNESS
        - jnp.log(jnp.maximum(count, 1)) / SHARPNESS
    )
