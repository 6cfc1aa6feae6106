"""Checks of what a person writes, and the words that say what was expected."""

import difflib

import numpy as np


def did_you_mean(name, known):
    """The end of an error message for an unknown ``name``: the nearest of the ``known`` names, and all of them."""
    known = list(known)
    near = difflib.get_close_matches(str(name), known, n=1, cutoff=0.5)
    return (f"did you mean {near[0]!r}? " if near else "") + "accepted: " + ", ".join(known)


def finite_numbers(value, shape, field):
    """``value`` as nested tuples of floats of ``shape``; ValueError that starts with ``field`` for what is not finite numbers."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{field}: {value!r} is not {' x '.join(map(str, shape))} finite numbers")
    return tuple(map(tuple, array.tolist())) if len(shape) == 2 else tuple(array.tolist())


def is_number(word):
    """Whether a word can be read as a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True
