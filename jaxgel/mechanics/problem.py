"""A model with its gel and loads: all that the equations of equilibrium depend on besides the chemical potential."""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from .._types import Array, Float, Int
from ..discretisation import Model
from ..linalg import Pattern
from ..materials import Gel
from .dofs import unknowns
from .local_gel import localised
from .operators import Operators, precomputed_operators
from .pairs import tangent_pattern


@functools.partial(jax.tree_util.register_dataclass, data_fields=["model", "gel", "loads", "operators"], meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """What a state of equilibrium solves; a pytree."""

    model: Model
    """Discretised plate, with its self-contact if there is any."""
    gel: Gel
    """Material; fields as their values on the model, see `local_gel`."""
    loads: Float[Array, "n 2"]
    """Dead nodal loads, kT/v mm."""
    operators: Operators | None
    """Precomputed operators of the model; None for formulations that assemble dense matrices, and for rates of change."""

    @property
    def free(self) -> Int[Array, "f ..."]:
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


def prepare(model: Model, gel: Gel, loads: Float[Array, "n 2"] | None = None, *, operators: bool = True) -> Problem:
    """`Problem` of a model and a gel; ``loads`` (n, 2) are dead nodal forces in kT/v mm, none by default.

    Without ``operators`` it has none, for formulations that assemble dense matrices.
    """
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else jnp.asarray(loads)
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), localised(model, gel))
    return Problem(model, gel, loads, precomputed_operators(model, gel) if operators else None)
