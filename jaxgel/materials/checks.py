"""Validation of gel parameters."""

import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from .._tracing import is_traced
from .._types import Float
from .._validation import Inadmissible
from .composite import Composite, Elastomer
from .fields import LocalValues

ACCEPTED: dict[str, tuple[Callable[[Any], Any], str]] = {
    "Nv": (lambda v: (v > 0) & (v < math.inf), "a finite number > 0"),
    "chi": (lambda v: (v > -math.inf) & (v < 2), "a finite number < 2"),
    "bulk": (lambda v: (v > 0) & (v < math.inf), "a finite number > 0"),
    "temperature": (lambda v: (v >= 0) & (v <= 100), "a number in [0, 100], degrees Celsius"),
    "pH": (lambda v: (v >= 0) & (v <= 14), "a number in [0, 14]"),
    "salt": (lambda v: (v >= 0) & (v < math.inf), "a finite number >= 0, mol/l"),
    "acid_fraction": (lambda v: (v >= 0) & (v <= 1), "a number in [0, 1]"),
    "pKa": (lambda v: (v > -math.inf) & (v < math.inf), "a finite number"),
    "solvent_volume": (lambda v: (v > 0) & (v < math.inf), "a finite number > 0, nm^3"),
}  # of the parameters: what is accepted, of a number or an array, and the same in words


def check_gel(gel: Any, mu: object = None) -> None:
    """Raise ValueError, one line, unless parameters obey `ACCEPTED` and ``mu`` is finite.

    It is a number or array. Traced values pass, and fields, which `check_parameter` checks at the
    points of a model. Of a `Composite` every material is checked.
    """
    if isinstance(gel, Composite):
        check_gel(gel.matrix, mu)
        for k, material in enumerate(gel.regions):
            _check_region(f"regions[{k}]", material, gel.matrix)
        return
    for name in (name for name in ACCEPTED if hasattr(gel, name)):
        parameter = getattr(gel, name)
        if not (callable(parameter) or isinstance(parameter, LocalValues)):
            check_number(name, parameter, *ACCEPTED[name])
    if mu is not None and not is_traced(mu):
        for value in np.ravel(np.asarray(mu, dtype=object)):
            check_number("mu", value, math.isfinite, "a finite number (chemical potential in kT)")


def _check_region(where, material, matrix):
    if not isinstance(material, Elastomer):
        if type(material) is not type(matrix):
            raise ValueError(
                f"{where}: {material!r} is neither an Elastomer nor a {type(matrix).__name__}, as "
                "the matrix is"
            )
        for name in ("network", "volumetric"):
            if getattr(material, name) != getattr(matrix, name):
                own, needed = getattr(material, name), getattr(matrix, name)
                raise ValueError(
                    f"{where}: its {name} is {own!r}, it must be that of the matrix, {needed!r}"
                )
    try:
        check_gel(material)
    except ValueError as problem:
        raise type(problem)(f"{where}: {problem}") from None


def check_parameter(name: str, values: Float[Any, " p"], places: Float[Any, "p 2"]) -> None:
    """Raise ValueError, one line, with the first of the ``places``, mm, of a wrong value.

    The value of a field is not accepted there or not finite.
    """
    accepted, text = ACCEPTED.get(name, (np.isfinite, "a finite number"))
    wrong = np.flatnonzero(~accepted(np.asarray(values)))
    if len(wrong):
        x, y = np.asarray(places)[wrong[0]]
        raise Inadmissible(
            f"{name}: {float(values[wrong[0]]):g} at ({x:.4g}, {y:.4g}) mm is not accepted, it "
            f"must be {text}"
        )


def check_number(name: str, value: object, accepted: Any, text: str) -> None:
    """Raise ValueError, one line, unless the number ``value`` is ``accepted``, in words ``text``.

    Traced values pass.
    """
    if is_traced(value):
        return
    try:
        number = math.nan if isinstance(value, str) or np.ndim(value) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not accepted(number):
        shown = (
            repr(value)
            if math.isnan(number) and not isinstance(value, np.generic | jax.Array)
            else f"{number:g}"
        )
        raise Inadmissible(f"{name}: {shown} is not accepted, it must be {text}")
