"""A model with its gel, loads and control: the equations but for the control's value."""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._primitives import differentiated_value
from .._sizes import resized
from .._tracing import is_traced, outside_traces, value_and_tangents
from .._types import Array, Chemical, Float, Scalar
from .._validation import Inadmissible
from ..controls import Control, changes_of, check_fields, check_is_control
from ..discretisation import Body, Connectivity, Model
from ..linalg import Pattern
from ..materials import AnyGel
from .contact import ContactPairs, no_pairs, with_contact
from .dofs import check_moving, edges_of, unknowns
from .equations import BY_MU, Constraints, Equations
from .local_gel import check_model, localised, shared_gel
from .operators import precomputed_operators
from .pairs import couplings, node_pairs, tangent_pattern
from .surfaces import check_obstacles, pairs_touching


@jax.tree_util.register_pytree_with_keys_class
class Problem(Equations):
    """All that an equilibrium depends on besides the value of the control; the user makes it.

    It holds plate, gel, loads, control and contact. A pytree.
    """

    model: Model
    """Discretised plate, with its contact if there is any."""

    def __init__(
        self,
        model: Model,
        gel: AnyGel,
        *,
        loads: Float[Array, "n 2"] | None = None,
        control: Control = BY_MU,
        contact: bool = True,
        contact_range: Scalar | None = None,
    ) -> None:
        """The problem of a model and a gel, with the chemical potential or another control.

        Arguments:

        - `model`: the `Model`, of `discretise`.
        - `gel`: a `Gel`, another gel, or a `Composite` for a plate with regions.
        - `loads` (n, 2): dead nodal forces, kT/v mm, besides those of the control, see
          `load_vector`.
        - `control`: function of its value that gives mu, gel, motion of the edges and loads, see
          `controls`: `temperature`, `chi`, `pH`, `Stretch`, `Load`, `Driven` for an own function;
          the chemical potential, kT, by default.
        - `contact`: whether surfaces nearer than `contact_range` repel each other.
        - `contact_range`: range of contact, mm; 1/80 of the plate's shorter side by default, see
          `with_contact`, which can choose the stiffness, too.

        Raises `ValueError`, one line, for a gel that does not fit the model, a control that does
        not fit the gel, loads of another shape, and obstacles without contact.
        """
        check_model(model, gel)
        check_is_control(control)
        gel, control = jax.tree.map(_as_float, (localised(model, gel), control))
        if contact_range is not None and not is_traced(contact_range) and not contact_range > 0:
            raise ValueError(
                f"contact_range: {contact_range!r} is not accepted; give a length > 0 in mm"
            )
        model = (
            with_contact(model, gel, range=contact_range)
            if contact
            else dataclasses.replace(model, contact=None)
        )
        loads = _as_float(np.zeros((model.n_nodes, 2)) if loads is None else loads)
        if loads.shape != (model.n_nodes, 2):
            raise ValueError(
                f"loads: have the shape {loads.shape}, they must have that of the nodes, "
                f"{(model.n_nodes, 2)}"
            )
        if model.contact is None and model.cloud.plate.obstacles:
            raise ValueError(
                "contact: False does not go with obstacles, which the gel would pass through"
            )
        check_obstacles(model)
        self._set(
            (
                model,
                gel,
                loads,
                control,
                None,
                constraints_of(model.lists, changes_of(control, gel).edges),
            )
        )
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
            else self.replace(
                operators=precomputed_operators(self.model, shared_gel(self.gel, self.model.shared))
            )
        )

    def at(self, value: Chemical) -> tuple["Problem", Chemical]:
        """See `Equations`."""
        now, mu = super().at(value)
        # the control changes of the body no more than obstacles, and no constraints
        if "shared" in self.__dict__:
            body = (
                dataclasses.replace(self.shared.model, contact=now.model.contact)
                if self.changes.obstacles
                else self.shared.model
            )
            now.__dict__["shared"] = _shared(now, body, self.shared.constraints)
        return now, mu

    @functools.cached_property
    def shared(self) -> Equations:
        """The equations as the compiled programs take them."""
        return _shared(
            self,
            self.model.shared,
            shared_constraints(self.constraints, self.model, self.model.shared),
        )

    @property
    def network(self) -> Float[np.ndarray, " p"]:
        """Stiffness of the dry network between the nodes of every pair of `node_pairs`, kT/v."""
        return np.asarray(self.prepared.operators.network)[: len(node_pairs(self.model.lists)[0])]

    def __repr__(self) -> str:
        """What is solved, in one line."""
        return f"Problem along {self.control.name} of a {self.model!r}"

    @property
    def pairs(self) -> ContactPairs | None:
        """The pairs of points that contact keeps apart; None without contact."""
        return self.model.contact.pairs if self.has_contact else None

    def touching(self, *x: Float[Array, "n 2"], values: Sequence[Chemical] = ()) -> "Problem":
        """The problem with all that touches at nodal positions ``x`` (n, 2), or at one of several.

        ``values`` of the control at each move its obstacles.
        """
        if not self.has_contact:
            return self
        models = [self.model] * len(x)
        if self.changes.obstacles and len(values):
            concrete, values = jax.tree.map(differentiated_value, (self, list(values)))
            models = (
                models
                if is_traced(concrete, values)
                else [concrete.at(value)[0].model for value in values]
            )
        return self.with_pairs(pairs_touching(x, models)) if len(x) else self

    @property
    def without_pairs(self) -> "Problem":
        """The problem without pairs that touch."""
        return self.with_pairs(no_pairs()) if self.has_contact else self

    def with_pairs(self, pairs: ContactPairs | None) -> "Problem":
        """The problem with these pairs that contact keeps apart."""
        if not self.has_contact or pairs is self.pairs or len(pairs) + len(self.pairs) == 0:
            return self
        contact = dataclasses.replace(self.model.contact, pairs=pairs)
        made = self.replace(model=dataclasses.replace(self.model, contact=contact))
        if not is_traced(self):  # the arrays without the pairs are the same
            body = dataclasses.replace(self.shared.model, contact=contact)
            made.model.__dict__["shared"], made.__dict__["shared"] = (
                body,
                self.shared.replace(model=body),
            )
        return made

    @property
    def pattern(self) -> Pattern:
        """Pattern of the tangent."""
        return tangent_pattern(self.model.lists, couplings(self.model))


