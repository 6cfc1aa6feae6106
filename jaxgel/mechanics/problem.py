"""A model with its gel, loads and control: all that the equations of equilibrium depend on besides the value of the control."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Scalar
from .._validation import Inadmissible
from ..controls import Control, check_fields, control_name, drives_stiffness, edge_motion, moves_edges, setting_of
from ..discretisation import Model
from ..linalg import Pattern
from ..materials import AnyGel, LocalGel
from .dofs import Free, check_moving, constrained_part, start_positions, unknowns
from .local_gel import localised
from .operators import Operators, precomputed_operators
from .pairs import tangent_pattern


@functools.partial(jax.tree_util.register_dataclass, data_fields=["model", "gel", "loads", "operators", "control"], meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """What a state of equilibrium solves; a pytree."""

    model: Model
    """Discretised plate, with its self-contact if there is any."""
    gel: LocalGel
    """Material; fields as their values on the model, see `local_gel`."""
    loads: Float[Array, "n 2"]
    """Dead nodal loads, kT/v mm."""
    operators: Operators | None
    """Precomputed operators of the model; None for rates of change, and until they are needed."""
    control: Control | None = None
    """What drives a sweep; None for the chemical potential."""

    def at(self, value: Scalar) -> tuple["Problem", Scalar]:
        """The problem at a ``value`` of its control, which has none any more, and the chemical potential there, kT."""
        if self.control is None:
            return self, value
        setting = self.control(value, self.gel)
        gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), setting.gel)
        loads = self.loads if setting.loads is None else self.loads + setting.loads
        operators = self.operators
        if operators is not None and drives_stiffness(self.control, self.gel):
            operators = dataclasses.replace(operators, network=operators.network * (gel.Nv / self.gel.Nv))
        return Problem(self.model, gel, loads, operators), jnp.asarray(setting.mu, dtype=float)

    def __repr__(self) -> str:
        """What is solved, in one line."""
        return f"Problem along {control_name(self.control)} of a {self.model!r}"

    @property
    def moves_edges(self) -> bool:
        """Whether the control moves the edges of the plate."""
        return moves_edges(self.control, self.gel)

    def dry_positions(self, value: Scalar) -> Float[Array, "n 2"]:
        """The dry nodes, moved as the edges are at a ``value`` of the control, mm."""
        return start_positions(self.model.lists.topology, self.model.cloud.nodes, self._edge_motion(value))

    def edge_deformation(self, value: Scalar) -> Float[Array, "2 2"]:
        """The macroscopic deformation that the edges follow at a ``value`` of the control."""
        motion = self._edge_motion(value)
        return np.array(self.model.lists.topology.plate.dry_deformation) if motion is None else motion[0]

    def _edge_motion(self, value):
        plate = self.model.lists.topology.plate
        return edge_motion(setting_of(self.control, value, self.gel), plate) if self.moves_edges else None

    def carried(self, motion: Float[Array, "n 2"], value: Scalar) -> Float[Array, "n 2"]:
        """What a ``motion`` (n, 2) of the dry nodes prescribes of the deformed ones at a ``value`` of the control, the unknowns at rest."""
        return constrained_part(motion @ self.edge_deformation(value).T, self.free)

    def placed(self, x: Float[Array, "n 2"], value: Scalar) -> Float[Array, "n 2"]:
        """Positions ``x``, mm, with those that the edges prescribe as they are at a ``value`` of the control."""
        if not self.moves_edges:
            return x
        return _placed(self, jnp.asarray(x), value)

    @property
    def free(self) -> Free:
        """Free degrees of freedom, see `dofs`."""
        return unknowns(self.model.lists) if self.operators is None else self.operators.free

    @property
    def has_contact(self) -> bool:
        """Whether hole boundaries repel each other."""
        return self.model.contact is not None

    @property
    def without_contact(self) -> "Problem":
        """The same problem without self-contact, for states in which no outline is near itself."""
        return dataclasses.replace(self, model=dataclasses.replace(self.model, contact=None)) if self.has_contact else self

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
    if control is None or any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(problem)):
        return
    settings = [setting_of(control, float(value), problem.gel) for value in values]
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


def prepare(
    model: Model, gel: AnyGel, loads: Float[Array, "n 2"] | None = None, *, control: Control | None = None, operators: bool = True
) -> Problem:
    """`Problem` of a model and a gel under a ``control``; ``loads`` (n, 2) are dead nodal forces in kT/v mm, none by default.

    Without ``operators`` it has none yet: what is refused need not wait for them.
    """
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else jnp.asarray(loads)
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), localised(model, gel))
    control = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), control)
    check_fields(control, gel)
    if moves_edges(control, gel):
        check_moving(model.lists.topology)
    return Problem(model, gel, loads, precomputed_operators(model, gel) if operators else None, control)
