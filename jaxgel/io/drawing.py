"""A drawing that was read: its closed outlines, and what was left out of them."""

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from .._types import Float

FLATNESS = 1e-3  # of an outline's size: distance of a curve's chords when a drawing is read


class Omission(NamedTuple):
    """Why an entity of a drawing is none of its outlines."""

    kind: str
    """Name of the entity or element in its format, such as "LINE" or "text"."""
    layer: str
    """Layer of a DXF entity; empty in formats without layers."""
    reason: str
    """Reason in a few words, such as "layer off"."""


@dataclass(frozen=True)
class Drawing:
    """Closed outlines of a drawing and what was left out."""

    outlines: list[Float[np.ndarray, "_ 2"]]
    """Closed outlines, mm, y axis up; the first point may be repeated at the end."""
    omissions: Counter[Omission] = field(default_factory=Counter)
    """Number of entities left out, by kind, layer and reason."""
