"""Critical points of a branch and how they move with the design.

Derivative: lambda = v . K v = phi(x, theta, mu) with the modes normalised. Its change with theta at fixed x, and by the state's motion
dx = -K^-1 dr across the mode, is that of phi - w . r with K w = dphi/dx across the mode; the modes' own motion drops out. With
Phi = phi - w . r at fixed x, v, w:  d mu_c = -(dPhi/dtheta) / (dPhi/dmu). For a double eigenvalue phi is the sum over both modes. At a
fold Phi = v . r. A complex mode counts as two, its real and its imaginary part.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from .._types import Array, Float
from ..continuation import check_mu, is_traced
from ..discretisation import Model
from ..equilibrium import first_order_only
from ..materials import Gel
from ..mechanics import curvature, free_dofs, localised, prescribed_motion, residual
from .points import CriticalPoint
from .search import locate

Point = TypeVar("Point")


def critical_points(
    model: Model, gel: Gel, *, mu: tuple[float, float], loads: Float[Array, "n 2"] | None = None, most: int = 4
) -> list[CriticalPoint]:
    """``CriticalPoint``s of the branch that continues the dry state, in the order of mu in ``mu = (first, last)``; at most ``most``.

    They are located to ``search.TOLERANCE``; a fold where the branch turns back, if it does (on other branches: see ``folds``).
    ``point.mu`` is differentiable once in everything the model and the gel depend on, forward and reverse; derivatives for designs that
    break the symmetry are those of the perfect branch, for a double eigenvalue those of the mean. ValueError inside jit or vmap and
    for second derivatives.
    """
    check_mu(mu)
    if not (isinstance(mu, tuple) and len(mu) == 2):
        raise ValueError(f"mu: {mu} is not accepted, it must be a tuple (first, last)")
    ends = tuple(map(float, mu))
    return located("critical_points", lambda *at: locate(*at[:2], ends, at[2], most), model, gel, loads)


def located(
    name: str, find: Callable[[Model, Gel, Float[Array, "n 2"]], list[Point]], model: Model, gel: Gel, loads: Float[Array, "n 2"] | None
) -> list[Point]:
    """The points that ``find(model, gel, loads)`` gives, with a ``mu`` that JAX differentiates as that of a `CriticalPoint`.

    A point has its ``mu``, ``kind``, ``x``, ``modes`` and ``correction``. Errors speak of ``name``.
    """
    loads, gel = jnp.zeros((model.n_nodes, 2)) if loads is None else loads, localised(model, gel)
    if not is_traced((model, gel, loads)):
        return find(model, gel, loads)
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    search = _Search(name, find)
    leaves, structure = jax.tree.flatten((model, gel, loads))
    values = _located(search, structure, leaves)
    return [dataclasses.replace(point, mu=value) for point, value in zip(search.points, values, strict=True)]


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    """What a traced search looks for, and the points it found: its result, but for mu, is on the host. Hashed by identity."""

    name: str
    find: Callable
    points: list = dataclasses.field(default_factory=list)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _located(search, structure, leaves):
    """Critical mu (k,)."""
    if is_traced(leaves):
        raise ValueError(f"{search.name}: is not available inside jit or vmap")
    search.points[:] = search.find(*jax.tree.unflatten(structure, leaves))
    return jnp.array([point.mu for point in search.points])


@_located.defjvp
def _located_jvp(search, structure, primals, tangents):
    mu = first_order_only(_located(search, structure, *primals), search.name)
    inputs, dots = jax.tree.unflatten(structure, primals[0]), jax.tree.unflatten(structure, tangents[0])
    found = [_onset_tangent(p.x, p.modes, p.correction, p.mu, inputs, dots, fold=p.kind == "fold") for p in search.points]
    return mu, jnp.stack(found) if found else jnp.zeros(0)


@functools.partial(jax.jit, static_argnames="fold")
def _onset_tangent(x, modes, correction, mu, inputs, dots, *, fold):
    """Tangent () of a critical mu: -(dPhi . dots) / (dPhi/dmu) at fixed x, v, w; constrained nodes move with the dry plate."""
    topology = inputs[0].lists.topology
    free = free_dofs(topology)

    def onset(model, gel, loads, mu):
        nodes = model.cloud.nodes
        at = x + prescribed_motion(nodes - jax.lax.stop_gradient(nodes), topology.plate, free)
        r = residual(at, model, gel, mu, loads)
        if fold:
            return jnp.sum(modes[0] * r)
        return sum(curvature(at, v, model, gel, mu, loads) for v in modes) - jnp.sum(correction * r)

    _, change = jax.jvp(lambda *inputs: onset(*inputs, mu), inputs, dots)
    return -change / jax.grad(onset, argnums=3)(*inputs, mu)
