"""Loops over patches: what their reverse passes keep."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgel.mechanics.patchwise import over_patches


def test_a_reverse_pass_keeps_no_copy_of_the_patches_arrays():
    """JAX 0.10.1: `jax.checkpoint` inside a branch of `lax.cond` in a scan keeps one of all."""
    patches, count = np.ones((64, 4000)), jnp.asarray(52)

    def total(scale, patches):
        return jnp.sum(
            over_patches(lambda a: jnp.sum(jnp.sin(scale * a), axis=1), (patches,), count)
        )

    program = jax.jit(jax.grad(total)).lower(0.5, patches).compile()
    np.testing.assert_allclose(program(0.5, patches), 52 * 4000 * np.cos(0.5), rtol=1e-12)
    assert program.memory_analysis().temp_size_in_bytes < patches.nbytes / 4
