"""Whether JAX is differentiating, so that arrays have no numbers to look at."""

import jax


def is_traced(*trees: object) -> bool:
    """Whether any leaf of the pytrees is a tracer of JAX."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))
