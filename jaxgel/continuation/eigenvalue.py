"""Lowest eigenvalue of the tangent as a differentiable observable: a margin of stability."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._programs import fitted
from .._tracing import is_traced
from .._types import Array, Float
from ..equilibrium import first_order_only
from ..linalg import SingularTangent, lowest_mode
from ..materials import gel_at_points
from ..mechanics import (
    curvature,
    deformation_gradients,
    factorised_tangent,
    linearise,
    scatter,
    shared_tangents,
)
from .path import Path, check_is_path
from .stability import StabilityAnalysis


def lowest_eigenvalue(path: Path) -> Float[Array, " k"]:
    """Lowest eigenvalue (k,) of the tangent in a ``path.Path``, with first derivatives.

    Its unit is the network's stiffness. It is that of `stability`, dimensionless, to the accuracy
    of Lanczos' iteration. v . K v / v . N v is stationary in the mode v, so that no derivative of v
    is needed: d lambda = v . (dK - lambda dN) v for v . N v = 1, by way of the state as well. If
    two modes share the eigenvalue it has no derivative, and gets that of one of them. nan for a
    state that was not reached. ValueError inside ``jax.jit`` and ``jax.vmap``, for second
    derivatives, and for transient swelling, whose states have a chemical potential in every group.
    """
    check_is_path(path)
    if path.potential is not None:
        raise ValueError(
            "lowest_eigenvalue: is of states of equilibrium; path.negative_pivots says whether a "
            "transient one is stable"
        )
    leaves, structure = jax.tree.flatten(
        (path.x, path.pressure, path.problem, jnp.asarray(path.value))
    )
    return _lowest(structure, leaves)[0]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _lowest(structure, leaves):
    """Eigenvalues (k,), and their modes (k, n, 2) with v . N v = 1."""
    if is_traced(leaves):
        raise ValueError("lowest_eigenvalue: is not available inside jit or vmap")
    x, pressure, problem, at = jax.tree.unflatten(structure, leaves)
    problem, values, modes = problem.prepared, [], []
    stiffness = StabilityAnalysis(problem).stiffness
    for state in zip(x, pressure, at, strict=True):
        lowest, mode = _lowest_of_state(problem, stiffness, *state)
        values.append(lowest)
        modes.append(scatter(mode, problem.free))
    return jnp.array(values), jax.device_put(np.stack(modes))


def _lowest_of_state(problem, stiffness, x, pressure, value):
    """Lowest eigenvalue and its mode (f,) of the tangent at one state, nan and 0 without one.

    Dead loads have no part in it.
    """
    now, mu = problem.at(value)
    now = now.touching(x)
    try:
        factor = (
            factorised_tangent(now, x, pressure, linearise(now, x, pressure, mu))
            if np.isfinite(x).all()
            else None
        )
    except SingularTangent:
        factor = None
    return (
        (np.nan, np.zeros(len(problem.free))) if factor is None else lowest_mode(factor, stiffness)
    )


@_lowest.defjvp
def _lowest_jvp(structure, primals, tangents):
    values, modes = first_order_only(_lowest(structure, *primals), "lowest_eigenvalue")
    inputs, dots = (
        jax.tree.unflatten(structure, primals[0]),
        jax.tree.unflatten(structure, tangents[0]),
    )
    (x, _, problem, at), (x_dot, _, problem_dot, at_dot) = inputs, dots
    shared, shared_dot = shared_tangents(problem, problem_dot)
    along = [fitted(field, "kn", shared.lengths) for field in (modes, x, x_dot)]
    return (values, modes), (_change(*along, shared, shared_dot, at, at_dot), jnp.zeros_like(modes))


@compiled()
def _change(modes, x, x_dot, problem, problem_dot, values, values_dot):
    """Tangents (k,) of the quotients of energy and network stiffness along ``modes`` (k, n, 2)."""

    def quotients(x, problem, values):
        def one(x, v, at):
            now, mu = problem.at(at)
            # eigenvalues are over the stiffness of the gel that is given, whatever the control
            model, gel = now.model, problem.gel
            densities = [
                gel_at_points(gel, k).Nv * jnp.sum(deformation_gradients(v, b) ** 2, (2, 3))
                for k, b in enumerate(model.blocks)
            ]
            network = sum(
                jnp.sum(block.weight * density)
                for block, density in zip(model.blocks, densities, strict=True)
            )
            return curvature(x, v, model, now.gel, mu, jnp.zeros_like(x)) / network

        return jax.vmap(one)(x, modes, values)

    return jax.jvp(quotients, (x, problem, values), (x_dot, problem_dot, values_dot))[1]
