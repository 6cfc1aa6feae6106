"""Shape functions at probe points: material points, the midline and the core of the dry plate."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .._memo import once_per_owner
from .._tracing import is_traced, numbers_of, outside_traces
from .._types import Array, Float
from ..cloud import Topology
from ..geometry import Frame, inside_holes
from .interpolation import Interpolation, evaluate_points, interpolate
from .model import Model
from .moving_least_squares import shape_functions
from .neighbours import neighbours_of_points

# of absolute values of shape functions: below 3 in the gel, and more away from it, where they
# extrapolate
LARGEST_SUM = 10.0
MIDLINE_POINTS = 401  # samples of the plate's midline, those in holes included


@jax.tree_util.register_pytree_node_class
class NodalField:
    """A field by its values at the nodes of a model; the user makes it, as a parameter of a gel.

    The shape functions of the model interpolate it. A pytree whose data are the values. It belongs
    to the model's cloud as that was made, on its reference plate. As the parameter of a gel it
    moves with the nodes: where a design moves holes, each point of the material keeps its value, as
    with `materials.WithHoles`. On another cloud, a finer one for instance, it is evaluated at the
    points of that cloud on its own reference plate. Values at nodes and polynomials of the basis
    are reproduced. Raises `ValueError` for another number of values than the model has nodes.

    >>> import jax.numpy as jnp
    >>> import jaxgel
    >>> model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(2, 2, spacing=0.5)))
    >>> field = NodalField(model.cloud.nodes[:, 0] ** 2, model)
    >>> [round(float(value), 6) for value in field.at([[0.5, 0.3], [-0.7, 0.1], [9.0, 0.0]])]
    [0.25, 0.49, nan]
    """

    values: Float[Array, " n"]
    """Value at each node, in the unit of the parameter."""

    def __init__(self, values: Float[Array, " n"], model: Model) -> None:
        if np.shape(values) != (model.n_nodes,):
            raise ValueError(
                f"values: an array of shape {np.shape(values)}, it must have one number for each "
                f"of {model.n_nodes} nodes"
            )
        self.values, self._shape_functions = values, (model.cloud.topology, model.basis, model.dmax)

    @property
    def frame(self) -> Frame:
        """The frame of its cloud: positions are those in it."""
        return self._shape_functions[0].frame

    def tree_flatten(self) -> tuple:
        """The values, and what does not change."""
        return (self.values,), self._shape_functions

    @classmethod
    def tree_unflatten(cls, shape_functions: tuple, values: tuple) -> "NodalField":
        """The field with these values."""
        field = object.__new__(cls)
        (field.values,), field._shape_functions = values, shape_functions
        return field

    def __call__(self, X: Float[Array, " 2"]) -> Float[Array, ""]:
        """Value at one position X (2,), mm, which may be traced.

        All nodes of all regions are looked at: see ``at`` for many positions.
        """
        topology, basis, dmax = self._shape_functions
        phi = shape_functions(
            X, topology.nodes, dmax * topology.node_spacing, basis=basis, kind="imls"
        )
        return phi @ jnp.asarray(self.values)

    def at(self, points: Float[Array, "p 2"]) -> Float[Array, " p"]:
        """Values at many concrete ``points``, mm; nan away from the nodes.

        Their neighbours are searched on the host.
        """
        topology, basis, dmax = self._shape_functions
        points, nodes = np.asarray(points, dtype=float), topology.nodes
        with outside_traces():  # numbers, also inside jit
            found = neighbours_of_points(topology, dmax, points)
            # one column at least
            lists, supports = (np.pad(part, ((0, 0), (0, 1))) for part in found)
            own = np.arange(len(points))
            phi = np.asarray(
                evaluate_points(nodes, points, lists, supports, own, basis=basis, gradients=False)[
                    0
                ]
            )
        missed = np.linalg.norm(np.einsum("pa,pai->pi", phi, nodes[lists]) - points, axis=1)
        reached = (missed < 1e-6 * topology.spacing) & (np.abs(phi).sum(axis=1) < LARGEST_SUM)
        values = jnp.einsum(
            "pa,pa->p", np.where(reached[:, None], phi, 0.0), jnp.asarray(self.values)[lists]
        )
        return jnp.where(reached, values, jnp.nan)


def make_probe(
    model: Model, points: Float[Array, "p 2"], reference_points: Float[Array, "p 2"] | None = None
) -> Interpolation:
    """`Interpolation` at material points of the dry plate: positions and gradients there.

    Arguments:

    - `model`: the `Model`.
    - `points` (p, 2): positions on the dry plate, mm.
    - `reference_points` (p, 2): their positions on the reference plate, mm, if `points` are traced;
      `points` by default.

    Returns the interpolation, whose `position` takes nodal positions (n, 2), mm, to (p, 2).

    >>> import jaxgel
    >>> model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(2, 2, spacing=0.5)))
    >>> probe = make_probe(model, np.array([[0.5, 0.3]]))
    >>> [round(float(v), 6) for v in probe.position(2 * model.nodes)[0]]
    [1.0, 0.6]
    """
    reference_points, cloud = (
        np.asarray(points if reference_points is None else reference_points),
        model.cloud,
    )
    neighbours = neighbours_of_points(cloud.topology, model.dmax, reference_points)
    return interpolate(
        cloud, points if is_traced(points) else np.asarray(points), neighbours, model.basis
    )


@once_per_owner
def midline_probe(model: Model) -> Interpolation:
    """``Interpolation`` at the points (p, 2) on y = 0 of the dry gel, from left to right.

    It follows the model's cloud.
    """
    return _interpolated(model, *_midline(model.cloud.topology, model.dmax))


def midline_points(topology: Topology, dmax: float) -> Float[np.ndarray, "p 2"]:
    """The points (p, 2) of `midline_probe`, mm; ``dmax`` is the model's."""
    return _midline(topology, dmax)[0]


@once_per_owner
def core_probe(model: Model) -> Interpolation:
    """``Interpolation`` at the plate's core point (1, 2) on the model's cloud.

    Its gradients are nan if the core lies in a hole.
    """
    points, neighbours, in_hole = _core(model.cloud.topology, model.dmax)
    probe = _interpolated(model, points, neighbours)
    return dataclasses.replace(probe, dphi=jnp.full_like(probe.dphi, jnp.nan)) if in_hole else probe


def _interpolated(model, points, neighbours):
    """``Interpolation`` on the model's cloud: numbers, also inside jit, unless the cloud moves."""
    with numbers_of(model.cloud.nodes):
        return interpolate(model.cloud, points, neighbours, model.basis)


@once_per_owner
def _midline(topology: Topology, dmax: float):
    """Points (p, 2) of the gel on the midline, mm, and their neighbour lists."""
    points = np.stack(
        [topology.plate.width * np.linspace(-0.5, 0.5, MIDLINE_POINTS), np.zeros(MIDLINE_POINTS)],
        axis=1,
    )
    points = points[~inside_holes(topology.plate, points, -1e-9 * topology.spacing)]
    return points, neighbours_of_points(topology, dmax, points)


@once_per_owner
def _core(topology: Topology, dmax: float):
    """The core point (1, 2), mm, its neighbour lists, and whether it lies in a hole.

    In a hole it is replaced by a point of the gel: 0 times nan would spoil every reverse
    derivative.
    """
    core = np.array([topology.plate.core or (0.0, 0.0)])
    in_hole = bool(inside_holes(topology.plate, core)[0])
    points = _midline(topology, dmax)[0][:1] if in_hole else core
    return points, neighbours_of_points(topology, dmax, points), in_hole
