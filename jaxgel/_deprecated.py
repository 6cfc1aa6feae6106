"""Names, arguments and options of version 0.2 that have another name now, or none.

A renamed one works until `UNTIL`, with a `FutureWarning` at the line of the user: a
`DeprecationWarning` is shown for the main script only, and studies have modules of their own. A
removed one is an error whose line says what to write instead. Names are those of the packages,
such as ``materials.Coexistence``; those of `jaxgel` itself have no package.
"""

import functools
import importlib
import inspect
import sys
import warnings
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from ._removed import ARGUMENTS, CALLS, REMOVED

P = ParamSpec("P")
R = TypeVar("R")

SINCE, UNTIL = "0.3", "0.5"
RENAMED = {
    "discretisation.cubic_spline_weight": "paper.cubic_spline_weight",
    "materials.Coexistence": "materials.PhasePoints",
    "materials.StabilityLimits": "materials.PhasePoints",
    "materials.paper_free_energy": "paper.paper_free_energy",
    "materials.paper_stress": "paper.paper_stress",
    "materials.paper_tangent": "paper.paper_tangent",
    "materials.voigt": "paper.voigt",
}
RENAMED_ARGUMENTS = {
    ("DesignProblem.path", "mu"): "values",
    ("continue_branch", "mu_end"): "end",
}


def removed(old: str, instead: str) -> str:
    """The line of an error about what was removed; ``instead`` is empty if nothing replaces it."""
    return f"{old} is gone since jaxgel {SINCE}; " + (
        f"use {instead}" if instead else "nothing replaces it"
    )


def old_names(package: str, others: Callable[[str], Any] | None = None) -> Any:
    """``__getattr__`` of a package for its names of version 0.2; ``others`` finds all other names.

    The type is `Any` so that a checker of types goes on to name what a package does not have.
    """

    def find(name: str) -> Any:
        old = f"{package}.{name}"
        key = old.removeprefix("jaxgel.")
        # `from package import name` asks twice: the import system, then the line of the user
        caller = sys._getframe(1).f_code.co_name  # noqa: SLF001
        asked_by_import = caller == "_handle_fromlist"
        if key in RENAMED:
            if not asked_by_import:
                _warn_renamed(old, f"jaxgel.{RENAMED[key]}")
            home, _, new = RENAMED[key].rpartition(".")
            return getattr(importlib.import_module(f"jaxgel.{home}"), new)
        if key in REMOVED:  # after an AttributeError, the import system has a text of its own
            raise (ImportError if asked_by_import else AttributeError)(removed(old, REMOVED[key]))
        if others is not None:
            return others(name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return find


def old_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """The function, which takes renamed arguments of 0.2 and says what replaces the others."""
    name = function.__qualname__.removesuffix(".__init__")
    gone = ARGUMENTS.get(name, {})
    renamed = {old: new for (of, old), new in RENAMED_ARGUMENTS.items() if of == name}
    ways = [one.kind for one in inspect.signature(function).parameters.values()]
    most = ways.count(inspect.Parameter.POSITIONAL_OR_KEYWORD)

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        for old in [key for key in kwargs if key in gone]:
            raise TypeError(removed(f"the argument {old} of {name}", gone[old]))
        if len(args) > most and name in CALLS:
            raise TypeError(f"{name} has other arguments since jaxgel {SINCE}: {CALLS[name]}")
        for old in [key for key in kwargs if key in renamed]:
            _warn_renamed(f"the argument {old} of {name}", renamed[old])
            kwargs[renamed[old]] = kwargs.pop(old)
        return function(*args, **kwargs)

    return called


class OldAttribute:
    """An attribute of 0.2: the attribute ``new``, or an error that says what to use instead."""

    def __init__(self, new: str = "", *, written: str = "", instead: str = "") -> None:
        """``written`` is how the new one is written if not as an attribute."""
        self.new, self.written, self.instead = new, written or new, instead

    def __set_name__(self, owner: type, name: str) -> None:
        """Keep the old name, for the line of the warning."""
        self.old = f"{owner.__name__}.{name}"

    def __get__(self, one, owner=None):
        """The new attribute, with a warning."""
        if one is None:
            return self
        if not self.new:
            raise AttributeError(removed(self.old, self.instead))
        _warn_renamed(self.old, self.written)
        return getattr(one, self.new)


def _warn_renamed(old, new):
    """Warn that ``old`` is ``new`` now, at the line that calls the caller of this function."""
    text = f"{old} is {new} since jaxgel {SINCE}; the old name goes in {UNTIL}"
    warnings.warn(text, FutureWarning, stacklevel=3)
