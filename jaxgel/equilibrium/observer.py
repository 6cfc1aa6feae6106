"""Observers: events of a search for states."""

import dataclasses
from collections.abc import Callable
from typing import Any

from .state import State


def _nothing(_: Any) -> None:
    """Do nothing."""


@dataclasses.dataclass(frozen=True)
class Observer:
    """Functions called during a search for states; the user makes it, and the default does nothing.

    >>> values = []
    >>> observer = Observer(accepted=lambda state: values.append(state.value))
    """

    accepted: Callable[[State], object] = _nothing
    """Called with each accepted `State`, with its factor, by blocks for a symmetric state."""
    refused: Callable[[State], object] = _nothing
    """Called with each state that was tried and is not accepted; its ``status`` says why.

    A shorter step follows, or the end.
    """
    iteration: Callable[[State], object] = _nothing
    """Called with each iterate of Newton's method at a value of the control, linearised there.

    Not of searches beside it.
    """
    located: Callable[[Any], object] = _nothing
    """Called with each `CriticalPoint` of `critical_points` once it is located."""


UNOBSERVED = Observer()
