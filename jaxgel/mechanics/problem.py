"""A model with its gel, loads and control: all that the equations of equilibrium depend on besides the value of the control."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._tracing import is_traced
from .._types import Array, Chemical, Float
from .._validation import Inadmissible
from ..controls import Changes, ChemicalPotential, Control, changes_of, check_fields, check_is_control, edge_motion
from ..discretisation import Model
from ..linalg import Pattern
from ..materials import AnyGel, LocalGel
from .conditions import Free, constrained_part
from .contact import with_contact
from .dofs import check_moving, start_positions, unknowns
from .local_gel import check_model, localised
from .operators import Operators, precomputed_operators
from .pairs import tangent_pattern

BY_MU = ChemicalPotential()
PARTS = ("model", "gel", "loads", "control", "operators")


@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Problem:
    """All that a state of equilibrium depends on besides the value of the control: plate, gel, loads, control and contact; a pytree."""

    model: Model
    """Discretised plate, with its self-contact if there is any."""
    gel: LocalGel
    """Material; fields as their values on the model, see `local_gel`."""
    loads: Float[Array, "n 2"]
    """Dead nodal loads, kT/v mm."""
    control: Control
    """What drives a sweep."""
    operators: Operators | None
    """Precomputed operators of the model; None for rates of change, and until they are needed, see `prepared`."""

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
        self._set((model, gel, loads, control, None))
        if self.changes.gel:
            check_fields(control, gel)
        if self.moves_edges:
            check_moving(model.lists.topology)

    def _set(self, parts):
        for name, part in zip(PARTS, parts, strict=True):
            object.__setattr__(self, name, part)

    def tree_flatten_with_keys(self) -> tuple[tuple, None]:
        """Its parts, each with its name."""
        return tuple((jax.tree_util.GetAttrKey(name), getattr(self, name)) for name in PARTS), None

    @classmethod
    def tree_unflatten(cls, _: None, parts: Sequence[Any]) -> "Problem":
        """The problem of such parts, which may be anything that JAX puts in their place."""
        made = object.__new__(cls)
        made._set(parts)
        return made

    def replace(self, **parts: Any) -> "Problem":
        """The problem with other ``parts``, which are not checked; TypeError for what is no part."""
        if not parts.keys() <= set(PARTS):
            raise TypeError(f"replace: {', '.join(parts.keys() - set(PARTS))} is not one of {', '.join(PARTS)}")
        return self.tree_unflatten(None, [parts.get(name, getattr(self, name)) for name in PARTS])

    @property
    def prepared(self) -> "Problem":
        """The problem with its operators."""
        return self if self.operators is not None else self.replace(operators=precomputed_operators(self.model, self.gel))

    def at(self, value: Chemical) -> tuple["Problem", Chemical]:
        """The problem at a ``value`` of its control, driven by the chemical potential from there, and that potential, kT."""
        setting = self.control(value, self.gel)
        gel = self.gel if setting.gel is self.gel else jax.tree.map(lambda v: jnp.asarray(v, dtype=float), setting.gel)
        loads = self.loads if setting.loads is None else self.loads + setting.loads
        operators = self.operators
        if operators is not None and self.changes.stiffness:
            operators = dataclasses.replace(operators, network=operators.network * (gel.Nv / self.gel.Nv))
        now = self.replace(gel=gel, loads=loads, operators=operators, control=BY_MU)
        mu = setting.mu if isinstance(setting.mu, jax.Array) else np.asarray(setting.mu, dtype=float)  # NumPy's is made sooner
        return now, mu

    def __repr__(self) -> str:
        """What is solved, in one line."""
        return f"Problem along {self.control.name} of a {self.model!r}"

    @functools.cached_property
    def changes(self) -> Changes:
        """What the control changes besides the chemical potential."""
        return changes_of(self.control, self.gel)

    @property
    def moves_edges(self) -> bool:
        """Whether the control moves the edges of the plate."""
        return self.changes.edges

    def dry_positions(self, value: Chemical) -> Float[Array, "n 2"]:
        """The dry nodes, moved as the edges are at a ``value`` of the control, mm."""
        return start_positions(self.model.lists.topology, self.model.cloud.nodes, self._edge_motion(value))

    def edge_deformation(self, value: Chemical) -> Float[Array, "2 2"]:
        """The macroscopic deformation that the edges follow at a ``value`` of the control."""
        motion = self._edge_motion(value)
        return np.array(self.model.lists.topology.plate.dry_deformation) if motion is None else motion[0]

    def _edge_motion(self, value):
        plate = self.model.lists.topology.plate
        return edge_motion(self.control(value, self.gel), plate) if self.moves_edges else None

    def carried(self, motion: Float[Array, "n 2"], value: Chemical) -> Float[Array, "n 2"]:
        """What a ``motion`` (n, 2) of the dry nodes prescribes of the deformed ones at a ``value`` of the control, the unknowns at rest."""
        return constrained_part(motion @ self.edge_deformation(value).T, self.free)

    def placed(self, x: Float[Array, "n 2"], value: Chemical) -> Float[Array, "n 2"]:
        """Positions ``x``, mm, with those that the edges prescribe as they are at a ``value`` of the control."""
        if not self.moves_edges:
            return x
        return _placed(self, jnp.asarray(x), value)

    @property
    def free(self) -> Free:
        """Free degrees of freedom."""
        return unknowns(self.model.lists) if self.operators is None else self.operators.free

    @property
    def has_contact(self) -> bool:
        """Whether hole boundaries repel each other."""
        return self.model.contact is not None

    @property
    def without_contact(self) -> "Problem":
        """The same problem without self-contact, for states in which no outline is near itself."""
        return self.replace(model=dataclasses.replace(self.model, contact=None)) if self.has_contact else self

    @property
    def pattern(self) -> Pattern:
        """Pattern of the tangent; with contact it couples all nodes near a hole."""
        return tangent_pattern(self.model.lists, self.model.solver, self.model.dmax if self.has_contact else None)


@jax.jit
def _placed(problem, x, value):
    return x + constrained_part(problem.dry_positions(value) - x, problem.free)


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
