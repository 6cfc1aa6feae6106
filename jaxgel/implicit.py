"""Derivatives of equilibrium states with respect to everything they depend on.

Invariant: the residual r(x; model, gel, mu, loads) vanishes on the free degrees of freedom. Differentiated, K dx = -dr at fixed x, with
the tangent K of the state itself. Written as a rule for tangents, it gives forward, reverse and second derivatives alike; the linear
solves run on the host with the factors that the sweep left behind (``linear_solve.solve_near``), and a state that nothing asks about
costs none.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from . import constraints
from .constraints import reduced, spread
from .energy import residual
from .linear_solve import solve_near
from .mixed import constants, linearise, state_pressure, tangent

TOGETHER_BYTES = 2**28  # positions gathered cell by cell of the states that are differentiated together


@functools.partial(jax.jit, static_argnames="pattern")
def state_tangents(x, inputs, inputs_dot, pattern):
    """Tangents (k, n, 2) of the equilibria ``x`` (k, n, 2) for tangents of their ``inputs`` (model, gel, mu (k,), loads).

    Constrained degrees of freedom move with the nodes of the dry plate. nan where a tangent is singular.
    """
    model, gel, mu, loads = inputs
    model_dot, gel_dot, mu_dot, loads_dot = inputs_dot
    moved = jax.jvp(lambda cloud: cloud.nodes, (model.cloud,), (model_dot.cloud,))[1]
    carried = constraints.carried(moved, model.lists.topology.plate, pattern.free)

    def imbalance(state):
        x, mu, mu_dot = state
        change = jax.jvp(residual, (x, model, gel, mu, loads), (carried, model_dot, gel_dot, mu_dot, loads_dot))[1]
        return reduced(change, pattern.free)

    def product(v):  # of the block-diagonal free-free tangents of all states with v (k, f)
        return _over_states(lambda s: _free_product(*s, (model, gel, loads), pattern), (v, x, mu), model)

    def solve(_, rhs):
        fixed = constants(model)
        return lax.map(lambda s: _solve(*s, (model, gel, loads), fixed, pattern), (rhs, x, mu))

    rhs = -_over_states(imbalance, (x, mu, mu_dot), model)
    correction = lax.custom_linear_solve(product, rhs, solve, symmetric=True)
    return carried + jax.vmap(lambda dx: spread(dx, carried.shape, pattern.free))(correction)


def no_tangent(values):
    """The tangent of ``values`` that have no derivative: zeros, of JAX's type for it."""
    floating = jnp.issubdtype(values.dtype, jnp.floating)
    return jnp.zeros_like(values) if floating else np.zeros(values.shape, dtype=jax.dtypes.float0)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def only_first(values, what):  # noqa: ARG001
    """The ``values`` of ``what``; used in a rule for tangents, ValueError where that is differentiated once more."""
    return values


@only_first.defjvp
def _refuse(what, *_):
    raise ValueError(f"{what}: has first derivatives only")


def _over_states(function, states, model):
    """``function`` of each state, for as many of them at once as memory allows: per cell that is one product of small matrices."""
    one = 16 * sum(block.nodes.size for block in model.blocks)
    return lax.map(function, states, batch_size=min(len(states[0]), max(1, TOGETHER_BYTES // one)))


def _free_product(v, x, mu, args, pattern):
    """Product (f,) of the free-free tangent at ``x`` with ``v`` (f,)."""
    model, gel, loads = args
    direction = spread(v, x.shape, pattern.free)
    return reduced(jax.jvp(lambda x: residual(x, model, gel, mu, loads), (x,), (direction,))[1], pattern.free)


def _solve(rhs, x, mu, args, fixed, pattern):
    """Solution (f,) for the tangent at ``x``, on the host; 0 for 0 at no cost."""
    model, gel, loads = args

    def solution(rhs):
        pressure = state_pressure(x, model, gel, mu)
        pairs = tangent(x, pressure, linearise(x, pressure, model, gel, mu, loads, fixed)[0], model, gel, fixed)
        shape = jax.ShapeDtypeStruct(rhs.shape, rhs.dtype)
        return jax.pure_callback(functools.partial(solve_near, pattern), shape, pairs, rhs, vmap_method="sequential")

    return lax.cond(jnp.any(rhs != 0), solution, jnp.zeros_like, rhs)
