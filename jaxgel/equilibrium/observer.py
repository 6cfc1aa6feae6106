"""What is told of a search for states while it goes."""

import dataclasses
from collections.abc import Callable
from typing import Any

from .state import State


def _nothing(_: Any) -> None:
    """Do nothing."""


@dataclasses.dataclass(frozen=True)
class Observer:
    """Functions that a search for states calls while it goes; what is not given does nothing.

    >>> values = []
    >>> observer = Observer(accepted=lambda state: values.append(state.value))
    """

    accepted: Callable[[State], object] = _nothing
    """Called with each accepted `State`, which still has its factor, of a symmetric state by blocks."""
    refused: Callable[[State], object] = _nothing
    """Called with each state that was tried and is not accepted; its ``status`` says why. A shorter step follows, or the end."""
    iteration: Callable[[State], object] = _nothing
    """Called with each iterate of Newton's method at a value of the control, linearised there; not of searches beside it."""
    located: Callable[[Any], object] = _nothing
    """Called with each `CriticalPoint` of `critical_points` once it is located."""


UNOBSERVED = Observer()
