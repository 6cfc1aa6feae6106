"""Integration cells, quadrature points and shape function gradients of a cloud, with the correction that makes the patch test exact.

Index letters: ``c`` cell, ``q`` quadrature point of a cell, ``p`` point, ``a b`` node of a cell's list, ``i j`` space. A cell's node list
holds all nodes whose support reaches the cell or its contour; padding has support 0. Cells of similar size share a ``Block`` of
padded arrays.
"""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from ..cloud import EDGE_POINTS, edge_points, square_cells
from ..geometry import inside_holes
from ..linalg import SOLVERS
from .checks import _check_reproduction, _check_support
from .consistency import _corrected_gradients, wall_ends
from .interpolation import SKIN, Probe, evaluate_points, probe_at, probe_lists
from .moving_least_squares import KINDS, n_monomials
from .neighbours import is_moved, pad_nodes, pad_rows, reaching_nodes

DMAX = 2.95  # support radius over spacing: nearly three grid lines to each side, and clear of the third, where round-off would decide
PAPER_DMAX = 3.5
PENALTY = 1e3  # kT/v per mm, the paper's
CONDITIONS = ("nodes", "penalty", "lagrange")
INTERPOLATING = ("imls", "iicvmls")
MIDLINE_POINTS = 401  # samples of the plate's midline


def _pytree(*, data, meta=()):
    return functools.partial(jax.tree_util.register_dataclass, data_fields=list(data), meta_fields=list(meta))


@_pytree(data=("cells", "nodes", "dphi", "weight"))
@dataclasses.dataclass(frozen=True)
class Block:
    """Cells of similar size."""

    cells: jax.Array
    """(c,) cell numbers."""
    nodes: jax.Array
    """(c, a) node numbers in ascending order, padded with the first one."""
    dphi: jax.Array
    """(c, q, a, 2) shape function gradients, 1/mm; 0 for padded nodes."""
    weight: jax.Array
    """(c, q) quadrature weights, mm^2; 0 for padded points."""


@dataclasses.dataclass(frozen=True, eq=False)
class Lists:
    """What does not move with the holes: neighbours, quadrature layout, and what later stages derive from them; hashed by identity."""

    topology: object
    """The cloud's topology."""
    nodes: np.ndarray
    """(n_cells, a) node numbers in ascending order, padded with the first one."""
    support: np.ndarray
    """(n_cells, a) support radius of each node, mm; 0 for padding."""
    points: tuple
    """Per block (c, q) numbers of the cells' quadrature points, -1 for padding."""
    cells: tuple
    """Per block (c,) cell numbers."""
    wall: np.ndarray
    """(e, 2) places in the cell's node list of the wall nodes between which each contour edge lies; -1 where it is not essential."""
    cache: dict = dataclasses.field(default_factory=dict)
    """Sparsity patterns and the like, filled by later stages."""


@_pytree(
    data=("cloud", "blocks", "outline", "midline", "core", "contact"),
    meta=("lists", "basis", "dmax", "method", "quadrature", "kind", "conditions", "penalty", "solver"),
)
@dataclasses.dataclass(frozen=True)
class Model:
    """A cloud with its cells, quadrature points and shape functions: all that is needed to integrate an energy."""

    cloud: object
    """The ``Cloud``."""
    blocks: tuple
    """``Block``s of cells of similar size."""
    outline: Probe
    """All outline vertices, arc after arc."""
    midline: Probe
    """Points of the plate's horizontal midline in the dry gel, from left to right."""
    core: Probe
    """The plate's core point; its gradients are nan where that lies in a hole."""
    lists: Lists
    """Static lists."""
    basis: str
    """``"linear"`` or ``"quadratic"``."""
    dmax: float
    """Support radius over node spacing."""
    method: str
    """``"mixed"``: one pressure per cell; ``"displacement"``: J at every quadrature point."""
    quadrature: str
    """``"conforming"`` or ``"paper"``."""
    kind: str
    """Kind of shape functions, see ``shape_functions``."""
    conditions: str = "nodes"
    """How essential conditions are imposed: ``"nodes"``, or weakly, ``"penalty"`` or ``"lagrange"``; see ``walls``."""
    penalty: float = 0.0
    """Penalty factor, kT/v per mm; 0 without."""
    solver: str = "auto"
    """How linear systems are solved, ``"auto"``, ``"direct"`` or ``"iterative"``; see ``linear_solve``."""
    contact: object = None
    """The ``contact.Contact`` of hole boundaries with themselves; None where they may overlap."""

    @property
    def n_nodes(self):
        """Number of nodes (int)."""
        return len(self.lists.topology.node_vertices)

    @property
    def n_cells(self):
        """Number of cells (int)."""
        return len(self.lists.nodes)

    @property
    def n_points(self):
        """Number of quadrature points (int)."""
        return sum(int((numbers >= 0).sum()) for numbers in self.lists.points)


