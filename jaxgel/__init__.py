"""jaxgel: a JAX differentiable meshless solver for the swelling of perforated hydrogel sheets.

The improved interpolating complex variable element free Galerkin method of Deng, He, Sun, Yi & Dai (2020), with one pressure per cell
against locking. Importing it switches JAX to 64-bit numbers and changes nothing else; a name is imported when it is first used, from the
package that ``__init__.pyi`` lists for it.
"""

import pathlib

import lazy_loader

from ._float64 import always_on

always_on()
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in __all__ if not (pathlib.Path(__file__).parent / name).is_dir()]  # a star import takes no packages
