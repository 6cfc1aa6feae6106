"""A gel on a model: fields as values at quadrature points, volume groups and outlines.

The network is integrated with the parameters at the quadrature points. A volume group has those at
the point for whose volume ratio it stands, see ``discretisation.pressures``; a held one those at
the centroid of its patch.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._memo import once_per_owner
from .._programs import program
from .._sizes import joined, resized, rung, taken
from .._tracing import is_traced, outside_traces
from .._types import Array, Float, Int, Scalar
from .._validation import check_kind, kind_in_words
from ..cloud import Topology
from ..discretisation import (
    Body,
    Connectivity,
    Model,
    NodalField,
    PatchBlock,
    group_weights,
    n_carrying,
)
from ..materials import (
    AnyGel,
    Composite,
    Elastomer,
    Filled,
    LocalGel,
    LocalValues,
    WithHoles,
    check_gel,
    check_network,
    check_parameter,
    check_stretched_network,
    fields_of,
    gel_in_groups,
    matrix_of,
    named_parameters,
    takes_solvent,
    values_at,
    with_parameters,
)
from .volumes import all_volumes


def check_model(model: Model, gel: AnyGel) -> None:
    """Raise ValueError, one line, unless they are a `Model` and a gel.

    A gel has Nv, network and volumetric energy, or is a `Composite`.
    """
    check_kind("model", model, Model, "a Model, as discretise(make_cloud(plate)) makes it")
    if isinstance(gel, type) or not all(
        hasattr(matrix_of(gel), name) for name in ("Nv", "network", "volumetric")
    ):
        raise ValueError(
            f"gel: {kind_in_words(gel)} is not accepted; give a gel such as Gel(Nv=1e-3, chi=0.1)"
        )


def localised(model: Model, gel: AnyGel) -> LocalGel:
    """The gel with `LocalValues` in place of its fields; a gel of numbers as it is.

    Of a `Composite` every parameter has local values. ValueError for a network that the plate's
    kinematics cannot have, for other numbers of materials than the plate has regions, for a field
    that does not give one number, and, with the place, for a number that a gel cannot have; traced
    values pass.
    """
    check_model(model, gel)
    own = matrix_of(gel)
    if model.film:
        check_network(own)
    if model.lists.topology.plate.axial_stretch is not None:
        check_stretched_network(own)
    for part in jax.tree.leaves(gel, is_leaf=lambda part: isinstance(part, LocalValues)):
        if isinstance(part, LocalValues) and part.groups.shape != np.shape(model.carries):
            raise ValueError(
                "gel: has the values of its fields on another model; give the fields themselves"
            )
    return _composed(model, gel) if isinstance(gel, Composite) else _with_values(model, gel)


def _with_values(model, gel):
    """The gel or elastomer with `LocalValues` in place of its fields."""
    fields = fields_of(gel)
    if not fields:
        return gel
    with_material = [isinstance(field, WithHoles | NodalField) for field in fields.values()]
    places, frame = _places(model.blocks, _surface_points(model)), model.lists.topology.frame
    reference = _reference_places(model) if any(with_material) else places
    for (name, field), moves in zip(fields.items(), with_material, strict=True):
        chosen = jax.tree.map(frame.to_given, reference if moves else places)
        local = _evaluated(
            name,
            field,
            jax.tree.map(field.frame.from_given, chosen)
            if isinstance(field, NodalField)
            else chosen,
        )
        gel = with_parameters(
            gel, lambda part, field=field, local=local: local if part is field else part
        )
    return gel


def _composed(model, gel):
    """The gel of a `Composite` with the values of each region's material there."""
    check_gel(gel)
    count = len(model.lists.topology.plate.regions)
    if len(gel.regions) != count:
        raise ValueError(
            f"gel: a Composite of {len(gel.regions)} regions does not fit a plate of {count}; "
            "give a material for each region"
        )
    own = [
        named_parameters(_with_values(model, material)) for material in (gel.matrix, *gel.regions)
    ]
    matrix = own[0]
    local = {
        name: _by_region(model, [part.get(name, matrix[name]) for part in own]) for name in matrix
    }
    found = jax.tree.unflatten(
        jax.tree.structure(gel.matrix, is_leaf=lambda part: part is not gel.matrix),
        list(local.values()),
    )
    if not any(isinstance(material, Elastomer) for material in gel.regions):
        return found
    materials = gel.matrix, *gel.regions
    bulk = [
        part["bulk"] if isinstance(material, Elastomer) else 0.0
        for part, material in zip(own, materials, strict=True)
    ]
    return Filled(found, _by_region(model, bulk))