def discretise(
    cloud,
    *,
    basis="quadratic",
    dmax=None,
    method="mixed",
    quadrature="conforming",
    kind="imls",
    conditions="nodes",
    penalty=PENALTY,
    cells=None,
    skin=None,
    solver="auto",
):
    """``Model`` of a cloud: cells, quadrature points, shape function gradients.

    ``dmax`` is the support radius over the node spacing (2.95 by default, 3.5 for the paper's quadrature). ``quadrature="conforming"``
    partitions the gel exactly and corrects the gradients so that linear fields are integrated exactly (patch test);
    ``"paper"`` takes 4 x 4 Gauss points in each of ``cells`` x ``cells`` squares and drops the points in holes (Table 1).
    ``kind`` is that of ``shape_functions``. Those that do not interpolate, ``"icvmls"`` and ``"mls"``, need ``conditions="penalty"``, with
    the factor ``penalty`` in kT/v per mm, or ``"lagrange"`` instead of conditions at the ``"nodes"``: see ``walls``.
    ``skin`` (mm) enlarges the neighbour lists by the distance that points of a moved cloud may have come closer; by default 0 on
    the reference cloud and a quarter of the spacing on a placed one. ``solver`` is that of ``linear_solve``. Raises ValueError for
    unknown options and where a point has too few neighbours for the basis.
    """
    _check_options(basis, method, quadrature, kind, solver)
    _check_conditions(kind, conditions, penalty)
    dmax = (PAPER_DMAX if quadrature == "paper" else DMAX) if dmax is None else float(dmax)
    if not dmax > 1.0:
        raise ValueError(f"dmax: {dmax} is too small; the support must reach beyond the next node (dmax > 1)")
    if quadrature == "paper":
        if is_moved(cloud):
            raise ValueError("quadrature: 'paper' drops points in holes and cannot follow moving holes; use 'conforming'")
        key = ("paper", basis, dmax, cells)
        if key not in cloud.topology.cache:
            cloud.topology.cache[key] = _paper_lists(cloud.topology, basis, dmax, cells)
        lists, points, weight = cloud.topology.cache[key]
        owner = np.concatenate([np.repeat(c, (n >= 0).sum(axis=1)) for c, n in zip(lists.cells, lists.points, strict=True)])
        _, dphi = evaluate_points(cloud.nodes, points, lists.nodes, lists.support, owner, basis=basis, kind=kind)
    else:
        skin = (SKIN * cloud.spacing if is_moved(cloud) else 0.0) if skin is None else float(skin)
        key = ("conforming", basis, dmax, skin)
        if key not in cloud.topology.cache:
            with jax.ensure_compile_time_eval():  # lists are made of numbers, also inside jit
                cloud.topology.cache[key] = _conforming_lists(cloud.topology, basis, dmax, skin)
        lists = cloud.topology.cache[key]
        wall = lists.wall if conditions == "nodes" else np.full_like(lists.wall, -1)
        dphi, weight = _corrected_gradients(cloud.nodes, cloud.vertices, lists, basis, kind, wall)
    probes = _observed(cloud, lists, basis, dmax, kind)
    how = conditions, float(penalty) if conditions == "penalty" else 0.0
    model = Model(cloud, _blocks(lists, dphi, weight), *probes, lists, basis, dmax, method, quadrature, kind, *how, solver)
    _check_reproduction(model)
    return model


def _observed(cloud, lists, basis, dmax, kind):
    """The model's probes: outline, midline and core."""
    topology = cloud.topology
    outline = np.concatenate([o.vertices for o in topology.outlines]) if topology.outlines else np.zeros(0, dtype=int)
    plate = topology.plate
    x = plate.width * np.linspace(-0.5, 0.5, MIDLINE_POINTS)
    midline = np.stack([x, np.zeros_like(x)], axis=1)
    midline = midline[~inside_holes(plate, midline, -1e-9 * topology.spacing)]
    in_hole = inside_holes(plate, [plate.core])[0]  # then any point of the gel: 0 times nan would spoil every reverse derivative
    fixed = np.concatenate([midline, midline[:1] if in_hole else [plate.core]])
    key = ("observed", is_moved(cloud))
    if key not in lists.cache:
        reference = np.concatenate([topology.partition.vertices[outline], fixed])
        room = SKIN * topology.spacing * is_moved(cloud) + plate.width / (MIDLINE_POINTS - 1)
        lists.cache[key] = probe_lists(topology, dmax, reference, room)
    probe = probe_at(cloud, _followed(cloud.vertices, outline, fixed), lists.cache[key], basis, kind)
    outline, midline, core = _cut(probe, (len(outline), len(outline) + len(midline)))
    if in_hole:
        core = dataclasses.replace(core, dphi=jnp.full_like(core.dphi, jnp.nan))
    return outline, midline, core


@jax.jit
def _followed(vertices, outline, fixed):
    return jnp.concatenate([vertices[outline], fixed])


@functools.partial(jax.jit, static_argnames="cuts")
def _cut(probe, cuts):
    """The ``Probe`` in parts that begin at 0 and at the ``cuts``."""
    ends = itertools.pairwise((0, *cuts, len(probe.nodes)))
    return [jax.tree.map(lambda leaf, part=slice(*pair): leaf[part], probe) for pair in ends]


