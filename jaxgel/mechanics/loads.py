"""Dead loads, body force and edge traction, as consistent nodal forces.

The integrals run over the cells and edges that partition the dry gel, along edges with the points
of the fluxes through cells. So the sum of the nodal forces is the total load, and a uniform
traction balances a uniform stress.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._tracing import is_traced
from .._types import Array, Float
from .._validation import PAIR, check_kind, did_you_mean, finite_numbers, tabled
from ..discretisation import Model, make_probe, plate_edge_ends
from ..geometry import EDGES, edge_lines, held_components

SIMPSON = np.array([1.0, 4.0, 1.0]) / 6  # shares of start, middle and end of an edge
BALANCE = 1e-9  # largest resultant, over the sum of the forces' sizes, that counts as none


@dataclasses.dataclass(frozen=True)
class Loads:
    """Constant dead loads of a case file or a `DesignProblem`; the user makes it.

    Raises `ValueError` for a force that is not two numbers, and for an unknown edge.
    """

    body_force: Sequence[float] | Float[Array, "2"] | None = dataclasses.field(
        default=None, metadata={"schema": PAIR}
    )
    """(2,) force per dry area, kT/v per mm; None for none."""
    traction: Mapping = dataclasses.field(
        default_factory=dict, metadata={"schema": tabled(dict.fromkeys(EDGES, PAIR))}
    )
    """Edge -> force (2,) per dry length, kT/v."""

    def __post_init__(self) -> None:
        if self.body_force is not None:
            object.__setattr__(
                self, "body_force", finite_numbers(self.body_force, (2,), "loads.body_force")
            )
        if not isinstance(self.traction, Mapping):
            raise ValueError(
                f"loads.traction: {self.traction!r} is not a table such as {{ top = [0.0, 1e-3] }}"
            )
        for edge in self.traction:
            if edge not in EDGES:
                raise ValueError(
                    f"loads.traction: unknown edge {edge!r}; {did_you_mean(edge, EDGES)}"
                )
        traction = {
            edge: finite_numbers(force, (2,), f"loads.traction.{edge}")
            for edge, force in self.traction.items()
        }
        object.__setattr__(self, "traction", traction)

    def of(self, model: Model) -> Float[Array, "n 2"] | None:
        """``load_vector`` (n, 2) of a model; None if there is no load."""
        return (
            load_vector(model, body_force=self.body_force, traction=self.traction)
            if self.body_force or self.traction
            else None
        )


def load_vector(
    model: Model,
    *,
    body_force: Sequence[float] | Float[Array, "2"] | Callable[..., Any] | None = None,
    traction: Mapping[str, Any] | None = None,
) -> Float[Array, "n 2"]:
    """Nodal forces (n, 2), kT/v mm, of dead loads: the `loads` of a `Problem`.

    Arguments:

    - `model`: the `Model`.
    - `body_force`: force per dry area, kT/v per mm: a constant (2,), or a function from a dry point
      (2,), mm, to (2,).
    - `traction`: edge, "left", "right", "bottom" or "top" -> force per dry length, kT/v, a constant
      (2,) or a function of the dry point.

    Returns the forces; their work is sum(loads * x). On edges with a prescribed displacement the
    shape functions are linear between the wall nodes, as in `discretise`; there only the component
    along a roller edge has an effect.

    Raises `ValueError` for an unknown edge, a force that is no vector, and a resultant along which
    no edge of the plate prescribes the displacement.

    Source: Deng et al. (2020), Eq. (50).

    >>> import jaxgel
    >>> plate = jaxgel.sample("square")
    >>> model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.25), basis="linear")
    >>> load_vector(model, traction={"top": (0.0, 2e-3)}).sum(axis=0).round(12)
    Array([0.   , 0.002], dtype=float64)
    """
    check_kind("model", model, Model, "a Model, as discretise(make_cloud(plate)) makes it")
    loads = jnp.zeros((model.n_nodes, 2))
    if body_force is not None:
        loads = loads + _body_load(model, body_force)
    for edge, force in (traction or {}).items():
        if edge not in EDGES:
            raise ValueError(f"traction: unknown edge {edge!r}; {did_you_mean(edge, EDGES)}")
        loads = loads + _edge_load(model, edge, force)
    _check_resultant(model.lists.topology.plate, loads)
    return loads


def _check_resultant(plate, loads):
    held = {component for edge in EDGES for component in held_components(plate.edges, edge)}
    for component in {0, 1} - held if not is_traced(loads) else ():
        force = np.asarray(loads)[:, component]
        if abs(force.sum()) > BALANCE * np.abs(force).sum():
            raise ValueError(
                f"loads: a resultant of {force.sum():.3g} kT/v mm along {'xy'[component]}, in "
                "which no edge holds the plate"
            )


def _body_load(model, body_force):
    topology, vertices = model.lists.topology, model.cloud.vertices
    quadrature = topology.quadrature
    points = quadrature.points(vertices)
    load = quadrature.weights(vertices)[:, None] * _at_points(
        body_force, topology.frame.to_given(points), "body_force"
    )
    return _true_trace(model, points, quadrature.points(topology.partition.vertices), load)


def _edge_load(model, edge, force):
    topology = model.lists.topology
    part, (axis, coordinate) = topology.partition, edge_lines(topology.plate)[edge]
    ends = part.contour_edges[0]
    on = np.abs(part.vertices[ends][:, :, axis] - coordinate).max(axis=1) < 1e-9 * topology.spacing
    ends = ends[on]

    points, length = _edge_rule(model.cloud.vertices, ends)
    load = length[:, None] * _at_points(force, topology.frame.to_given(points), f"traction: {edge}")
    wall = np.repeat(plate_edge_ends(topology, ends), len(SIMPSON), axis=0)
    if np.all(wall < 0):
        return _true_trace(model, points, _along(part.vertices, ends), load)
    return _linear_trace(model.cloud.nodes, points, wall, 1 - axis, load)


@compiled()
def _edge_rule(vertices, ends):
    """Simpson points (3 e, 2), mm, along edges between ``ends`` (e, 2), and their lengths, mm."""
    length = jnp.linalg.norm(vertices[ends[:, 1]] - vertices[ends[:, 0]], axis=1)
    return _along(vertices, ends), jnp.outer(length, SIMPSON).ravel()


def _along(vertices, ends):
    """Start, middle and end (3 e, 2) of the straight edges between the ``ends`` (e, 2)."""
    start, end = vertices[ends[:, 0], None], vertices[ends[:, 1], None]
    return (start + np.array([[0.0], [0.5], [1.0]]) * (end - start)).reshape(-1, 2)


def _true_trace(model, points, reference_points, load):
    """Nodal forces (n, 2) of point loads (p, 2) by the shape functions at the points."""
    probe = make_probe(model, points, reference_points)
    return _added(probe.nodes, probe.phi, load, count=model.n_nodes)


@compiled(static=("count",))
def _added(nodes, phi, load, *, count):
    return jnp.zeros((count, 2)).at[nodes].add(phi[:, :, None] * load[:, None, :])


@compiled(static=("along",))
def _linear_trace(nodes, points, wall, along, load):
    """Nodal forces (n, 2) of point loads (p, 2), shared by the two wall nodes around each."""
    first, second = (nodes[wall[:, k], along] for k in range(2))
    share = ((points[:, along] - first) / (second - first))[:, None]
    return (
        jnp.zeros_like(nodes)
        .at[wall[:, 0]]
        .add((1 - share) * load)
        .at[wall[:, 1]]
        .add(share * load)
    )


def _at_points(force, points, field):
    """The force (2,), or function of the point, at the points (p, 2): (p, 2)."""
    values = (
        jax.vmap(force)(points)
        if callable(force)
        else jnp.broadcast_to(jnp.asarray(force, float), (len(points), *np.shape(force)))
    )
    if values.shape != points.shape:
        raise ValueError(
            f"{field}: shape {values.shape[1:]} is not accepted, give a vector (2,) or a function "
            "of the dry point to (2,)"
        )
    return values