def _as_float(number):
    """An array of a number or of several; what is not traced stays a number inside ``jax.jit``."""
    if is_traced(number):
        return jnp.asarray(number, dtype=float)
    with outside_traces():
        return jnp.asarray(number, dtype=float)


def _shared(problem, body, constraints):
    """The shared equations with the shared ``body`` and ``constraints``."""
    loads = resized(problem.loads, body.nodes.shape)
    return Equations.tree_unflatten(
        None,
        (
            body,
            shared_gel(problem.gel, body),
            loads,
            problem.control,
            problem.operators,
            constraints,
        ),
    )


def touching_tangents(
    problem: Problem, dots: Problem, x: Sequence[Float[Array, "n 2"]], values: Sequence[Chemical]
) -> tuple[Problem, Problem]:
    """Problem and tangents with all contact of ``x`` (n, 2) at ``values`` of the control.

    They are positions.
    """
    made = problem.touching(*x, values=values)
    if made is problem:
        return problem, dots
    pairs = jax.tree.map(
        lambda v: np.zeros(
            v.shape, v.dtype if np.issubdtype(v.dtype, np.floating) else jax.dtypes.float0
        ),
        made.pairs,
    )
    return made, dots.replace(
        model=dataclasses.replace(
            dots.model, contact=dataclasses.replace(dots.model.contact, pairs=pairs)
        )
    )


def shared_tangents(problem: Problem, dots: Problem) -> tuple[Equations, Equations]:
    """The shared equations of a problem, and their tangents for those of the problem.

    Without operators, which follow from the model.
    """
    inputs = problem.replace(operators=None), dots.replace(operators=None)
    return value_and_tangents(lambda problem: problem.shared, *inputs)


@once_per_owner
def constraints_of(lists: Connectivity, driven: bool) -> Constraints:
    """`Constraints` of a plate with these ``lists``, edges ``driven`` by a control or not."""
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
    """Raise ValueError, one line, if a control does not fit the plate at one of ``values``.

    Traced values pass.
    """
    control, plate = problem.control, problem.model.lists.topology.plate
    if is_traced(problem):
        return
    settings = [control(float(value), problem.gel) for value in values]
    if settings[0].loads is not None and jnp.shape(settings[0].loads) != (problem.model.n_nodes, 2):
        shape, needed = jnp.shape(settings[0].loads), (problem.model.n_nodes, 2)
        raise ValueError(
            f"{control.name}: loads have the shape {shape}, they must have that of the nodes, "
            f"{needed}"
        )
    for number in settings[0].obstacles or {}:
        if not 0 <= number < len(plate.obstacles):
            raise ValueError(
                f"{control.name}: obstacle {number} is not accepted, the plate has "
                f"{len(plate.obstacles)}, numbered from 0"
            )
    for edge in settings[0].displacement or {}:
        if plate.edges[edge] in ("free", "periodic"):
            raise ValueError(
                f"{control.name}: the {edge} edge is {plate.edges[edge]}, only one that is held "
                "can be displaced"
            )
    F = np.array(
        [np.eye(2) if setting.deformation is None else setting.deformation for setting in settings]
    )
    if (np.linalg.det(F) <= 0).any():
        k = int(np.argmax(np.linalg.det(F) <= 0))
        raise Inadmissible(
            f"{control.name}: {values[k]:g} is not accepted, it would turn the plate inside out"
        )
    if any(np.ptp(F[:, i, j]) > 0 for i, j in plate.free_strains):
        raise ValueError(
            f"{control.name}: a component of the macroscopic deformation that it drives is free "
            "in this plate"
        )
