"""The equations of equilibrium as arrays, besides the value of the control."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._sizes import resized
from .._types import Array, Chemical, Float, Int
from ..controls import Changes, ChemicalPotential, Control, changes_of
from ..discretisation import Body
from ..materials import LocalGel
from .conditions import Free, constrained_part
from .dofs import Edges
from .operators import Operators

BY_MU = ChemicalPotential()
E = TypeVar("E", bound="Equations")  # these, or those of a problem
PARTS = ("model", "gel", "loads", "control", "operators", "constraints")


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["free", "edges", "nearest"], meta_fields=[]
)
@dataclasses.dataclass(frozen=True, eq=False)
class Constraints:
    """Which motions of the nodes are possible; a pytree."""

    free: Free
    """The unknowns, and the fields that they move."""
    edges: Edges
    """How the edges move."""
    nearest: Int[Array, " n"]
    """Patch nearest each node, block after block: the node moves with it if material moves.

    A design moves the material.
    """


@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Equations:
    """All that a state of equilibrium depends on besides the value of the control; a pytree.

    Those of a `Problem` are of its own sizes; its ``shared`` ones, which the compiled programs
    take, have sizes that similar problems have in common, and know neither plate nor cloud.
    """

    model: Body
    """Discretised plate, with its contact if there is any."""
    gel: LocalGel
    """Material; fields as their values on the model, see `local_gel`."""
    loads: Float[Array, "n 2"]
    """Dead nodal loads, kT/v mm."""
    control: Control
    """What drives a sweep."""
    operators: Operators | None
    """Precomputed operators of the model.

    None for rates of change, and until they are needed, see `Problem.prepared`.
    """
    constraints: Constraints
    """Which motions of the nodes are possible."""

    def _set(self, parts):
        for name, part in zip(PARTS, parts, strict=True):
            object.__setattr__(self, name, part)

    def tree_flatten_with_keys(self) -> tuple[tuple, None]:
        """Its parts, each with its name."""
        return tuple((jax.tree_util.GetAttrKey(name), getattr(self, name)) for name in PARTS), None

    @classmethod
    def tree_unflatten(cls: type[E], _: None, parts: Sequence[Any]) -> E:
        """The equations of such parts, which may be anything that JAX puts in their place."""
        made = object.__new__(cls)
        made._set(parts)
        return made

    def replace(self: E, **parts: Any) -> E:
        """The equations with other ``parts``, which are not checked.

        TypeError for what is no part.
        """
        if not parts.keys() <= set(PARTS):
            raise TypeError(
                f"replace: {', '.join(parts.keys() - set(PARTS))} is not one of {', '.join(PARTS)}"
            )
        return self.tree_unflatten(None, [parts.get(name, getattr(self, name)) for name in PARTS])

    def at(self: E, value: Chemical) -> tuple[E, Chemical]:
        """Equations at a ``value`` of the control, driven by mu from there, and that mu, kT."""
        setting = self.control(value, self.gel)
        gel = (
            self.gel
            if setting.gel is self.gel
            else jax.tree.map(lambda v: jnp.asarray(v, dtype=float), setting.gel)
        )
        loads = (
            self.loads
            if setting.loads is None
            else self.loads + resized(jnp.asarray(setting.loads, float), self.loads.shape)
        )
        operators = self.operators
        if operators is not None and self.changes.stiffness:
            operators = dataclasses.replace(
                operators, network=operators.network * (gel.Nv / self.gel.Nv)
            )
        now = self.replace(
            gel=gel,
            loads=loads,
            operators=operators,
            control=BY_MU,
            model=self._moved_model(setting.obstacles),
        )
        # NumPy's is made sooner
        mu = (
            setting.mu if isinstance(setting.mu, jax.Array) else np.asarray(setting.mu, dtype=float)
        )
        return now, mu if mu.ndim == 0 else resized(mu, self.model.carries.shape, edge=True)

    def _moved_model(self, obstacles):
        """The model with ``obstacles`` displaced, number -> (2,) mm."""
        contact = self.model.contact
        if obstacles is None or contact is None:
            return self.model
        return dataclasses.replace(
            self.model,
            contact=dataclasses.replace(contact, obstacles=contact.obstacles.moved(obstacles)),
        )

    @functools.cached_property
    def changes(self) -> Changes:
        """What the control changes besides the chemical potential."""
        return changes_of(self.control, self.gel)

    @property
    def moves_edges(self) -> bool:
        """Whether the control moves the edges of the plate."""
        return self.changes.edges

    def edges(self, value: Chemical) -> Edges:
        """How the edges move at a ``value`` of the control."""
        edges = self.constraints.edges
        return edges.moved(self.control(value, self.gel)) if self.moves_edges else edges

    def dry_positions(self, value: Chemical) -> Float[Array, "n 2"]:
        """The dry nodes, moved as the edges are at a ``value`` of the control, mm."""
        return self.edges(value).positions(self.model.nodes)

    def carried(self, motion: Float[Array, "n 2"], value: Chemical) -> Float[Array, "n 2"]:
        """Prescribed motion by a ``motion`` (n, 2) of dry nodes at a ``value``; unknowns at rest.

        It is a value of the control.
        """
        return constrained_part(motion @ self.edges(value).deformation.T, self.free)

    def placed(self, x: Float[Array, "n 2"], value: Chemical) -> Float[Array, "n 2"]:
        """Positions ``x``, mm, with prescribed ones as at a ``value`` of the control."""
        return _placed(self, x, value) if self.moves_edges else x

    @functools.cached_property
    def inside(self) -> "Equations":
        """The equations without outlines and contact, for states without touching surfaces."""
        contact = self.model.contact
        if contact is not None and len(contact.pairs) > 0:
            return self
        return self.replace(model=dataclasses.replace(self.model, outline=None, contact=None))

    @property
    def free(self) -> Free:
        """Free degrees of freedom."""
        return self.constraints.free

    @property
    def lengths(self) -> dict[str, int]:
        """Numbers of nodes, volume groups and unknowns, by letter."""
        return {**self.model.lengths, "f": len(self.free)}

    @property
    def has_contact(self) -> bool:
        """Whether surfaces that meet are kept apart."""
        return self.model.contact is not None


@program(x="n", returns="n")
def _placed(problem, x, value):
    return x + constrained_part(problem.dry_positions(value) - x, problem.free)