def _by_region(model, parameters):
    """`LocalValues` of a parameter given by regions, the first one outside all of them.

    They are numbers or `LocalValues`. Numbers that are all the same stay one number.
    """
    if all(
        part is parameters[0] or (_is_number(part) and part == parameters[0]) for part in parameters
    ):
        return parameters[0]
    host = jnp if is_traced(parameters) else np  # numbers stay numbers
    numbers = host.stack(
        [
            np.nan if isinstance(part, LocalValues) else host.asarray(part, float)
            for part in parameters
        ]
    )
    regions, blocks = model.lists.region_of_patch, model.blocks

    def chosen(regions, values_of, shape):
        values = host.broadcast_to(numbers[regions], shape)
        for number, part in enumerate(parameters):
            if isinstance(part, LocalValues):
                values = host.where(regions == number, values_of(part), values)
        return values

    own = [regions[np.asarray(block.patches)][:, None] for block in blocks]
    points = tuple(
        chosen(own[k], lambda part, k=k: part.points[k], block.weight.shape)
        for k, block in enumerate(blocks)
    )
    of_groups = np.concatenate(
        [np.tile(r, (1, block.n_groups)).ravel() for r, block in zip(own, blocks, strict=True)]
    )
    outline = _outline_regions(model.lists.topology)
    groups = chosen(of_groups, lambda part: part.groups, of_groups.shape)
    return LocalValues(points, groups, chosen(outline, lambda part: part.outline, outline.shape))


def _is_number(parameter):
    return isinstance(parameter, int | float)


@once_per_owner
def _outline_regions(topology: Topology) -> Int[np.ndarray, " p"]:
    """The region of each outline vertex, and of each node of a free edge."""
    return topology.regions_at(_reference_surface(topology))


def _reference_surface(topology):
    """Outline vertices and nodes of free edges (p, 2), mm, of the cloud that was placed."""
    numbers = [outline.vertices for outline in topology.outlines] + [
        topology.node_vertices[topology.free_edge_nodes]
    ]
    return topology.partition.vertices[np.concatenate(numbers)]


def _surface_points(model):
    """Outline vertices and nodes of free edges (p, 2), mm, on the dry plate."""
    return joined(
        [model.outline.points, taken(model.cloud.nodes, model.lists.topology.free_edge_nodes)]
    )


def shared_gel(gel: LocalGel, body: Body) -> LocalGel:
    """A `localised` gel as the programs of a ``shared`` body take it."""

    def padded(part):
        if not isinstance(part, LocalValues):
            return part
        points = tuple(
            resized(values, block.weight.shape, edge=True)
            for values, block in zip(part.points, body.blocks, strict=True)
        )
        outline = resized(part.outline, (rung(len(part.outline)),), edge=True)
        return LocalValues(points, resized(part.groups, body.carries.shape, edge=True), outline)

    return with_parameters(gel, padded)


def mean_stiffness(gel: LocalGel, model: Model) -> Scalar:
    """The mean of Nv over the dry volume of a `localised` gel, that of elastomers left out."""
    if not isinstance(gel.Nv, LocalValues):
        return gel.Nv
    return _mean_of_local_stiffness(shared_gel(gel, model.shared), model)


@program()
def _mean_of_local_stiffness(gel, model):
    volumes = jnp.where(model.carries & takes_solvent(gel_in_groups(gel)), all_volumes(model), 0.0)
    return jnp.sum(volumes * gel.Nv.groups) / jnp.sum(volumes)


