"""Compiled programs that plates of similar size share, by padded arguments."""

import functools
import inspect
import pathlib
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numpy as np

from ._compiled import PROGRAMS, compiled
from ._sizes import resized

P = ParamSpec("P")
R = TypeVar("R")
CROWDED = 0.5  # of the mappings that a process may have


def program(
    *, returns: Any = None, static: tuple[str, ...] = (), inside: bool = False, **axes: str
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator: ``jax.jit`` of a function of a problem or model in shared sizes.

    Similar problems and models share these. The first argument called ``problem`` or ``model`` is
    given as its ``shared`` form. ``axes`` names the axes of other arrays by letters, one for each
    leading axis, such as ``x="n"`` or ``x="kn"``: those of ``n`` nodes, ``g`` volume groups and
    ``f`` unknowns are made as long as the shared form has them, others stay. ``returns`` says the
    same of results, which are cut to the problem's own lengths; None for those that stay. A
    function of what is ``inside`` the gel gets a problem without outlines and contact unless
    surfaces touch: one program then serves outlines of any length. In another program, where the
    problem is shared already, the function is called as it is.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        jitted = compiled(static=static)(function)
        names = list(inspect.signature(function).parameters)
        place = names.index("problem" if "problem" in names else "model")

        @functools.wraps(function)
        def call(*args: Any, **options: Any) -> Any:
            owner = args[place]
            shared = getattr(owner, "shared", None)
            if shared is None:
                return function(*args, **options)
            lengths = shared.lengths
            given = [
                fitted(arg, axes[name], lengths) if name in axes else arg
                for name, arg in zip(names, args, strict=False)
            ]
            given[place] = shared.inside if inside else shared
            options = {
                name: fitted(arg, axes[name], lengths) if name in axes else arg
                for name, arg in options.items()
            }
            found = jitted(*given, **options)
            return _cut(found, returns, owner.lengths) if returns else found

        return call

    return decorate


def fitted(values: Any, axes: str, lengths: dict[str, int]) -> Any:
    """Values whose axes of these letters have the given lengths.

    None, and a number in place of an array, as they are.
    """
    if np.ndim(values) == 0:
        return values
    shape = (
        *(lengths.get(axis, size) for axis, size in zip(axes, values.shape, strict=False)),
        *values.shape[len(axes) :],
    )
    return resized(values, shape)


def _cut(found, returns, lengths):
    if isinstance(returns, str):
        return fitted(found, returns, lengths)
    return tuple(
        part if axes is None else fitted(part, axes, lengths)
        for part, axes in zip(found, returns, strict=True)
    )


def mappings() -> tuple[int, int]:
    """Number of memory mappings of this process and its limit; (0, 1) if unknown, as on macOS."""
    try:
        limit = int(pathlib.Path("/proc/sys/vm/max_map_count").read_text())
        with pathlib.Path("/proc/self/maps").open("rb") as lines:
            return sum(1 for _ in lines), limit
    except (OSError, ValueError):
        return 0, 1


def release_programs_if_crowded() -> None:
    """Release all compiled programs if the process has used more than ``CROWDED`` of its mappings.

    They are compiled again when needed. Plates of similar size share their programs. Sixteen plates
    with one to four holes, whose sizes differ by 30 % and spacings by 70 %, swept and
    differentiated, take all 65530 mappings that Linux allows, and LLVM then ends the process.
    """
    used, limit = mappings()
    if used > CROWDED * limit:
        PROGRAMS.release()
