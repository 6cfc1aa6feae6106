"""Controls that move the plate's edges or an obstacle, or load it."""

import dataclasses
from collections.abc import Sequence
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
    """Control whose value is the stretch of the edges; the user makes it for a `Problem`.

    The stretch is macroscopic, 1 for edges at rest. Raises `ValueError` for an unknown direction.
    """

    direction: str = dataclasses.field(default="both", metadata={"static": True})
    """"x", "y" or "both": along which the stretch acts; 1 across it."""
    mu: Scalar = 0.0
    """Chemical potential, kT."""
    name: str = dataclasses.field(default="stretch", kw_only=True, metadata={"static": True})
    """Name in tables and figures."""
    unit: str = dataclasses.field(default="", kw_only=True, metadata={"static": True})
    """Unit of the value; empty if dimensionless."""
    scale: float = dataclasses.field(default=0.1, kw_only=True, metadata={"static": True})
    """Change of the value that counts as much as one kT of mu, for steps and arc lengths."""

    def __post_init__(self) -> None:
        one_of("direction", self.direction, tuple(DIRECTIONS))

    def __call__(self, value: Scalar, gel: Any) -> Setting:
        """What acts at a ``value`` of the stretch."""
        along = jnp.array(DIRECTIONS[self.direction])
        return Setting(self.mu, gel, deformation=jnp.diag(1.0 + along * (value - 1.0)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Load:
    """Control whose value is the factor of dead nodal loads; the user makes it for a `Problem`."""

    loads: Float[Array, "n 2"]
    """Nodal forces at the value 1, kT/v mm, see `load_vector`."""
    mu: Scalar = 0.0
    """Chemical potential, kT."""
    name: str = dataclasses.field(default="load", kw_only=True, metadata={"static": True})
    """Name in tables and figures."""
    unit: str = dataclasses.field(default="", kw_only=True, metadata={"static": True})
    """Unit of the value; empty if dimensionless."""
    scale: float = dataclasses.field(default=1.0, kw_only=True, metadata={"static": True})
    """Change of the value that counts as much as one kT of mu, for steps and arc lengths."""

    def __call__(self, value: Scalar, gel: Any) -> Setting:
        """What acts at a ``value`` of the factor."""
        return Setting(self.mu, gel, loads=value * jnp.asarray(self.loads))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Punch:
    """Control whose value is the displacement of an obstacle; the user makes it for a `Problem`."""

    direction: Sequence[float] | Float[Array, "2"]
    """Displacement (2,) at the value 1, mm."""
    obstacle: int = dataclasses.field(default=0, metadata={"static": True})
    """Number of the obstacle in `Plate.obstacles`."""
    mu: Scalar = 0.0
    """Chemical potential, kT."""
    name: str = dataclasses.field(default="punch", kw_only=True, metadata={"static": True})
    """Name in tables and figures."""
    unit: str = dataclasses.field(default="mm", kw_only=True, metadata={"static": True})
    """Unit of the value; empty if dimensionless."""
    scale: float = dataclasses.field(default=1.0, kw_only=True, metadata={"static": True})
    """Change of the value that counts as much as one kT of mu, for steps and arc lengths."""

    def __call__(self, value: Scalar, gel: Any) -> Setting:
        """What acts at a ``value`` of the displacement."""
        return Setting(
            self.mu, gel, obstacles={self.obstacle: value * jnp.asarray(self.direction, float)}
        )
