"""Derivatives of equilibrium states with respect to everything they depend on.

Invariant: the residual r(x; model, gel, mu, loads) vanishes on the free degrees of freedom. Differentiated, K dx = -dr at fixed x, with
the tangent K of the state itself. Written as a rule for tangents, it gives forward, reverse and second derivatives alike; the linear
solves run on the host with the factors that the sweep left behind (``linear_solve.solve_near``).
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .energy import residual
from .linear_solve import solve_near
from .mixed import constants, linearise, state_pressure, tangent


@functools.partial(jax.jit, static_argnames="pattern")
def state_tangents(x, inputs, inputs_dot, pattern):
    """Tangents (k, n, 2) of the equilibria ``x`` (k, n, 2) for tangents of their ``inputs`` (model, gel, mu (k,), loads).

    Constrained degrees of freedom move with the nodes of the dry plate. nan where a tangent is singular.
    """
    model, gel, mu, loads = inputs
    model_dot, gel_dot, mu_dot, loads_dot = inputs_dot
    fixed = constants(model)
    moved = jax.jvp(lambda cloud: cloud.nodes, (model.cloud,), (model_dot.cloud,))[1]
    held = np.ones(moved.size)
    held[pattern.free] = 0.0
    carried = held.reshape(moved.shape) * moved

    def one(state):
        x, mu, mu_dot = state
        args, dots = (model, gel, mu, loads), (model_dot, gel_dot, mu_dot, loads_dot)
        _, imbalance = jax.jvp(residual, (x, *args), (carried, *dots))
        pressure = state_pressure(x, model, gel, mu)
        pairs = tangent(x, pressure, linearise(x, pressure, *args, fixed)[0], model, gel, fixed)
        correction = _solve(pattern, pairs, lambda v: _free_product(v, x, args, pattern), -imbalance.ravel()[pattern.free])
        return carried.ravel().at[pattern.free].add(correction).reshape(x.shape)

    return lax.map(one, (x, mu, mu_dot))


def _free_product(v, x, args, pattern):
    """Product (f,) of the free-free tangent with ``v`` (f,)."""
    direction = jnp.zeros(x.size).at[pattern.free].add(v).reshape(x.shape)
    return jax.jvp(lambda x: residual(x, *args), (x,), (direction,))[1].ravel()[pattern.free]


def _solve(pattern, pairs, product, rhs):
    """Solution (f,) of product(v) = rhs on the host, differentiable in whatever ``product`` depends on."""

    def host(_, rhs):
        shape = jax.ShapeDtypeStruct(rhs.shape, rhs.dtype)
        return jax.pure_callback(functools.partial(solve_near, pattern), shape, pairs, rhs, vmap_method="sequential")

    return lax.custom_linear_solve(product, rhs, host, symmetric=True)
