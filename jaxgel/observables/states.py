"""A function of one state, evaluated at all states of a path."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ParamSpec, Protocol, TypeVar, runtime_checkable

import jax
import numpy as np

from .._compiled import compiled
from .._sizes import NODES, resized, room
from .._types import Array, Float
from .._validation import kind_in_words
from ..continuation import Path
from ..discretisation import Body, Interpolation, Model
from ..mechanics import Loops, loops_of

ROUNDED = 1e-3  # of the values of a path, or of their range: values that people type are rounded


@runtime_checkable
class States(Protocol):
    """States of a model that need not be in equilibrium; a path is one."""

    model: Model
    """The model."""
    x: Float[Array, "k n 2"]
    """Nodal positions, mm."""


P = ParamSpec("P")
R = TypeVar("R")


def of_path(function: Callable[P, R]) -> Callable[P, R]:
    """Observable ``function(path, ...)`` with a one-line ValueError for other arguments.

    If it is no path.
    """

    @functools.wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        path = args[0] if args else kwargs.get("path")
        if isinstance(path, type) or not isinstance(path, States):
            raise ValueError(
                f"path: {kind_in_words(path)} is not accepted; give a Path, as sweep(problem, "
                "values) returns it"
            )
        return function(*args, **kwargs)

    return checked


def with_room(x: Float[Array, "k n 2"]) -> Float[Array, "k m 2"]:
    """Nodal positions of states, padded: programs by node numbers serve similar plates."""
    return resized(x, (x.shape[0], room(x.shape[1], NODES), 2))


def over_outlines(function: Callable[[Float[Array, "n 2"], Body, Loops], Any], path: States) -> Any:
    """``function(x, body, loops)`` of shared outlines at every state: arrays with axis k first."""
    return _mapped(
        function, with_room(path.x), outlines_of(path.model.shared), loops_of(path.model)[0]
    )


@compiled(static=("function",))
def _mapped(function: Callable, x: Float[Array, "k n 2"], body: Body, loops: Loops) -> Any:
    return jax.vmap(function, in_axes=(0, None, None))(x, body, loops)


def outlines_of(body: Body) -> Body:
    """A body of nodes and outlines alone, if no patch is needed.

    Programs have no derivatives by patches then.
    """
    return dataclasses.replace(body, blocks=(), contact=None)


def positions_of(probe: Interpolation, path: States) -> Float[Array, "k p 2"]:
    """Deformed positions (k, p, 2) of the points of a ``probe`` in every state, mm."""
    count = len(probe.points)
    return resized(
        _positions(probe.with_room(room(count, NODES)), with_room(path.x)), (len(path.x), count, 2)
    )


@compiled()
@functools.partial(jax.vmap, in_axes=(None, 0))
def _positions(probe, x):
    return probe.position(x)


def state_at(path: Path, value: float) -> int:
    """Number of the state nearest to a ``value`` of the path's control, the first of several.

    ValueError beyond the ends of the path.
    """
    values = np.asarray(path.value, dtype=float)
    low, high = values.min(), values.max()
    reach = ROUNDED * max(high - low, abs(low), abs(high))
    if not low - reach <= value <= high + reach:
        name = path.control.name
        raise ValueError(
            f"{name}: {value:g} is beyond the path, which runs from {values[0]:g} to "
            f"{values[-1]:g}; give a value within"
        )
    return int(np.abs(values - value).argmin())
