"""Recent factors, kept for the linear systems of derivatives."""

import collections
import threading
import weakref
from typing import Any

import jax
import numpy as np

from .blocks import BlockFactor
from .factors import Factor

REMEMBERED_BYTES = 2**29  # most that the kept factors of all plates may fill together


class FactorCache:
    """The latest factors, each with the discretisation and numbers of its tangent.

    Together they fill at most ``bytes``, the latest one excepted: it stays however large it is.
    When a factor is added, the oldest ones are dropped until the rest fits; once a discretisation
    is no longer in use, its own are. A factor that was dropped costs the time to make it anew.
    Threads may add and ask at the same time.
    """

    def __init__(self, bytes: float):  # noqa: A002
        self.bytes = bytes
        self._lock = threading.RLock()  # a discretisation may end while its factor is added
        self._kept: collections.deque[tuple] = collections.deque()  # newest last

    def contents(self) -> list[tuple[Factor | BlockFactor, object, list[np.ndarray], object]]:
        """Factors, references to owners, leaves and tree structures of states, oldest first."""
        with self._lock:
            return list(self._kept)

    def add(self, made: Factor | BlockFactor, owner: object, state: Any) -> None:
        """Keep the factor of the tangent at a ``state``, a pytree.

        ``owner`` is compared by identity.
        """
        leaves, structure = jax.tree.flatten(state)
        of = weakref.ref(owner, self._forget)
        with self._lock:
            self._kept.append((made, of, [np.asarray(leaf) for leaf in leaves], structure))
            while len(self._kept) > 1 and sum(kept.size for kept, *_ in self._kept) > self.bytes:
                self._kept.popleft()

    def _forget(self, of):
        with self._lock:
            self._kept = collections.deque(kept for kept in self._kept if kept[1] is not of)

    def find(self, owner: object, state: Any) -> Factor | BlockFactor | None:
        """The factor of this state's tangent; None if it is not kept."""
        leaves, structure = jax.tree.flatten(state)
        for made, of, kept, kept_structure in reversed(self.contents()):
            if (
                of() is owner
                and kept_structure == structure
                and all(map(np.array_equal, kept, leaves))
            ):
                return made
        return None


RECENT_FACTORS = FactorCache(REMEMBERED_BYTES)
"""The factors of this process."""
