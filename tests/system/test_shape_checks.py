"""Run-time checks of annotations (tests/shape_checks.py) report errors and nothing else."""

import dataclasses

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import shape_checks

from jaxgel._types import Array, Float


@shape_checks.checked
def stretched(x: Float[Array, "n 2"], by: Float[Array, " n"]) -> Float[Array, "n 2"]:
    if by.ndim > 1:
        raise ValueError("by: one number per node")
    return x[:1] if by[0] == 0 else x * by[:, None]


@shape_checks.checked_class
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Nodes:
    x: Float[Array, "n 2"]


def test_right_shapes_pass_and_wrong_ones_are_found():
    x = np.ones((3, 2))
    assert stretched(x, np.ones(3)).shape == (3, 2)
    for arguments in (
        (np.ones((3, 3)), np.ones(3)),
        (x, np.ones(1)),
        (x.astype(int), np.ones(3)),
        (x, np.zeros(3)),
    ):
        with pytest.raises(jaxtyping.TypeCheckError):
            stretched(*arguments)


def test_what_a_function_refuses_is_left_to_it():
    with pytest.raises(ValueError, match="one number per node"):
        stretched(np.ones((3, 2)), np.ones((3, 1)))


def test_a_dataclass_is_checked_where_it_is_made_but_not_where_jax_fills_it():
    with pytest.raises(jaxtyping.TypeCheckError):
        Nodes(jnp.ones(3))
    nodes = Nodes(jnp.ones((3, 2)))
    assert jax.vmap(lambda scale: Nodes(scale * nodes.x))(jnp.ones(4)).x.shape == (4, 3, 2)
    assert jax.tree.map(jnp.sum, nodes).x.shape == ()
