"""Solvent in transient swelling: uptake, rate, chemical potential and flux.

Solvent is measured by its volume over the dry thickness, mm^2: in plane strain the area by which
the plate grows. All functions are differentiable in the arrays of the path.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._programs import program
from .._sizes import resized
from .._types import Array, Float, Int
from .._validation import check_kind
from ..continuation import Path
from ..discretisation import Connectivity, cells_of, evaluate_points, pad_nodes, pairs_in_reach
from ..equilibrium import State
from ..mechanics import (
    FEWEST_PLACES,
    PLACE_SUPPORT,
    all_volumes,
    axial_stretch,
    carried,
    carrying_groups,
    cofactors,
    deformation_gradients,
    group_positions,
    reference_groups,
    solvent_of,
    volume_ratios,
    wetted_nodes,
)
from ..transient import Time
from .fields import means_over_cells, over_cells, volumes_of
from .in_time import rates
from .points import Points, points_in_gel
from .states import of_path


def is_in_time(path: Path) -> bool:
    """Whether the states are those of transient swelling, with times as their values."""
    return path.t is not None and isinstance(path.control, Time)


def check_in_time(path: Path) -> None:
    """Raise ValueError, one line, for a path of equilibrium states."""
    if not is_in_time(path):
        raise ValueError(
            "path: its states are in equilibrium; give a path in time, as swell(problem, bath, "
            "times, start=mu) returns it"
        )


def kinks_of(path: Path) -> Float[Array, " j"]:
    """Times (j,) at which the slope of a bath may change."""
    times = jnp.asarray(path.control.times)
    return times if len(times) > 1 else jnp.zeros(0)


@of_path
def uptake(path: Path) -> Float[Array, " k"]:
    """Solvent (k,), mm^2, that the gel has taken up since time 0, through all wetted parts.

    `path` is a `Path` of `swell`, of k states. Raises `ValueError` for equilibrium states, with
    which `uptake_fraction` compares. Example: docs/howto/time.md.
    """
    check_in_time(path)
    return jnp.sum(jnp.asarray(path.supplied), axis=1)


@of_path
def inflow(path: Path) -> Float[Array, "k b"]:
    """Solvent inflow (k, b), mm^2 per unit of time: time derivative of ``path.supplied``.

    Each wetted part has its own. It is that of the interpolation of `at_time` in the interval that
    ends at a state, an estimate of third order. At time 0, and at other kinks of a bath from which
    a path starts, the inflow may be infinite: there it is nan. The parts are
    ``path.control.wetted``. ValueError for a path of equilibrium states, or of one state.
    """
    check_in_time(path)
    if len(path) < 2:
        raise ValueError("path: has one state, a rate needs two at least")
    return rates(jnp.asarray(path.value), kinks_of(path), jnp.asarray(path.supplied))


@of_path
def uptake_fraction(path: Path, end: Path | State) -> Float[Array, " k"]:
    """Solvent taken up since time 0 over that at equilibrium (k,): 0 at the start, 1 at the end.

    Arguments: `path`, the `Path` of `swell`; `end`, the equilibrium on the same cloud, a `State` or
    a path whose last state counts, such as `sweep(problem, [mu])`. Raises `ValueError` for another
    cloud.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.swell(problem, -0.4, [0.01, 0.1, 1.0, 10.0, 30.0, 100.0], start=-0.5)
    >>> fraction = uptake_fraction(path, jaxgel.sweep(problem, [-0.4]))
    >>> float(fraction[0]), round(float(fraction[-1]), 2)
    (0.0, 1.0)
    """
    taken = uptake(path)
    check_kind("end", end, (Path, State), "a state, or a path whose last state counts")
    x = jnp.asarray(end.x if isinstance(end, State) else end.x[-1])
    if x.shape != path.x.shape[1:]:
        raise ValueError(f"end: is a state of {len(x)} nodes, the path has {path.x.shape[1]}")
    whole, first = (_content(jnp.asarray(at), path.model) for at in (x, path.x[0]))
    return taken / (whole - first + taken[0])


@program(x="n")
def _content(x, model):
    """Volume () of the deformed plate over the dry thickness, mm^2."""
    return axial_stretch(model) * jnp.sum(
        jnp.where(model.carries, all_volumes(model) * volume_ratios(x, model), 0.0)
    )


# --- the chemical potential -----------------------------------------------------------------------


@of_path
def solvent_potential(path: Path) -> Float[Array, "k c"]:
    """Chemical potential (k, c) of the solvent, kT: the mean in every cell.

    In equilibrium it is ``mu`` everywhere.
    """
    if path.potential is None:
        return jnp.broadcast_to(jnp.asarray(path.mu)[:, None], (len(path), path.model.n_cells))
    return _means_over_cells(jnp.asarray(path.potential), path.model, cells_of(path.model.lists))


_means_over_cells = program(values="kg", returns="kc")(
    jax.vmap(means_over_cells, in_axes=(0, None, None))
)


@of_path
def potential_at(path: Path, points: Points) -> Float[Array, "k p"]:
    """Chemical potential (k, p) of the solvent, kT, at concrete dry points, mm.

    They are material points of the plate. It is interpolated as in the flow: moving least squares
    with a linear basis through the volume groups and the wetted nodes, which have the bath's
    chemical potential; at time 0, before the bath acts, that of the nearest group. Between nodes of
    a curved outline, and where mu changes by a large part from one place to the next, interpolation
    may overshoot.

    ValueError for a point outside the gel, and for a path of equilibrium states, in which it is
    ``mu``.
    """
    check_in_time(path)
    lists, wetted = path.model.lists, path.control.wetted
    points = points_in_gel(path.model, points)
    (nodes, parts), nearest = wetted_nodes(lists, wetted), _nearest_groups(lists, wetted)
    reference, _ = _reference_places(lists, wetted)
    near = _lists(reference, _reach(lists, wetted), points)
    groups = group_positions(path.model.blocks)
    places = jnp.concatenate([groups, jnp.asarray(path.model.cloud.nodes)[nodes]])
    (phi,) = evaluate_points(
        places, jnp.asarray(points), *near, np.arange(len(points)), basis="linear", gradients=False
    )
    values = jnp.concatenate(_values_at_places(path, parts, nearest), axis=1)
    return jnp.einsum("pb,kpb->kp", phi, values[:, near[0]])


def _values_at_places(path, parts, nearest):
    """Mu (k, g) of all groups and (k, w) of the wetted nodes, kT."""
    t, potential = jnp.asarray(path.value), jnp.asarray(path.potential)
    baths = _bath_values(path)
    return potential, jnp.where(t[:, None] > 0, baths[:, parts], potential[:, nearest])


def _bath_values(path):
    """Mu (k, b) of the bath of each wetted part, kT."""
    times, parts = jnp.asarray(path.control.times), path.control.parts
    if parts is None:
        return jnp.zeros((len(path), 0))
    return jax.vmap(lambda mu: jnp.interp(jnp.asarray(path.value), times, mu), out_axes=1)(
        jnp.asarray(parts)
    )


@once_per_owner
def _nearest_groups(lists: Connectivity, wetted: tuple[str | int, ...]) -> Int[np.ndarray, " w"]:
    """The group (w,) that carries volume nearest each wetted node."""
    groups, carrying = reference_groups(lists)[0], carrying_groups(lists)
    nodes, _ = wetted_nodes(lists, wetted)
    return carrying[cKDTree(groups[carrying]).query(lists.topology.nodes[nodes].reshape(-1, 2))[1]]


@once_per_owner
def _reference_places(lists: Connectivity, wetted: tuple[str | int, ...]):
    """Reference positions (v, 2), mm, of groups and wetted nodes, and which are places.

    Before holes moved.
    """
    groups, nodes = reference_groups(lists)[0], wetted_nodes(lists, wetted)[0]
    real = np.zeros(len(groups) + len(nodes), dtype=bool)
    real[carrying_groups(lists)] = real[len(groups) :] = True
    return np.concatenate([groups, lists.topology.nodes[nodes]]), real


@once_per_owner
def _reach(lists: Connectivity, wetted: tuple[str | int, ...]) -> Float[np.ndarray, " v"]:
    """Radius (v,) of the weight function of each place, mm; 0 for a group without volume."""
    places, real = _reference_places(lists, wetted)
    return np.where(real, PLACE_SUPPORT * _spacing_at(lists, places), 0.0)


def _spacing_at(lists, points):
    """Spacing (p,) of the nodes around points, mm."""
    topology = lists.topology
    return topology.node_spacing[cKDTree(topology.nodes).query(points)[1]]


def _lists(places, reach, points) -> tuple[Int[np.ndarray, "p b"], Float[np.ndarray, "p b"]]:
    """Lists (p, b) of the places that reach points, and their supports.

    ValueError if these are too few.
    """
    pairs = pairs_in_reach(points, places, reach)
    counts = np.bincount(pairs["i"], minlength=len(points))
    if (counts < FEWEST_PLACES).any():
        x, y = points[np.argmin(counts)]
        raise ValueError(
            f"points: the cloud is too coarse for an interpolation at ({x:.4g}, {y:.4g}); use a "
            "smaller spacing"
        )
    return pad_nodes(pairs["j"][np.lexsort((pairs["j"], pairs["i"]))], counts, reach)


# --- the flux -------------------------------------------------------------------------------------


@of_path
def solvent_flux(path: Path, *, deformed: bool = False) -> Float[Array, "k c 2"]:
    """Flux (k, c, 2) of the solvent, mm per unit of time: the mean over every cell.

    It is -M grad mu of the solver, M = D (J - 1) F^-1 F^-T, through the dry area. With ``deformed``
    it is F times that over det F, the flux through the deformed area, which belongs to pictures of
    the deformed gel. The flow into layers thinner than the cells is not in it. At time 0 it is that
    before the bath acts. ValueError for a path of equilibrium states.
    """
    check_in_time(path)
    model, control = path.model, path.control
    if not control.wetted:
        raise ValueError("path: its control does not name the wetted parts, which the flux needs")
    solvent = solvent_of(model, control.wetted).shared(model.shared, model)
    _, parts = wetted_nodes(model.lists, control.wetted)
    potential, wet = _values_at_places(path, parts, _nearest_groups(model.lists, control.wetted))
    wet = resized(wet, (len(path), len(solvent.wetting.node_parts)))
    arrays = jnp.asarray(path.x), jnp.asarray(path.pressure), potential, wet
    return _cell_flux(
        *arrays,
        jnp.asarray(control.D, float),
        path.problem,
        solvent,
        cells_of(model.lists),
        deformed=deformed,
    )


@program(x="kn", p="kg", potential="kg", returns="kc", static=("deformed",))
def _cell_flux(x, p, potential, wet, D, problem, solvent, cells, *, deformed):
    model, gel, values = problem.model, problem.gel, jnp.concatenate([potential, wet], axis=1)

    def of_state(state):
        x, p, values = state
        work, fluxes = carried(p, values, model, gel, solvent, reverse=True).work, []
        for block, on_block, w in zip(model.blocks, solvent.blocks, work, strict=True):
            turned = cofactors(deformation_gradients(x, block))
            flux = -D * jnp.einsum("cqij,cqbj,cb->cqi", turned, on_block.dpsi, w)
            fluxes.append(
                block.weight[..., None]
                * (flux if deformed else jnp.einsum("cqji,cqj->cqi", turned, flux))
            )
        volumes = volumes_of(model, cells)
        return jnp.stack(
            [
                over_cells([part[..., axis] for part in fluxes], cells) / volumes
                for axis in range(2)
            ],
            axis=1,
        )

    return jax.lax.map(of_state, (x, p, values))


@of_path
def flux_at(path: Path, points: Points) -> Float[Array, "k p 2"]:
    """Flux (k, p, 2) of the solvent through the dry area at material points, mm per time.

    Its unit is mm per unit of time, on the dry plate. It is interpolated between the means of the
    cells, `solvent_flux`, at their centroids, by moving least squares with a linear basis.
    ValueError as by `potential_at`.
    """
    check_in_time(path)
    points, lists = points_in_gel(path.model, points), path.model.lists
    reference = _centroids(lists)
    near = _lists(reference, PLACE_SUPPORT * _spacing_at(lists, reference), points)
    centroids = _moved_centroids(path.model, cells_of(lists))
    (phi,) = evaluate_points(
        centroids,
        jnp.asarray(points),
        *near,
        np.arange(len(points)),
        basis="linear",
        gradients=False,
    )
    return jnp.einsum("pb,kpbi->kpi", phi, solvent_flux(path)[:, near[0]])


@once_per_owner
def _centroids(lists: Connectivity) -> Float[np.ndarray, "c 2"]:
    """Centroids (c, 2) of the cells before holes moved, mm."""
    quadrature, vertices = lists.topology.quadrature, lists.topology.partition.vertices
    weights, points = (
        np.asarray(quadrature.weights(vertices)),
        np.asarray(quadrature.points(vertices)),
    )
    sums = np.zeros((int(lists.cell_of_point.max()) + 1, 3))
    np.add.at(sums, lists.cell_of_point, np.column_stack([weights, weights[:, None] * points]))
    return sums[:, 1:] / sums[:, :1]


@program(returns="c")
def _moved_centroids(model, cells):
    """Centroids (c, 2) of the cells on the dry plate, mm."""
    parts = [
        over_cells([block.weight * block.position[..., axis] for block in model.blocks], cells)
        for axis in range(2)
    ]
    return jnp.stack(parts, axis=1) / volumes_of(model, cells)[:, None]
