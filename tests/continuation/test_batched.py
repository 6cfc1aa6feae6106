"""Many sheets at once by one compiled program."""

import jax
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from jaxgel.continuation import Batched


def test_a_batch_that_exhausts_the_memory_is_halved_and_another_error_is_raised():
    """By a program that takes 2 sheets at most in place of the compiled one.

    BLAS has one thread meanwhile: with more, a factor waits for other processes.
    """
    made, sizes = object.__new__(Batched), []
    made.devices, made.size, made._unknowns = ["one"], 8, 200

    def program(given, values):
        sizes.append(len(values))
        assert {pool["num_threads"] for pool in threadpool_info()} == {1}
        if len(values) > 2:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory")
        return {"x": given["Nv"] * 2}, values

    def broken(*_):
        raise jax.errors.JaxRuntimeError("INTERNAL: no kernel")

    made._programs = {(): program, ("C4",): broken}
    columns, rows = made((), {"Nv": np.arange(7.0)}, np.arange(7.0)[:, None])
    np.testing.assert_array_equal(columns["x"], 2 * np.arange(7.0))
    np.testing.assert_array_equal(rows[:, 0], np.arange(7.0))
    assert (sizes, made.size) == ([8, 4, 2, 2, 2, 2], 2)
    with pytest.raises(jax.errors.JaxRuntimeError, match="INTERNAL"):
        made(("C4",), {"Nv": np.zeros(2)}, np.zeros((2, 1)))
