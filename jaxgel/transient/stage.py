"""One stage of a time step: Newton's method about positions, pressures and the chemical potential.

A stage of length tau takes up what has moved since volume ratios J_old,

    force      loads - network' - G p = 0,                                     p_g = dphi_g/dJ - mu_g,  mu = P m
    solvent    P^T [ V (J - J_old) + tau (A mu - layer) ] = 0

with A the flow and layer that of thin layers, see ``mechanics.flow``. Every p is feasible, and is linearised as in ``mechanics.mixed``. With
the pressures eliminated a step solves

    [ K          -B^T            ] [dx]     [forces      ]
    [ -B - tau X -tau (A + A_M)  ] [dm]  =  [the balance ]

where X and A_M come from the mobility, which changes with the state. Without them the matrix is symmetric and quasi-definite; its factor
preconditions GMRES.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, gmres

from .._programs import program
from .._types import Array, Float, Scalar
from ..equilibrium import NEWTON, Newton, Status
from ..linalg import Factor, SingularTangent, factor
from ..mechanics import (
    Bath,
    Linearisation,
    all_volumes,
    condensed_rhs,
    flow,
    layer_conductance,
    layer_flow,
    linearise,
    moments,
    place_matrices,
    potentials,
    pressure_change,
    pressure_step,
    scatter,
    tangent,
    volume_ratios,
)
from .problem import Transport

BALANCE = 1e-12  # largest error of the balance of the solvent, over the solvent in the gel
GMRES = 1e-3  # of the right-hand side, left by the iterations of one correction
SLOW = 0.1  # a correction that leaves more than this of the error makes a new factor worth its cost
MAX_ITERATIONS = 40  # of GMRES


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """An iterate of a stage, converged or not."""

    x: Float[Array, "n 2"]
    """Positions, mm."""
    pressure: Float[Array, " g"]
    """Pressures of the volume groups, kT/v."""
    m: Float[Array, " g"]
    """Unknowns of mu, kT, see ``mechanics.solvent``."""
    ratios: Float[Array, " g"]
    """Volume ratios of the groups."""
    status: Status = Status.NOT_CONVERGED
    """How the iteration ended."""
    iterations: int = 0
    """Corrections."""
    residual: float = float("nan")
    """Relative residual of the forces."""
    balance: float = float("nan")
    """Error of the balance of the solvent over the solvent in the gel."""
    inflow: Float[Array, " b"] | None = None
    """Solvent that comes in through each wetted part, mm^2 per unit of time."""
    factor: Factor | None = None
    """The last factor."""


def solve_stage(
    transport: Transport, start: Stage, old: Float[Array, " g"], tau: float, bath: Bath, *, newton: Newton = NEWTON
) -> Stage:
    """The `Stage` of length ``tau`` from the volume ratios ``old`` (g,), with the ``bath`` at its end, from the iterate ``start``."""
    x, p, m = start.x, start.pressure, start.m
    pattern, made, before = transport.saddle, None, np.inf
    for iterations in range(newton.max_iterations + 1):
        mu = np.asarray(_potentials(transport, m))
        acting, _ = transport.problem.at(mu)
        now = linearise(acting, x, p, mu)
        r, J, inflow = map(np.asarray, _balance(transport, x, p, m, old, tau, bath))
        solvent = _solvent(transport, J)
        residual, violation = float(now.residual_norm), float(now.violation)
        balance = float(np.abs(r).max() / solvent)
        error = max(residual / newton.tolerance, violation / newton.constraint_tolerance, balance / BALANCE)
        found = Stage(x, p, m, J, Status.NOT_CONVERGED, iterations, residual, balance, inflow, made)
        if not np.isfinite(error):
            return dataclasses.replace(found, status=Status.DIVERGED if hasattr(Status, "DIVERGED") else Status.NOT_CONVERGED)
        if error < 1:
            return dataclasses.replace(found, status=Status.CONVERGED)
        if iterations == newton.max_iterations:
            return found
        if made is None or error > SLOW * before:
            try:
                made, at = _factorised(transport, acting, now, x, p, m, tau, bath), now
            except SingularTangent:
                return dataclasses.replace(found, status=Status.SINGULAR)
        before = error
        rhs = np.concatenate([np.asarray(condensed_rhs(acting, now, at)), r[pattern.groups]])
        dx, dm = _correction(transport, made, rhs, x, p, m, tau, bath, now)
        x, p, m = _stepped(transport, x, p, m, dx, dm, now, at)
    raise AssertionError


def _correction(transport, made, rhs, x, p, m, tau, bath, now):
    """Changes (f,) and (g,) of the unknowns by GMRES."""
    f, groups = len(transport.problem.free), transport.saddle.groups
    own, inner = np.zeros(len(m)), made.matrix[f:, f:]

    def product(v):
        whole = own.copy()
        whole[groups] = v[f:]
        more = np.asarray(_flow_change(transport, x, p, m, tau, bath, now, v[:f], whole))
        result = made.product(v)
        result[f:] -= more[groups] + inner @ v[f:]
        return result

    operator = LinearOperator((len(rhs), len(rhs)), matvec=product, dtype=float)
    precond = LinearOperator((len(rhs), len(rhs)), matvec=made.apply, dtype=float)
    scaled, _ = gmres(operator, rhs, M=precond, rtol=GMRES, atol=0.0, restart=MAX_ITERATIONS, maxiter=1)
    own[groups] = scaled[f:]
    return scaled[:f], own


def _factorised(transport, acting, now, x, p, m, tau, bath):
    """Factor of the symmetric part."""
    saddle = transport.saddle
    K = tangent(acting, x, p, now)
    A, diagonal = map(np.asarray, _flow_matrix(transport, x, p, m, tau, bath, saddle.slots, np.zeros(saddle.room)))
    A = A[: len(saddle.pairs)].copy()
    same = saddle.pairs[:, 0] == saddle.pairs[:, 1]
    A[same] += diagonal[saddle.pairs[same, 0]]
    B = []
    for G, real, block in zip(now.gradients, saddle.real, transport.model.blocks, strict=True):
        c, a = real.shape
        part = np.asarray(G)[:c, : block.carrying, :, :a]  # (c, g, 2, a)
        B.append(part.swapaxes(2, 3)[np.broadcast_to(real[:, None], (c, block.carrying, a))])
    B = np.concatenate(B)
    pairs = np.zeros((len(K) + len(B) + len(A), 2, 2))
    pairs[: len(K)] = K
    pairs[len(K) : len(K) + len(B), :, 0] = -B
    pairs[len(K) + len(B) :, 0, 0] = -A
    return factor(saddle.pattern, pairs)


@program(m="g", returns="g")
def _potentials(problem, m):
    return potentials(m, problem.model)


@program(x="n", p="g", m="g", old="g", returns=("g", "g", None))
def _balance(problem, x, p, m, old, tau, bath):
    """What the unknowns of mu miss in the balance of solvent (g,), the volume ratios (g,), and the inflow (b,) of each part."""
    equations, solvent, D = problem.problem, problem.solvent, problem.D
    model, wet = equations.model, solvent.wetting
    J = volume_ratios(x, model)
    leaving = flow(x, p, m, model, equations.gel, solvent, bath, D)
    layer = layer_flow(x, m, model, equations.gel, solvent, bath, D)
    of_groups = leaving[: len(J)].at[wet.groups].add(-layer, mode="drop")
    kept = jnp.where(model.carries, all_volumes(model) * (J - old), 0.0)
    inflow = jnp.zeros_like(bath.mu).at[wet.node_parts].add(leaving[len(J) :]).at[wet.group_parts].add(layer)
    return moments(kept + tau * jnp.where(model.carries, of_groups, 0.0), model), J, inflow


@program(J="g")
def _solvent_in(problem, J):
    model = problem.model
    return jnp.sum(jnp.where(model.carries, all_volumes(model) * (J - 1), 0.0))


def _solvent(transport, J):
    return float(_solvent_in(transport, J))


@program(x="n", p="g", m="g", returns=(None, "g"))
def _flow_matrix(problem, x, p, m, tau, bath, slots, zeros):
    """Upper entries of tau A by pairs of places, and its diagonal (g,) for thin layers."""
    equations, solvent, D = problem.problem, problem.solvent, problem.D
    model, gel = equations.model, equations.gel
    A = place_matrices(zeros, x, p, m, model, gel, solvent, bath, D, slots)
    layer = layer_flow(x, m, model, gel, solvent, bath, D)
    return tau * A, tau * layer_conductance(layer, m, model, solvent, bath)


@program(x="n", p="g", m="g", dx="f", dm="g", returns="g")
def _flow_change(problem, x, p, m, tau, bath, now, dx, dm):
    """Change of the solvent (g,) that leaves in the time ``tau``, if the unknowns change by ``dx`` and ``dm``."""
    equations, solvent, D = problem.problem, problem.solvent, problem.D
    model, gel, wet = equations.model, equations.gel, solvent.wetting
    field = scatter(dx, equations.free)
    dp = pressure_change(field, now, model) - jnp.where(model.carries, potentials(dm, model), 0.0)

    def leaving(x, p, m):
        groups = flow(x, p, m, model, gel, solvent, bath, D)[: len(m)]
        return groups.at[wet.groups].add(-layer_flow(x, m, model, gel, solvent, bath, D), mode="drop")

    change = jax.jvp(leaving, (x, p, m), (field, dp, dm))[1]
    return tau * moments(jnp.where(model.carries, change, 0.0), model)


@program(x="n", p="g", m="g", dx="f", dm="g", returns=("n", "g", "g"))
def _stepped(problem, x, p, m, dx, dm, now, at):
    """Positions, pressures and unknowns of mu after a correction."""
    equations = problem.problem
    field = scatter(dx, equations.free)
    change = jnp.where(equations.model.carries, potentials(dm, equations.model), 0.0)
    return x + field, p + pressure_step(field, now, at, equations.model) - change, m + dm
