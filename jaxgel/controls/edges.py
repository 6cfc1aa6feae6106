"""Controls that move the plate's edges, or load it."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from .._types import Array, Float, Scalar
from .._validation import one_of
from .setting import Setting

DIRECTIONS = {"x": (1.0, 0.0), "y": (0.0, 1.0), "both": (1.0, 1.0)}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Stretch:
    """The control that is the macroscopic stretch which the edges follow, in the ``direction`` "x", "y" or "both"; 1 for edges at rest.

    ValueError for another direction.
    """

    direction: str = dataclasses.field(default="both", metadata={"static": True})
    """Along which the stretch acts; 1 across it."""
    mu: Scalar = 0.0
    """Chemical potential, kT."""
    name: str = dataclasses.field(default="stretch", kw_only=True, metadata={"static": True})
    """See `Control`."""
    unit: str = dataclasses.field(default="", kw_only=True, metadata={"static": True})
    """See `Control`."""
    scale: float = dataclasses.field(default=0.1, kw_only=True, metadata={"static": True})
    """See `Control`."""

    def __post_init__(self) -> None:
        one_of("direction", self.direction, tuple(DIRECTIONS))

    def __call__(self, value: Scalar, gel: Any) -> Setting:
        """What acts at a ``value`` of the stretch."""
        along = jnp.array(DIRECTIONS[self.direction])
        return Setting(self.mu, gel, deformation=jnp.diag(1.0 + along * (value - 1.0)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Load:
    """The control that multiplies dead nodal ``loads``, see ``mechanics.load_vector``."""

    loads: Float[Array, "n 2"]
    """At the value 1, kT/v mm."""
    mu: Scalar = 0.0
    """Chemical potential, kT."""
    name: str = dataclasses.field(default="load", kw_only=True, metadata={"static": True})
    """See `Control`."""
    unit: str = dataclasses.field(default="", kw_only=True, metadata={"static": True})
    """See `Control`."""
    scale: float = dataclasses.field(default=1.0, kw_only=True, metadata={"static": True})
    """See `Control`."""

    def __call__(self, value: Scalar, gel: Any) -> Setting:
        """What acts at a ``value`` of the factor."""
        return Setting(self.mu, gel, loads=value * jnp.asarray(self.loads))
