"""Differentiable search for states: inputs by kind, and the columns of the resulting path."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .._primitives import differentiated_value
from .._tracing import is_traced
from .._types import Array
from .path import Path

RESIDUAL = (
    "path.residual: the residual of a converged state is round-off and has no derivative; use "
    "path.energy or path.x"
)


@dataclasses.dataclass(frozen=True, eq=False)
class TracedSearch:
    """Identity of a traced search besides its float arrays, and its other results; by identity.

    It is hashed by identity.
    """

    structure: Any
    """Tree structure of the inputs."""
    floating: tuple[bool, ...]
    """Which leaves are floating-point arrays, that is differentiable."""
    rest: list[Any]
    """The other leaves."""
    options: Any
    """How states are looked for."""
    found: dict[str, Any] = dataclasses.field(default_factory=dict)
    """How the search ended, and what its derivatives need.

    Empty for a sweep that is part of a program.
    """

    @classmethod
    def of(cls, inputs: Any, options: Any, refusal: str) -> tuple["TracedSearch", list[Array]]:
        """The search and the floating-point leaves of its ``inputs``, a pytree.

        ValueError with the ``refusal`` if others are traced.
        """
        leaves, structure = jax.tree.flatten(inputs)
        floating = tuple(
            bool(jnp.issubdtype(jnp.result_type(leaf), jnp.floating)) for leaf in leaves
        )
        floats, rest = (
            [leaf for leaf, f in zip(leaves, floating, strict=True) if f is kind]
            for kind in (True, False)
        )
        rest = [differentiated_value(leaf) for leaf in rest]
        if is_traced(rest):
            raise ValueError(refusal)
        return cls(structure, floating, rest, options), floats

    def inputs(self, floats: Iterable[Any], rest: list[Any] | None = None) -> Any:
        """The inputs of their floating-point leaves.

        With the ``rest`` in place of the other leaves.
        """
        leaves, others = iter(floats), iter(self.rest if rest is None else rest)
        return jax.tree.unflatten(
            self.structure, [next(leaves) if f else next(others) for f in self.floating]
        )

    def tangents(self, dots: Iterable[Any]) -> Any:
        """The tangents of the inputs, of those of their floating-point leaves."""
        floats = [
            np.zeros(dot.shape, dot.dtype) if isinstance(dot, SymbolicZero) else dot for dot in dots
        ]
        return self.inputs(
            floats, [np.zeros(np.shape(leaf), jax.dtypes.float0) for leaf in self.rest]
        )


def padded_columns(
    path: Path, names: Iterable[str], missing: int, **others: np.ndarray
) -> dict[str, Array]:
    """The columns of a path and ``others``, with nan rows for ``missing`` states.

    These have the status of its end.
    """
    fills = {
        "status": int(path.stop),
        "derivative": int(path.stop),
        "newton_iterations": 0,
        "negative_pivots": -1,
        "switched": 0,
    }

    def pad(name, column):  # in NumPy: nothing is compiled
        return jax.device_put(
            np.concatenate(
                [column, np.full((missing, *np.shape(column)[1:]), fills.get(name, np.nan))]
            )
        )

    return {
        name: pad(name, column)
        for name, column in ({name: getattr(path, name) for name in names} | others).items()
    }
