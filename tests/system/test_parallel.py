"""A function of parts in threads: the same values and derivatives of every order as one call of `jax.vmap`."""

import dataclasses
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgel import _parallel
from jaxgel._parallel import over_parts

RANDOM = np.random.default_rng(0)
X, N, C = (jnp.asarray(RANDOM.normal(size=shape)) for shape in ((5, 3), (5, 3), (3,)))
NUMBERS = jnp.arange(5)


@dataclasses.dataclass(frozen=True)
class Waves:
    """Two values of each part (3,), one with and one without the shared coefficients (3,)."""

    power: int

    def __call__(self, x, number, c):
        return [jnp.sin(c * x) ** self.power * jnp.sum(x), number * jnp.exp(x).sum()]


def one_by_one(x, c):
    return over_parts(Waves(2), (x, NUMBERS), (c,))


def in_threads(x, c):
    return over_parts(Waves(2), (x, NUMBERS, jnp.broadcast_to(c, x.shape)))


def at_once(x, c):
    return jax.vmap(Waves(2), (0, 0, None))(x, NUMBERS, c)


def scalar(function):
    """A function of both arguments that is not linear in the values."""
    return lambda x, c: sum(jnp.sum(value**3) for value in function(x, c))


def assert_same(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


OF = {
    "values": lambda f: f(X, C),
    "tangents": lambda f: jax.jvp(f, (X, C), (N, 2 * C)),
    "tangents of one argument": lambda f: jax.jvp(lambda c: f(X, c), (C,), (2 * C,)),
    "gradient": lambda f: jax.grad(scalar(f), (0, 1))(X, C),
    "gradient of one value": lambda f: jax.grad(lambda x: jnp.sum(f(x, C)[0] ** 2))(X),
    "Hessian times vector": lambda f: jax.jvp(jax.grad(scalar(f), (0, 1)), (X, C), (N, 2 * C))[1],
    "gradient of a directional derivative": lambda f: jax.grad(lambda x: jax.jvp(scalar(f), (x, C), (N, C))[1])(X),
    "reverse of reverse": lambda f: jax.grad(lambda x: jnp.sum(jax.grad(scalar(f), (0, 1))(x, C)[1] ** 2))(X),
    "forward Jacobian": lambda f: jax.jacfwd(f, 1)(X, C),
    "reverse Jacobian": lambda f: jax.jacrev(f)(X, C),
    "batch": lambda f: jax.vmap(f, (0, None))(jnp.stack([X, N]), C),
    "batch of what is shared": lambda f: jax.vmap(f, (None, 1))(X, jnp.stack([C, 2 * C], axis=1)),
    "gradients of a batch": lambda f: jax.grad(lambda x: sum(jnp.sum(v**2) for v in jax.vmap(f, (0, None))(x, C)))(jnp.stack([X, N])),
    "batch of gradients": lambda f: jax.vmap(jax.grad(scalar(f), (0, 1)), (0, None))(jnp.stack([X, N]), C),
    "transpose of the transpose": lambda f: jax.linear_transpose(jax.vjp(f, X, C)[1], f(X, C))((N, C)),
}  # fmt: skip


@pytest.mark.parametrize("how", [one_by_one, in_threads, "jit"])
@pytest.mark.parametrize("what", OF)
def test_parts_have_the_values_and_derivatives_of_one_call(what, how):
    of = OF[what]
    assert_same(jax.jit(lambda: of(one_by_one))() if how == "jit" else of(how), of(at_once))


def test_parts_that_are_linear_in_zeros_are_not_called(monkeypatch):
    calls = []
    program = _parallel._program

    def counted(*args):
        made = program(*args)
        return lambda *part: calls.append(part) or made(*part)

    monkeypatch.setattr(_parallel, "_program", counted)
    some = N.at[jnp.array([0, 1, 3])].set(0.0)
    for gradient in (lambda f: jax.vjp(f, X, C)[1], lambda f: jax.linear_transpose(lambda x: jax.jvp(f, (X, C), (x, 0 * C))[1], X)):
        cotangents = [some, 0.0 * NUMBERS]
        expected, pull = gradient(at_once)(cotangents), gradient(one_by_one)
        calls.clear()
        assert_same(pull(cotangents), expected)
        assert len(calls) == 2


def linear(x, c, x_dot, c_dot):
    return [x * c_dot + x_dot * c]


def test_arguments_in_which_the_function_is_linear():
    def pair(x_dot, c_dot):
        return over_parts(linear, (X,), (C,), linear=(x_dot,), shared_linear=(c_dot,))

    assert_same(pair(N, C), [X * C + N * C])
    assert_same(jax.linear_transpose(pair, X, C)([N]), (N * C, jnp.sum(N * X, axis=0)))


def test_parts_run_in_several_threads(monkeypatch):
    """Each of two calls waits for the other one."""
    monkeypatch.setattr(_parallel, "usable_threads", lambda: 2)
    both = threading.Barrier(2, timeout=60)
    monkeypatch.setattr(_parallel, "_program", lambda *_: lambda _, x: ([], [both.wait() * 0 + np.asarray(x)]))
    np.testing.assert_array_equal(over_parts(lambda x: [2 * x], (X[:4],))[0], X[:4])
