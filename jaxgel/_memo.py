"""Values that are computed once per object and freed with it."""

import functools
from collections.abc import Callable
from typing import TypeVar

F = TypeVar("F", bound=Callable[..., object])


def once_per_owner(function: F) -> F:
    """``function(owner, *args)``, evaluated once for each owner and arguments (hashable).

    The owner, an object that does not change and is compared by identity, carries the values: they
    live as long as it does, and no module keeps a container of its own. For host data, such as
    sparsity patterns; traced values only of an owner that is traced itself.
    """

    @functools.wraps(function)
    def kept(owner, *args):
        values = owner.__dict__.setdefault("_once", {})
        key = (kept, *args)
        if key not in values:
            values[key] = function(owner, *args)
        return values[key]

    return kept