def _conforming_lists(topology, basis, dmax, skin):
    """``Lists`` of the conforming cells, made on the reference plate."""
    part, quadrature = topology.partition, topology.quadrature
    edges, edge_owner = part.contour_edges
    inner, on_edge = np.asarray(quadrature.points(part.vertices)), edge_points(part.vertices, edges)
    support = dmax * topology.node_spacing
    points = np.concatenate([inner, on_edge])
    _check_support(topology, points, support, basis)
    owner = np.concatenate([quadrature.owner, np.repeat(edge_owner, len(EDGE_POINTS))])
    nodes, supports = pad_nodes(*reaching_nodes(topology, points, owner, support, skin), support)

    numbers, counts = np.arange(len(inner)), np.bincount(quadrature.owner)
    groups = _groups(counts)
    wall_nodes = wall_ends(topology, edges)
    hit = (nodes[edge_owner][:, None, :] == wall_nodes[:, :, None]) & (supports[edge_owner] > 0)[:, None, :]
    wall = np.where(hit.any(axis=2), hit.argmax(axis=2), -1)
    if np.any((wall < 0) != (wall_nodes < 0)):
        raise ValueError(f"dmax: {dmax} is too small for the supports to reach along the plate's edges; use a larger one")
    return Lists(topology, nodes, supports, tuple(pad_rows(numbers, counts, g) for g in groups), groups, wall)


def _groups(counts):
    """Cell numbers in groups of similar numbers of points: whole squares and cut cells."""
    cut = counts > len(EDGE_POINTS) ** 2
    return tuple(group for group in (np.flatnonzero(~cut), np.flatnonzero(cut)) if len(group))


def _blocks(lists, dphi, weight):
    """``Block``s from gradients (p, a, 2) and weights (p,) of all quadrature points."""
    widths = tuple(int((lists.support[cells] > 0).sum(axis=1).max()) for cells in lists.cells)
    values = _by_cell(dphi, weight, lists.points, widths)
    return tuple(Block(c, lists.nodes[c, :n], *of_cells) for c, n, of_cells in zip(lists.cells, widths, values, strict=True))


@functools.partial(jax.jit, static_argnames="widths")
def _by_cell(dphi, weight, points, widths):
    """Per block the gradients (c, q, a, 2), with lists of the given width, and weights (c, q) of the numbered ``points`` (c, q)."""
    values = []
    for numbers, n in zip(points, widths, strict=True):
        at = jnp.where(numbers >= 0, numbers, numbers[:, :1])  # padding repeats a point of its own cell, where every energy is finite
        values.append((dphi[at, :n], jnp.where(numbers >= 0, weight[at], 0.0)))
    return values


def _paper_lists(topology, basis, dmax, cells):
    """``Lists``, points (p, 2) and weights (p,) of square cells with 4 x 4 Gauss points, points in holes dropped (Table 1)."""
    plate = topology.plate
    own = plate.cells if plate.cells and topology.spacing == plate.spacing else round(min(plate.width, plate.height) / topology.spacing)
    points, weight = square_cells(plate, own if cells is None else cells)
    outside = ~inside_holes(plate, points.reshape(-1, 2)).reshape(weight.shape)
    keep = outside[outside.any(axis=1)]
    points, weight = points[outside], weight[outside]
    support = dmax * topology.node_spacing
    _check_support(topology, points, support, basis)
    counts = keep.sum(axis=1)
    owner = np.repeat(np.arange(len(counts)), counts)
    nodes, supports = pad_nodes(*reaching_nodes(topology, points, owner, support, 0.0), support)
    members = np.arange(len(counts))
    numbers = pad_rows(np.arange(len(points)), counts, members)
    return Lists(topology, nodes, supports, (numbers,), (members,), np.full((0, 2), -1)), points, weight


def _check_options(basis, method, quadrature, kind, solver):
    n_monomials(basis)
    if method not in ("mixed", "displacement"):
        raise ValueError(f"method: {method!r} is not 'mixed' or 'displacement'")
    if quadrature not in ("conforming", "paper"):
        raise ValueError(f"quadrature: {quadrature!r} is not 'conforming' or 'paper'")
    if kind not in KINDS:
        raise ValueError(f"kind: {kind!r} is not one of {', '.join(KINDS)}")
    if solver not in SOLVERS:
        raise ValueError(f"solver: {solver!r} is not one of {', '.join(SOLVERS)}")


def _check_conditions(kind, conditions, penalty):
    if conditions not in CONDITIONS:
        raise ValueError(f"conditions: {conditions!r} is not one of {', '.join(CONDITIONS)}")
    if conditions == "nodes" and kind not in INTERPOLATING:
        raise ValueError(
            f"kind: {kind!r} does not interpolate, so conditions at the nodes need 'imls' or 'iicvmls'; or use 'penalty', 'lagrange'"
        )
    if not 0 < penalty < np.inf:
        raise ValueError(f"penalty: {penalty!r} is not a finite number above 0 (kT/v per mm)")
