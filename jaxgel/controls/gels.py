"""A parameter of the gel as control: temperature, Flory's parameter, pH or salt."""

import dataclasses
from typing import Any

import jax

from .._tracing import is_traced
from .._types import Scalar
from ..materials import Composite, Filled, named_parameters, varies
from .setting import Setting


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class DrivenParameter:
    """The control that is a parameter of the gel, at a given chemical potential.

    Elastomers of a composite do not have it.
    """

    name: str = dataclasses.field(metadata={"static": True})
    """Of the parameter, and of the control."""
    mu: Scalar = 0.0
    """Chemical potential, kT; 0 is pure solvent."""
    unit: str = dataclasses.field(default="", kw_only=True, metadata={"static": True})
    """Of the parameter."""
    scale: float = dataclasses.field(default=1.0, kw_only=True, metadata={"static": True})
    """See `Control`."""

    def __call__(self, value: Scalar, gel: Any) -> Setting:
        """What acts at a ``value`` of the parameter.

        ValueError, one line, for a gel that does not have it as one number.
        """
        return Setting(self.mu, self._with(value, gel))

    def _with(self, value, gel):
        if isinstance(gel, Composite):
            matrix = self._with(value, gel.matrix)
            return Composite(
                matrix, tuple(self._in_region(value, k, gel) for k in range(len(gel.regions)))
            )
        if isinstance(gel, Filled):
            return dataclasses.replace(gel, gel=self._with(value, gel.gel))
        known = named_parameters(gel)
        if self.name not in known:
            raise ValueError(
                f"control: {self.name!r} is no parameter of {type(gel).__name__}, it has "
                f"{', '.join(known)}"
            )
        if varies(known[self.name]):
            raise ValueError(
                f"control: {self.name!r} varies over the plate, only a parameter that is one "
                "number can be driven"
            )
        return dataclasses.replace(gel, **{self.name: value})

    def _in_region(self, value, k, gel):
        own, common = (named_parameters(one).get(self.name) for one in (gel.regions[k], gel.matrix))
        if own is None:
            return gel.regions[k]
        if own is not common and (is_traced(own, common) or own != common):
            raise ValueError(
                f"control: regions[{k}] has a {self.name!r} of its own, only one number of all "
                "gels can be driven"
            )
        return self._with(value, gel.regions[k])
