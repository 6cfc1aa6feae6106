"""Fields of a state: volume ratio, stress (kT/v), stretch.

And the mean and extreme volume ratio of the cells.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._memo import once_per_owner
from .._programs import program
from .._sizes import NODES, resized, room
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from ..continuation import Path
from ..discretisation import Body, Cells, Connectivity, Model, cells_of, make_probe
from ..materials import (
    LocalGel,
    LocalValues,
    elementwise,
    free_swelling,
    gel_at_points,
    gel_in_groups,
    isotropic_swelling,
    named_parameters,
    varies,
    with_parameters,
)
from ..materials import cauchy_stress as cauchy_stress_at
from ..mechanics import (
    at_points,
    axial_stretch,
    by_block,
    deformation_of,
    gradients_by_block,
    periods_of,
    volume_law,
    volume_ratios,
)
from .states import States, of_path, positions_of

CELLS_OF_NODE = 8  # that there is room for, on average


@of_path
def volume_ratio(path: States) -> Float[Array, "k c"]:
    """Volume ratio J (k, c) of every cell, dimensionless: the mean of its patch's field.

    Arguments:

    - `path`: the `Path` of k states.

    The field is constant or linear on a patch. In a film and in generalised plane strain it is the
    areal stretch, and J follows from it and from the `gel` and `mu` of the path.

    Example: docs/howto/trust.md.
    """
    cells = cells_of(path.model.lists)
    return (
        _film_volume_ratio(path.x, path.value, path.problem, cells)
        if path.model.film
        else _volume_ratio(path.x, path.model, cells)
    )


@program(x="kn", returns="kc")
@functools.partial(jax.vmap, in_axes=(0, None, None))
def _volume_ratio(x, model, cells):
    return axial_stretch(model) * _areal_stretch(x, model, cells)


@program(x="kn", returns="kc")
@functools.partial(jax.vmap, in_axes=(0, 0, None, None))
def _film_volume_ratio(x, at, problem, cells):
    now, mu = problem.at(at)
    A, carries = volume_ratios(x, now.model), now.model.carries
    J = volume_law(now.model, gel_in_groups(now.gel), mu).volume_ratio(jnp.where(carries, A, 2.0))
    return means_over_cells(J, now.model, cells)


@of_path
def thickness_stretch(path: Path) -> Float[Array, "k c"]:
    """Stretch of the thickness of every cell; 1 in plane strain."""
    return volume_ratio(path) / _areal_stretches(path.x, path.model, cells_of(path.model.lists))


@program(x="kn", returns="kc")
@functools.partial(jax.vmap, in_axes=(0, None, None))
def _areal_stretches(x, model, cells):
    return _areal_stretch(x, model, cells)


@of_path
def macroscopic_deformation(path: Path) -> Float[Array, "k 2 2"]:
    """Macroscopic deformation gradient F (k, 2, 2) of every state, rows first, dimensionless.

    Arguments: `path`, the `Path` of k states.

    Returns F of the sides of a periodic cell, else the prescribed one. Example:
    docs/howto/boundary.md.
    """
    return _macroscopic_deformation(
        path.x, path.value, path.problem, periods_of(path.model.lists.topology)
    )


@program(x="kn")
@functools.partial(jax.vmap, in_axes=(0, 0, None, None))
def _macroscopic_deformation(x, at, problem, periods):
    return deformation_of(x, periods, problem.edges(at).deformation)


@of_path
def membrane_stress(path: Path) -> Float[Array, " k"]:
    """Smallest principal Cauchy stress (k,) in the plane of a film, kT/v, at the quadrature points.

    Below 0 a thin film wrinkles. ValueError in plane strain, in which a sheet cannot deform out of
    its plane.
    """
    if not path.model.film:
        raise ValueError("membrane_stress: the plate is not in plane stress")
    return _membrane_stress(path.x, path.pressure, path.value, path.problem)


@program(x="kn", p="kg")
@functools.partial(jax.vmap, in_axes=(0, 0, 0, None))
def _membrane_stress(x, p, at, problem):
    problem, _ = problem.at(at)
    model, gel, smallest = problem.model, problem.gel, []
    for number, (block, F) in enumerate(
        zip(model.blocks, gradients_by_block(x, model), strict=True)
    ):
        pressure = at_points(by_block(p, model)[number], block)
        sigma = elementwise(
            _film_stress, F, gel_at_points(gel, number), pressure, signature="(i,j)->(i,j)"
        )
        mean, half = (
            (sigma[..., 0, 0] + sigma[..., 1, 1]) / 2,
            (sigma[..., 0, 0] - sigma[..., 1, 1]) / 2,
        )
        square = half**2 + sigma[..., 0, 1] ** 2
        principal = mean - jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
        # a film's pressure is, but for that of a steep field
        smallest.append(jnp.min(jnp.where(pressure < 0, principal, jnp.inf)))
    return jnp.min(jnp.stack(smallest))


@of_path
def parameter_values(path: Path) -> dict[str, Float[Array, " c"]]:
    """The parameters of the gel that vary over the plate, by name: their means over the cells."""
    found = {
        name: part
        for name, part in named_parameters(path.gel).items()
        if isinstance(part, LocalValues)
    }
    means = (
        _parameter_means(path.problem, tuple(found), cells_of(path.model.lists)) if found else ()
    )
    return {
        name: resized(values, (path.model.n_cells,))
        for name, values in zip(found, means, strict=True)
    }


@program(static=("names",))
def _parameter_means(problem, names, cells):
    parameters, volumes = named_parameters(problem.gel), volumes_of(problem.model, cells)
    return [_cell_mean(parameters[name], problem.model, volumes, cells) for name in names]


def _cell_mean(part, model, volumes, cells):
    return (
        over_cells(
            [
                block.weight * values
                for block, values in zip(model.blocks, part.points, strict=True)
            ],
            cells,
        )
        / volumes
    )


@once_per_owner
def host_volume_ratio(path: States) -> Float[np.ndarray, "k c"]:
    """`volume_ratio` by NumPy, evaluated once for a path and used by several columns."""
    return np.asarray(volume_ratio(path))


@of_path
def mean_volume_ratio(path: States) -> Float[Array, " k"]:
    """Mean swelling ratio (k,): volume ratio J of the cells, weighted by dry volume.

    By NumPy, unless it is differentiated.
    """
    volumes = cell_volumes(path.model)
    if is_traced(path.x, getattr(path, "value", None), volumes):
        cells = len(cells_of(path.model.lists).patch)
        return _mean(resized(volume_ratio(path), (len(path.x), cells)), resized(volumes, (cells,)))
    volumes = np.asarray(volumes)
    return host_volume_ratio(path) @ volumes / volumes.sum()


@compiled()
def _mean(J, volumes):
    return J @ volumes / jnp.sum(volumes)


def cell_volumes(model: Model) -> Float[Array, " c"]:
    """Dry volume of every cell, mm^2 (per unit depth)."""
    return _cell_volumes(model, cells_of(model.lists))


@program(returns="c")
def _cell_volumes(model, cells):
    return over_cells([block.weight for block in model.blocks], cells)


def volumes_of(model: Body, cells: Cells) -> Float[Array, " c"]:
    """The volumes of the cells, by which sums over these are divided; 1 for padding."""
    volumes = _cell_volumes(model, cells)
    return jnp.where(volumes > 0, volumes, 1.0)


@of_path
def free_stretch(path: Path) -> Float[Array, " k"]:
    """Free-swelling stretch at each mu; nan if there is none, and if the gel varies.

    See ``free_swelling``.
    """
    if varies(path.gel):
        return jnp.full(len(path.mu), jnp.nan)
    if path.model.film:
        return _at_each(isotropic_swelling, path)
    return _at_each(
        lambda mu, gel: free_swelling(mu, gel, path.model.cloud.plate.axial_stretch), path
    )


def _at_each(stretch, path):
    """``stretch(mu, gel)`` (k,) at the states of a path, with the gel of its control."""
    if not path.problem.changes.gel:
        return stretch(path.mu, path.gel)
    settings = [path.control(value, path.gel) for value in path.value]
    return jnp.stack([stretch(setting.mu, setting.gel) for setting in settings])


@of_path
def deformed_vertices(path: States) -> Float[Array, "k v 2"]:
    """Deformed positions (k, v, 2) of all vertices of the cells, mm, for pictures."""
    probe = make_probe(
        path.model, path.model.cloud.vertices, path.model.cloud.topology.partition.vertices
    )
    return positions_of(probe, path)


@of_path
def cauchy_stress(path: Path) -> Float[Array, "k n 3"]:
    """Cauchy stress (k, n, 3) at the nodes, components xx, yy, xy, kT/v.

    Arguments:

    - `path`: the `Path` of k states.

    The pressure at a node is the mean over the cells that have the node as a corner of their
    triangles; on the outline of a region the stress is that inside the region.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> stress = cauchy_stress(jaxgel.sweep(problem, [-0.4]))
    >>> bool(abs(stress[..., 1]).max() < 1e-9)  # free to swell along y
    True
    """
    model = path.model
    probe = make_probe(
        model,
        model.nodes,
        model.lists.topology.partition.vertices[model.lists.topology.node_vertices],
    )
    probe = probe.with_room(len(model.shared.nodes))
    return _cauchy_stress(
        path.x,
        path.pressure,
        path.value,
        path.problem,
        probe,
        cells_of(model.lists),
        _cells_of_nodes(model.lists),
    )


@program(x="kn", p="kg", returns="kn")
@functools.partial(jax.vmap, in_axes=(0, 0, 0, None, None, None, None))
def _cauchy_stress(x, p, value, problem, probe, cells, around):
    model, (now, mu) = problem.model, problem.at(value)
    axial = model.axial_stretch

    def mean(values):
        """Means over the cells around each node, 0 for padding."""
        node, cell, share = around
        return jnp.zeros(len(model.nodes)).at[node].add(share * values[cell])

    def stress(F, gel, p):
        return (
            _film_stress(F, gel, p)
            if model.film
            else cauchy_stress_at(F, mu, gel, p / axial_stretch(model), axial)
        )

    F, gel = probe.deformation_gradient(x), _gel_at_nodes(now.gel, model, mean, cells)
    sigma = elementwise(
        stress, F, gel, mean(means_over_cells(p, model, cells)), signature="(i,j)->(i,j)"
    )
    return jnp.stack([sigma[:, 0, 0], sigma[:, 1, 1], sigma[:, 0, 1]], axis=1)


def _film_stress(F: Float[Array, "2 2"], gel: LocalGel, p: Scalar) -> Float[Array, "2 2"]:
    """In-plane Cauchy stress (2, 2) of a film with the pressure ``p`` < 0 of ``materials.laws``.

    Some finite one for others.
    """
    A = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    return (gel.Nv * F @ F.T / A + p * jnp.eye(2)) / jnp.sqrt(
        jnp.where(p < 0, -p * A / gel.Nv, 1.0)
    )


def _gel_at_nodes(gel: LocalGel, model: Body, mean: Callable, cells: Cells) -> LocalGel:
    """The gel at the nodes: parameters that vary as means over the cells, as the pressure."""

    def at_nodes(part):
        if not isinstance(part, LocalValues):
            return part
        return mean(_cell_mean(part, model, volumes_of(model, cells), cells))

    return with_parameters(gel, at_nodes)


def _areal_stretch(x: Float[Array, "n 2"], model: Body, cells: Cells) -> Float[Array, " c"]:
    return means_over_cells(volume_ratios(x, model), model, cells)


def means_over_cells(values: Float[Array, " g"], model: Body, cells: Cells) -> Float[Array, " c"]:
    """Means over the cells of the fields with these values in the volume groups; 0 for padding."""
    fields = [
        block.weight * at_points(part, block)
        for block, part in zip(model.blocks, by_block(values, model), strict=True)
    ]
    return over_cells(fields, cells) / volumes_of(model, cells)


def over_cells(values: list[Float[Array, "_ _"]], cells: Cells) -> Float[Array, " c"]:
    """Sums over each cell of values at the quadrature points, per block; padding is 0."""
    total = jnp.zeros(len(cells.patch))
    for cell, part in zip(cells.of_points, values, strict=True):
        total = total.at[cell].add(part)
    return total


@once_per_owner
def _cells_of_nodes(lists: Connectivity) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of node and cell, see `cauchy_stress`, and one over the node's cells; 0 for padding.

    The cells around it, their number.
    """
    topology, part = lists.topology, lists.topology.partition
    number = np.full(len(part.vertices), -1)
    number[topology.node_vertices] = np.arange(len(topology.node_vertices))
    corners = number[part.triangles]
    pairs = np.stack(
        [corners, np.broadcast_to(part.cell_of_triangle[:, None], corners.shape)], axis=-1
    )[corners >= 0]
    node_region = topology.regions_at(part.vertices[topology.node_vertices])
    pairs = pairs[node_region[pairs[:, 0]] == part.region_of_cell[pairs[:, 1]]]
    node, cell = np.unique(pairs, axis=0).T
    share = 1 / np.bincount(node)[node]
    # as many as clouds with so many nodes have, or more
    size = (max(CELLS_OF_NODE * room(len(topology.node_vertices), NODES), room(len(node))),)
    return resized(node, size), resized(cell, size), resized(share, size)
