"""Compiled functions under JAX's transformations: derivatives as programs of their own."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgel._compiled import compiled
from jaxgel._tracing import everywhere

X, Y = jnp.array([0.3, 0.5, 0.7]), jnp.array([1.0, 2.0, 3.0])


@compiled(static=("power",))
def wave(x, y, *, power):
    return jnp.sin(x) * y**power, {"norm": jnp.sum(x**2), "numbers": jnp.arange(3)}


def by_programs(x):
    product, rest = wave(x, Y, power=2)
    return product.sum() + rest["norm"]


def at_once(x):
    return (jnp.sin(x) * Y**2).sum() + jnp.sum(x**2)


@pytest.mark.parametrize(
    "transformed",
    [
        lambda f: jax.grad(f)(X),
        lambda f: jax.hessian(f)(X),
        lambda f: jax.jacrev(jax.jacrev(f))(X),
        lambda f: jax.jacfwd(jax.jacfwd(jax.grad(f)))(X),
        lambda f: jax.vmap(jax.grad(f))(jnp.stack([X, Y])),
        lambda f: jax.jit(jax.grad(f))(X),
        lambda f: jax.grad(jax.jit(f))(X),
        lambda f: jax.linearize(f, X)[1](Y),
    ],
)
def test_derivatives_of_every_kind_are_those_of_jax(transformed):
    np.testing.assert_allclose(
        transformed(by_programs), transformed(at_once), rtol=1e-14, atol=1e-14
    )


def test_a_reverse_pass_takes_only_the_results_that_are_asked_for():
    """The root has an infinite slope at 0, which no cotangent multiplies."""

    @compiled()
    def roots(x):
        return jnp.sqrt(x), x**2

    np.testing.assert_array_equal(jax.grad(lambda x: roots(x)[1].sum())(jnp.zeros(2)), [0.0, 0.0])


def test_values_under_derivatives_are_found_by_the_program_that_finds_them_without():
    names = []
    wave(X + 1, Y, power=3)
    monitor = jax.monitoring.register_event_duration_secs_listener
    monitor(
        lambda event, _, fun_name="", **__: (
            names.append(fun_name) if "backend_compile" in event else None
        )
    )
    jax.value_and_grad(lambda x: wave(x, Y, power=3)[0].sum())(X)
    assert names and not any("wave" in name for name in names)


def test_a_number_of_python_and_one_of_an_array_take_one_program():
    @compiled()
    def product(x, factor):
        return x * factor

    names = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, _, fun_name="", **__: (
            names.append(fun_name) if "backend_compile" in event else None
        )
    )
    for factor in (2.0, np.float64(3.0), X[0]):
        product(X, factor)
    for factor in (2.0, np.float64(3.0)):
        product(X, factor=factor)
    assert names.count("jit(product)") == 2  # one by place, one by name


@pytest.mark.parametrize("batches", [1, 2])
def test_a_condition_of_all_members_chooses_one_branch_for_a_batch(batches):
    """Also of batches of batches, and of their derivatives; one of its own computes both."""

    def slope(condition, x):
        return jax.grad(lambda x: jax.lax.cond(condition(x < 2), jnp.sin, jnp.cos, x))(x)

    def of_batch(condition):
        mapped = functools.partial(slope, condition)
        for _ in range(batches):
            mapped = jax.vmap(mapped)
        return mapped

    few, all_three = (numbers.reshape((1,) * (batches - 1) + (-1,)) for numbers in (X, Y))
    np.testing.assert_array_equal(of_batch(everywhere)(few), jnp.cos(few))
    np.testing.assert_array_equal(of_batch(everywhere)(all_three), -jnp.sin(all_three))
    both = [
        "select_n" in str(jax.make_jaxpr(of_batch(condition))(few))
        for condition in (everywhere, lambda holds: holds)
    ]
    assert both == [False, True]
