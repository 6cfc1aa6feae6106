"""Status of each state of a path in words, as in ``history.csv``."""

import numpy as np

from .._memo import once_per_owner
from ..continuation import Path
from .gaps import min_gap

SELF_CONTACT = "invalid: self-contact"
IN_CONTACT = "a hole's sides touch"
SWITCHED = "switched to the stable branch"

min_gap_once = once_per_owner(min_gap)
"""`min_gap`, evaluated once for a path: two columns of the table depend on it."""


def status_texts(path: Path) -> list[str]:
    """Status of each state (k): how Newton ended, or that the state is on another branch than the one before, or in contact.

    With contact, a state is in contact where a gap is below the range of contact. Without, all states from the first one on in which a
    hole's boundary crosses itself are ``SELF_CONTACT``.
    """
    gap = min_gap_once(path)
    switched = getattr(path, "switched", np.zeros(len(path.mu), dtype=bool))
    crossed = np.logical_or.accumulate(gap <= 0)
    touching = gap < (0.0 if path.model.contact is None else float(path.model.contact.range))
    texts = []
    for status, *facts in zip(path.status, switched, touching, strict=True):
        found = [text for text, holds in zip((SWITCHED, IN_CONTACT), facts, strict=True) if holds]
        texts.append(", ".join(found) or status.name.lower().replace("_", " "))
    return [SELF_CONTACT if c else text for text, c in zip(texts, crossed, strict=True)]
