"""jaxgel: a JAX differentiable meshless solver for the swelling of perforated hydrogel sheets.

The improved interpolating complex variable element free Galerkin method of Deng, He, Sun, Yi & Dai
(2020), with pressures linear over patches of cells against locking. Importing it switches JAX to
64-bit numbers and changes nothing else; a name is imported when it is first used, from the package
that ``__init__.pyi`` lists for it.
"""

import jax

from ._deprecated import old_names
from ._lazy import attach

jax.config.update("jax_enable_x64", True)  # pyright: ignore[reportUnknownMemberType]
_of_today, __dir__, __all__ = attach(__name__, __file__)
__getattr__ = old_names(__name__, _of_today)
