"""One stage of a time step: Newton's method about positions, pressures and the chemical potential.

A stage of length tau takes up what has moved since volume ratios J_old,

    force      loads - network' - G p = 0,                                     p_g = dphi_g/dJ - mu_g,  mu = P m
    solvent    P^T [ V (J - J_old) + tau (A mu - layer) ] = 0

with A the flow and layer that of thin layers, see ``mechanics.solvent_flow``. Every p is feasible, and is linearised as in
``mechanics.mixed``. With the pressures eliminated a step solves

    [ K          -B^T            ] [dx]     [forces      ]
    [ -B - tau X -tau (A + A_M)  ] [dm]  =  [the balance ]

where X and A_M come from the mobility, which changes with the state. Without them the matrix is symmetric and quasi-definite; its factor
preconditions GMRES.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from .._programs import program
from .._types import Array, Float
from ..equilibrium import NEWTON, Newton, Status, of_iterate
from ..linalg import SingularTangent, factor
from ..mechanics import (
    Bath,
    Carried,
    Linearisation,
    Problem,
    all_volumes,
    along_sides,
    carried,
    condensed_rhs,
    flow,
    flow_change,
    in_wet_groups,
    layer_flow,
    linearise,
    moments,
    place_matrices,
    places,
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
SLOW = 1e-3  # a correction that leaves more than this of the error makes a new factor worth its cost
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
    linearisation: Linearisation | None = None
    """The mixed form about the iterate."""


def solve_stage(transport: Transport, start: Stage, old: Float[Array, " g"], tau: float, bath: Bath, *, newton: Newton = NEWTON) -> Stage:
    """The `Stage` of length ``tau`` from the volume ratios ``old`` (g,), with the ``bath`` at its end, from the iterate ``start``."""
    x, p, m, made, before, iterations = start.x, start.pressure, start.m, None, np.inf, 0
    while True:
        acting = acting_problem(transport, m)
        now = linearise(acting, x, p, acting_potential(transport, m))
        missing, J, inflow, rates = _balance(transport, x, p, m, old, tau, bath)
        missing, J, inflow = map(np.asarray, (missing, J, inflow))
        residual, violation = float(now.residual_norm), float(now.violation)
        balance = float(np.abs(missing).max() / solvent_in(transport, J))
        error = max(residual / newton.tolerance, violation / newton.constraint_tolerance, balance / BALANCE)
        status = of_iterate(error, error < 1, iterations >= newton.max_iterations)
        found = Stage(x, p, m, J, Status.NOT_CONVERGED if status is None else status, iterations, residual, balance, inflow, now)
        if status is not None:
            return found
        try:
            if made is None or error > SLOW * before:
                made, at = _factorised(transport, acting, now, x, p, tau, rates), now
        except SingularTangent:
            return dataclasses.replace(found, status=Status.SINGULAR)
        rhs = np.concatenate([np.asarray(condensed_rhs(acting, now, at)), missing[transport.saddle.groups]])
        dx, dm = _correction(transport, made, rhs, x, tau, now, rates)
        x, p, m = _stepped(transport, x, p, m, dx, dm, now, at)
        before, iterations = error, iterations + 1


def acting_potential(transport: Transport, m: Float[Array, " g"]) -> Float[np.ndarray, " g"]:
    """Mu (g,) of the volume groups, kT."""
    return np.asarray(_potentials(transport, m))


def acting_problem(transport: Transport, m: Float[Array, " g"]) -> Problem:
    """The problem of equilibrium at this chemical potential."""
    return transport.problem.at(acting_potential(transport, m))[0]


def _correction(transport, made, rhs, x, tau, now, rates):
    """Changes (f,) and (g,) of the unknowns by GMRES."""
    f, groups = len(transport.problem.free), transport.saddle.groups
    own, inner = np.zeros(len(transport.model.carries)), made.matrix[f:, f:]

    def product(v):
        whole = own.copy()
        whole[groups] = v[f:]
        more = np.asarray(_flow_change(transport, x, tau, now, rates, v[:f], whole))
        result = made.product(v)
        result[f:] -= more[groups] + inner @ v[f:]
        return result

    operator = LinearOperator((len(rhs), len(rhs)), matvec=product, dtype=float)
    precond = LinearOperator((len(rhs), len(rhs)), matvec=made.apply, dtype=float)
    scaled, _ = gmres(operator, rhs, M=precond, rtol=GMRES, atol=0.0, restart=MAX_ITERATIONS, maxiter=1)
    own[groups] = scaled[f:]
    return scaled[:f], own


def _factorised(transport, acting, now, x, p, tau, rates):
    """Factor of the symmetric part."""
    saddle = transport.saddle
    K = tangent(acting, x, p, now)
    A, diagonal = map(np.asarray, _flow_matrix(transport, x, tau, rates, saddle.slots, np.zeros(saddle.room)))
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


class Rates(NamedTuple):
    """How the flow changes with the state, in the sizes of the ``shared`` form."""

    carried: Carried
    """By mu and pressures."""
    layer: Float[Array, " e"]
    """That of thin layers by the mu of their groups."""
    layer_by_square: Float[Array, " e"]
    """By the square of the stretch along the surface."""


@program(x="n", p="g", m="g", old="g", returns=("g", "g", None, None))
def _balance(problem, x, p, m, old, tau, bath):
    """What the unknowns of mu miss in the balance of solvent (g,), the volume ratios (g,), the inflow (b,) of each part, and `Rates`."""
    equations, solvent, D = problem.problem, problem.solvent, problem.D
    model, wet, mu = equations.model, solvent.wetting, potentials(m, equations.model)
    J, square = volume_ratios(x, model), along_sides(x, model, solvent)
    moving = carried(p, places(m, bath.mu, model, solvent), model, equations.gel, solvent)
    leaving = flow(x, moving, model, solvent, D)

    def layer(square, mu):
        return layer_flow(square, mu, model, equations.gel, solvent, bath, D)

    at = square, in_wet_groups(mu, solvent, -1.0)
    brought, by_mu = jax.jvp(lambda mu: layer(at[0], mu), at[1:], (jnp.ones_like(square),))
    by_square = jax.jvp(lambda square: layer(square, at[1]), at[:1], (jnp.ones_like(square),))[1]
    of_groups = leaving[: len(J)].at[wet.groups].add(-brought, mode="drop")
    kept = jnp.where(model.carries, all_volumes(model) * (J - old), 0.0)
    inflow = jnp.zeros_like(bath.mu).at[wet.node_parts].add(leaving[len(J) :]).at[wet.group_parts].add(brought)
    missing = moments(kept + tau * jnp.where(model.carries, of_groups, 0.0), model)
    return missing, J, inflow, Rates(moving, by_mu, by_square)


@program(J="g")
def solvent_in(problem: Transport, J: Float[Array, " g"]) -> Float[Array, ""]:
    """Solvent in the gel, mm^2, at the volume ratios ``J`` (g,)."""
    model = problem.model
    return jnp.sum(jnp.where(model.carries, all_volumes(model) * (J - 1), 0.0))


@program(x="n", returns=(None, "g"))
def _flow_matrix(problem, x, tau, rates, slots, zeros):
    """Upper entries of tau A by pairs of places, and its diagonal (g,) for thin layers."""
    solvent, model = problem.solvent, problem.model
    A = place_matrices(zeros, x, rates.carried, model, solvent, problem.D, slots)
    diagonal = jnp.zeros(len(model.carries)).at[solvent.wetting.groups].add(jnp.maximum(-rates.layer, 0.0), mode="drop")
    return tau * A, tau * diagonal


@program(x="n", dx="f", dm="g", returns="g")
def _flow_change(problem, x, tau, now, rates, dx, dm):
    """Change of the solvent (g,) that leaves in the time ``tau``, if the unknowns change by ``dx`` and ``dm``."""
    solvent, model = problem.solvent, problem.model
    field, mu = scatter(dx, problem.problem.free), potentials(dm, model)
    dp = pressure_change(field, now, model) - jnp.where(model.carries, mu, 0.0)
    dmu = places(dm, jnp.zeros(1), model, solvent)
    change = flow_change(x, field, dp, dmu, rates.carried, model, solvent, problem.D)[: len(dm)]
    square = jax.jvp(lambda x: along_sides(x, model, solvent), (x,), (field,))[1]
    layer = rates.layer * in_wet_groups(mu, solvent, 0.0) + rates.layer_by_square * square
    change = change.at[solvent.wetting.groups].add(-layer, mode="drop")
    return tau * moments(jnp.where(model.carries, change, 0.0), model)


@program(x="n", p="g", m="g", dx="f", dm="g", returns=("n", "g", "g"))
def _stepped(problem, x, p, m, dx, dm, now, at):
    """Positions, pressures and unknowns of mu after a correction."""
    equations = problem.problem
    field = scatter(dx, equations.free)
    change = jnp.where(equations.model.carries, potentials(dm, equations.model), 0.0)
    return x + field, p + pressure_step(field, now, at, equations.model) - change, m + dm
