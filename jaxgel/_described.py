"""Texts of tree structures and static values, equal in every process, to name kept programs."""

import dataclasses
import hashlib
import operator
import sys

import jax
import numpy as np

from ._memo import once_per_owner
from ._tracing import is_traced


class NotDescribed(Exception):
    """A value whose text in another process may stand for something else."""


def described(value: object) -> str:
    """Text of a tree structure or static value, equal in every process with the same jaxgel.

    `NotDescribed` if there is none. Functions and classes are named, those of jaxgel and Python's
    own alone: others may change.
    """
    if value is None or value is type(None) or isinstance(value, bool | int | float | str):
        return repr(value)
    if (
        isinstance(value, np.ndarray | np.generic | jax.Array)
        and not is_traced(value)
        and value.dtype != object
    ):
        return (
            f"{value.dtype}{value.shape}{hashlib.sha256(np.asarray(value).tobytes()).hexdigest()}"
        )
    if isinstance(getattr(value, "wkb", None), bytes):  # a polygon of shapely
        return hashlib.sha256(value.wkb).hexdigest()
    if isinstance(value, tuple | list):
        parts = value
    elif isinstance(value, dict):
        parts = tuple(value.items())
    elif isinstance(value, jax.tree_util.PyTreeDef):
        parts = (value.node_data(), value.children())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        return f"{_name(type(value))}({_fields(value)})"
    else:
        return _name(value)
    return f"{_name(type(value))}({', '.join(map(described, parts))})"


@once_per_owner
def _fields(value):
    """A digest of a dataclass's fields, which may be a whole cloud."""
    parts = ", ".join(
        described(getattr(value, field.name))
        for field in dataclasses.fields(value)
        if field.compare
    )
    return hashlib.sha256(parts.encode()).hexdigest()


def _name(value):
    """The name of a top-level function or class of jaxgel, of Python's builtins or of jaxlib."""
    module, name = (
        getattr(value, "__module__", None) or "",
        getattr(value, "__qualname__", None) or "",
    )
    if module.split(".")[0] not in ("builtins", "jaxlib", __package__):
        raise NotDescribed
    try:
        known = operator.attrgetter(name)(sys.modules[module])
        while known is not value:  # decorated
            known = known.__wrapped__
    except (AttributeError, KeyError):
        raise NotDescribed from None
    return f"{module}.{name}"