def _places(blocks, outline):
    """Positions, mm, as the fields of `LocalValues`: quadrature points, groups, surfaces.

    Volume groups of the blocks.
    """
    return tuple(block.position for block in blocks), group_positions(blocks), outline


def _reference_places(model):
    """`_places` of the cloud that was placed, numbers, for a cloud that a design has moved."""
    with outside_traces():  # numbers, also inside jit
        parts, outline = _reference_quadrature(model.lists)
        blocks = [
            dataclasses.replace(block, **own)
            for block, own in zip(model.blocks, parts, strict=True)
        ]
        return _places(blocks, outline)


@once_per_owner
def _reference_quadrature(lists: Connectivity):
    """Per block the reference places in `PatchBlock`, and `_reference_surface`.

    Where its points and groups were before holes moved.
    """
    topology, parts = lists.topology, []
    vertices = topology.partition.vertices
    points, weight = topology.quadrature.points(vertices), topology.quadrature.weights(vertices)
    for numbers, patches in zip(lists.points, lists.patches, strict=True):
        at = np.where(numbers >= 0, numbers, numbers[:, :1])
        X, w = points[at], np.where(numbers >= 0, weight[at], 0.0)
        parts.append(
            {
                "position": X,
                "weight": w,
                "group_weight": group_weights(X, w, bool(lists.linear[patches[0]])),
            }
        )
    return parts, _reference_surface(topology)


@once_per_owner
def reference_groups(lists: Connectivity) -> tuple[Float[np.ndarray, "g 2"], Int[np.ndarray, " c"]]:
    """Reference positions (g, 2), mm, of the volume groups, and first group (c,) of each patch.

    Before holes moved, of stabilisation groups too.
    """
    parts, count, first, found = (
        _reference_quadrature(lists)[0],
        0,
        np.zeros(len(lists.linear), dtype=int),
        [],
    )
    for own, patches in zip(parts, lists.patches, strict=True):
        at = _at_groups(
            own["position"],
            own["weight"],
            own["group_weight"],
            n_carrying(bool(lists.linear[patches[0]])),
        )
        first[patches] = count + len(at) // len(patches) * np.arange(len(patches))
        count += len(at)
        found.append(np.asarray(at))
    return np.concatenate(found), first


def group_positions(blocks: Sequence[PatchBlock]) -> Float[Array, "g 2"]:
    """Positions (g, 2), mm, of the volume groups of all blocks."""
    return joined([_at_groups(b.position, b.weight, b.group_weight, b.carrying) for b in blocks])


@compiled(static=("carrying",))
def _at_groups(X, weight, group_weight, carrying):
    carries = np.arange(group_weight.shape[2]) < carrying
    total, volume = (
        jnp.einsum("cq,cqi->ci", weight, X)[:, None],
        jnp.sum(weight, axis=1)[:, None, None],
    )
    own = total * carries[:, None] / carrying + jnp.einsum(
        "cq,cqg,cqi->cgi", weight, group_weight, X
    )
    return (jnp.where(carries[:, None], own * carrying, total) / volume).reshape(-1, 2)


def _evaluated(name, field, places):
    """`LocalValues` of a field at the ``places``; ValueError, see `localised`."""
    shape = jax.eval_shape(field, jax.ShapeDtypeStruct((2,), float)).shape
    if shape != ():
        raise ValueError(
            f"{name}: the field gives an array of shape {shape}, it must give one number for a "
            "position (2,)"
        )

    leaves, structure = jax.tree.flatten(places)
    host = np if not is_traced(leaves) else jnp  # numbers stay numbers inside jit
    X = host.concatenate([host.asarray(leaf).reshape(-1, 2) for leaf in leaves])
    values = field.at(X) if isinstance(field, NodalField) else values_at(field, X).astype(float)
    if not is_traced(values):
        check_parameter(name, values, X)
    cuts = np.cumsum([leaf.size // 2 for leaf in leaves])[:-1]
    parts = [
        v.reshape(leaf.shape[:-1]) for v, leaf in zip(jnp.split(values, cuts), leaves, strict=True)
    ]
    return LocalValues(*jax.tree.unflatten(structure, parts))
