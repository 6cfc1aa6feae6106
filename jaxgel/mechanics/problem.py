"""A model with its gel, loads and control: all that the equations of equilibrium depend on besides the value of the control."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._sizes import resized
from .._tracing import is_traced, value_and_tangents
from .._types import Array, Chemical, Float
from .._validation import Inadmissible
from ..controls import Control, changes_of, check_fields, check_is_control
from ..discretisation import Body, Connectivity, Model
from ..linalg import Pattern
from ..materials import AnyGel
from .contact import with_contact
from .dofs import check_moving, edges_of, unknowns
from .equations import BY_MU, Constraints, Equations
from .local_gel import check_model, localised, shared_gel
from .operators import precomputed_operators
from .pairs import node_pairs, tangent_pattern


@jax.tree_util.register_pytree_with_keys_class
class Problem(Equations):
    """All that a state of equilibrium depends on besides the value of the control: plate, gel, loads, control and contact; a pytree."""

    model: Model
    """Discretised plate, with its self-contact if there is any."""

    def __init__(
        self,
        model: Model,
        gel: AnyGel,
        *,
        loads: Float[Array, "n 2"] | None = None,
        control: Control = BY_MU,
        contact: bool = True,
    ) -> None:
        """The problem of a ``model`` and a gel, driven by the chemical potential (kT) or another ``control``.

        A control (see `controls`: ``temperature``, ``chi``, ``pH``, ``Stretch``, ``Load``, ``Driven`` for an own function) says for each of
        its values which mu, gel, motion of the edges and loads act. ``loads`` (n, 2) are dead nodal forces in kT/v mm besides those of
        the control, see `load_vector`. With ``contact`` the sides of a hole that meet are kept apart, by a range and a stiffness that
        `with_contact` can choose. ValueError, one line, for a gel that does not fit the model and a control that does not fit the gel.
        """
        check_model(model, gel)
        check_is_control(control)
        gel, control = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), (localised(model, gel), control))
        model = with_contact(model, gel) if contact else dataclasses.replace(model, contact=None)
        loads = jax.device_put(np.zeros((model.n_nodes, 2))) if loads is None else jnp.asarray(loads, dtype=float)
        if loads.shape != (model.n_nodes, 2):
            raise ValueError(f"loads: have the shape {loads.shape}, they must have that of the nodes, {(model.n_nodes, 2)}")
        self._set((model, gel, loads, control, None, constraints_of(model.lists, changes_of(control, gel).edges)))
        if self.changes.gel:
            check_fields(control, gel)
        if self.moves_edges:
            check_moving(model.lists.topology)

    @property
    def prepared(self) -> "Problem":
        """The problem with its operators."""
        return (
            self
            if self.operators is not None
            else self.replace(operators=precomputed_operators(self.model, shared_gel(self.gel, self.model.shared)))
        )

    def at(self, value: Chemical) -> tuple["Problem", Chemical]:
        """See `Equations`."""
        now, mu = super().at(value)
        if "shared" in self.__dict__:  # the control changes neither the body nor the constraints
            now.__dict__["shared"] = _shared(now, self.shared.model, self.shared.constraints)
        return now, mu

    @functools.cached_property
    def shared(self) -> Equations:
        """The equations as the compiled programs take them."""
        return _shared(self, self.model.shared, shared_constraints(self.constraints, self.model, self.model.shared))

    @property
    def network(self) -> Float[np.ndarray, " p"]:
        """Stiffness of the dry network between the nodes of every pair of `node_pairs`, kT/v."""
        return np.asarray(self.prepared.operators.network)[: len(node_pairs(self.model.lists)[0])]

    def __repr__(self) -> str:
        """What is solved, in one line."""
        return f"Problem along {self.control.name} of a {self.model!r}"

    @functools.cached_property
    def without_contact(self) -> "Problem":
        """The same problem without self-contact, for states in which no outline is near itself."""
        return self.replace(model=dataclasses.replace(self.model, contact=None)) if self.has_contact else self

    @property
    def pattern(self) -> Pattern:
        """Pattern of the tangent; with contact it couples all nodes near a hole."""
        model = self.model
        return tangent_pattern(model.lists, model.dmax if self.has_contact else None)


def _shared(problem, body, constraints):
    """The shared equations with the shared ``body`` and ``constraints``."""
    loads = resized(problem.loads, body.nodes.shape)
    return Equations.tree_unflatten(None, (body, shared_gel(problem.gel, body), loads, problem.control, problem.operators, constraints))


def shared_tangents(problem: Problem, dots: Problem) -> tuple[Equations, Equations]:
    """The shared equations of a problem, and their tangents for those of the problem; without operators, which follow from the model."""
    inputs = problem.replace(operators=None), dots.replace(operators=None)
    return value_and_tangents(lambda problem: problem.shared, *inputs)


@once_per_owner
def constraints_of(lists: Connectivity, driven: bool) -> Constraints:
    """The `Constraints` of a plate with these ``lists``, whose edges may be ``driven`` by a control."""
    return Constraints(unknowns(lists), edges_of(lists.topology, driven), _nearest_patches(lists))


def _nearest_patches(lists):
    """The patch (n,), counted block after block, nearest each node of the reference cloud."""
    points = lists.topology.partition.vertices[lists.topology.node_vertices]
    patches = np.concatenate(lists.patches)
    real = lists.support[patches, :, None] > 0
    centres = np.sum(np.where(real, points[lists.nodes[patches]], 0.0), axis=1) / real.sum(axis=1)
    return cKDTree(centres).query(points)[1]


def shared_constraints(constraints: Constraints, model: Model, body: Body) -> Constraints:
    """The constraints of a model for its ``shared`` body."""
    edges, nodes = constraints.edges, len(body.nodes)
    starts = np.cumsum([0] + [len(block.nodes) for block in model.blocks])
    moved = np.cumsum([0] + [len(block.nodes) for block in body.blocks])
    block = np.searchsorted(starts, constraints.nearest, side="right") - 1
    nearest = resized(constraints.nearest - starts[block] + moved[block], (nodes,))
    fields = resized(edges.fields, (*edges.fields.shape[:1], nodes, 2))
    return Constraints(constraints.free.shared, dataclasses.replace(edges, fields=fields), nearest)


def check_driven(problem: Problem, values: Float[np.ndarray, " k"]) -> None:
    """Raise ValueError, one line, where what a control says at one of the ``values`` does not fit the plate; traced values pass."""
    control, plate = problem.control, problem.model.lists.topology.plate
    if is_traced(problem):
        return
    settings = [control(float(value), problem.gel) for value in values]
    if settings[0].loads is not None and jnp.shape(settings[0].loads) != (problem.model.n_nodes, 2):
        shape, needed = jnp.shape(settings[0].loads), (problem.model.n_nodes, 2)
        raise ValueError(f"{control.name}: loads have the shape {shape}, they must have that of the nodes, {needed}")
    for edge in settings[0].displacement or {}:
        if plate.edges[edge] in ("free", "periodic"):
            raise ValueError(f"{control.name}: the {edge} edge is {plate.edges[edge]}, only one that is held can be displaced")
    F = np.array([np.eye(2) if setting.deformation is None else setting.deformation for setting in settings])
    if (np.linalg.det(F) <= 0).any():
        k = int(np.argmax(np.linalg.det(F) <= 0))
        raise Inadmissible(f"{control.name}: {values[k]:g} is not accepted, it would turn the plate inside out")
    if any(np.ptp(F[:, i, j]) > 0 for i, j in plate.free_strains):
        raise ValueError(f"{control.name}: a component of the macroscopic deformation that it drives is free in this plate")
