"""One stage of a time step: Newton's method about positions, pressures and the chemical potential.

A stage of length tau takes up what has moved since volume ratios J_old,

    force      loads - network' - G p = 0,   p_g = l3 (dphi_g/dJ - mu_g),  mu = P m
    solvent    P^T V (J - J_old) + tau S P^T (A mu - layer) = 0

where J is l3 times the areal stretch, with the axial stretch l3, A is the flow, layer that of thin
layers, and S its share, see ``mechanics.solvent_flow``. Every p is feasible, and is linearised as
in ``mechanics.mixed``. With the pressures eliminated a step solves

    [ K            -B^T             ] [dx]     [forces      ]
    [ -B - tau S X -tau S (A + A_M) ] [dm]  =  [the balance ]

where X and A_M come from the mobility, which changes with the state. Without these and S the matrix
is symmetric and quasi-definite; its factor preconditions GMRES.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._types import Array, Float, Scalar
from ..equilibrium import Newton, Status, of_iterate
from ..linalg import SingularTangent
from ..mechanics import (
    Bath,
    Carried,
    Flow,
    Linearisation,
    Problem,
    all_volumes,
    along_sides,
    axial_stretch,
    carried,
    condensed_rhs,
    flow,
    in_wet_groups,
    layer_flow,
    linear_share,
    linearise,
    moments,
    places,
    potentials,
    pressure_step,
    scatter,
)
from .problem import Transport
from .tangent import FlowChange, Rates, Tangent, factorised

BALANCE = 1e-12  # largest error of the balance of the solvent, over the solvent in the gel
# times as much all errors together: a step adds 2.4 times that of its first stage, 1e-11 in all
WHOLE = 2.9
# correction of mu, over its size, after which the balance is as good as it gets: of a long stage
# less than BALANCE
ROUND_OFF = 1e-13
# of the right-hand side, left by the iterations of one correction; its products cost little beside
# another correction
GMRES = 1e-6
# by which a correction may change mu, kT: in a gel that is nearly dry it is a logarithm of J - 1
LONGEST = 1.5
# error over its tolerance that the matrix of the last correction may be expected to leave: about
# error^2 / error before
EXPECTED = 0.1


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

    @property
    def light(self) -> "Stage":
        """The stage without its linearisation, which is large."""
        return dataclasses.replace(self, linearisation=None)


def solve_stage(
    transport: Transport,
    start: Stage,
    old: Float[Array, " g"],
    tau: float,
    bath: Bath,
    *,
    newton: Newton,
    iterated: Callable[[Stage], object],
) -> Stage:
    """The `Stage` of length ``tau`` from volume ratios ``old`` (g,), ``bath`` and ``start``.

    The bath is that at its end, the start an iterate. ``iterated`` is called with each iterate.
    """
    x, p, m, matrix, before, iterations = start.x, start.pressure, start.m, None, np.inf, 0
    f, moved = len(transport.problem.free), np.inf
    while True:
        mu = acting_potential(transport, m)
        acting = transport.problem.at(mu)[0]
        now = linearise(acting, x, p, mu)
        J = np.asarray(now.ratios)[: len(old)]
        missing, inflow, rates = balance_and_rates(transport, x, p, m, J - old, tau, bath)
        missing, inflow = map(np.asarray, (missing, inflow))
        residual, violation = float(now.residual_norm), float(now.violation)
        whole = sum(
            missing[transport.saddle.groups[means]].sum() for means in transport.saddle.means
        )
        balance = float(max(np.abs(missing).max(), abs(whole) / WHOLE) / solvent_in(transport, J))
        error = max(
            residual / newton.tolerance,
            violation / newton.constraint_tolerance,
            (balance / BALANCE) * (moved > ROUND_OFF),
        )
        status = of_iterate(error, error < 1, iterations >= newton.max_iterations)
        found = Stage(
            x,
            p,
            m,
            J,
            Status.NOT_CONVERGED if status is None else status,
            iterations,
            residual,
            balance,
            inflow,
            now,
        )
        iterated(found)
        if status is not None:
            return found
        try:
            if matrix is None or error**2 > EXPECTED * before:
                matrix, change = None, FlowChange.of(transport, tau, now, rates)
                matrix, at = Tangent(factorised(transport, acting, now, x, p, change), change), now
        except SingularTangent:
            return dataclasses.replace(found, status=Status.SINGULAR)
        rhs = np.concatenate(
            [np.asarray(condensed_rhs(acting, now, at)), missing[transport.saddle.groups]]
        )
        change = matrix.solve(rhs, GMRES)
        dm = np.zeros(len(m))
        dm[transport.saddle.groups] = change[f:]
        most = np.abs(dm).max()
        share = LONGEST / max(most, LONGEST)
        x, p, m = _stepped(transport, x, p, m, share, change[:f], dm, now, at)
        before, iterations, moved = error, iterations + 1, most / (1 + np.abs(np.asarray(m)).max())


def acting_potential(transport: Transport, m: Float[Array, " g"]) -> Float[np.ndarray, " g"]:
    """Mu (g,) of the volume groups, kT."""
    return np.asarray(_potentials(transport, m))


def acting_problem(transport: Transport, m: Float[Array, " g"]) -> Problem:
    """The problem of equilibrium at this chemical potential."""
    return transport.problem.at(acting_potential(transport, m))[0]


@program(m="g", returns="g")
def _potentials(problem, m):
    return potentials(m, problem.model)


class Balance(NamedTuple):
    """The balance of the solvent in a stage; a pytree."""

    missing: Float[Array, " g"]
    """What the unknowns of mu miss, mm^2."""
    inflow: Float[Array, " b"]
    """What comes in through each wetted part, mm^2 per unit of time."""
    carried: Carried
    """What mu moves."""
    flow: Flow
    """How it flows."""


def balance(
    transport: Transport,
    x: Float[Array, "n 2"],
    p: Float[Array, " g"],
    m: Float[Array, " g"],
    growth: Float[Array, " g"],
    tau: Scalar,
    bath: Bath,
    *,
    rates: bool = False,
    reverse: bool = False,
) -> Balance:
    """`Balance` of a stage of length ``tau`` in which the volume ratios grow by ``growth`` (g,).

    Of transport in its ``shared`` form; ``rates`` and ``reverse`` as of ``mechanics.flow``.
    """
    equations, solvent, D = transport.problem, transport.solvent, transport.D
    model, wet, mu = equations.model, solvent.wetting, potentials(m, equations.model)
    moving = carried(
        p, places(m, bath.mu, model, solvent), model, equations.gel, solvent, reverse=reverse
    )
    flowing = flow(x, moving, model, solvent, D, rates=rates, reverse=reverse)
    leaving, count = flowing.leaving, len(model.carries)
    brought = layer_flow(
        along_sides(flowing.squares, model, solvent),
        in_wet_groups(mu, solvent, -1.0),
        model,
        equations.gel,
        solvent,
        bath,
        D,
    )
    of_groups = leaving[:count].at[wet.groups].add(-brought, mode="drop")
    kept = jnp.where(model.carries, all_volumes(model) * axial_stretch(model) * growth, 0.0)
    inflow = (
        jnp.zeros_like(bath.mu)
        .at[wet.node_parts]
        .add(leaving[count:])
        .at[wet.group_parts]
        .add(brought)
    )
    going = linear_share(model, solvent, bath, D) * moments(
        jnp.where(model.carries, of_groups, 0.0), model
    )
    return Balance(moments(kept, model) + tau * going, inflow, moving, flowing)


@program(x="n", p="g", m="g", growth="g", returns=("g", None, None))
def balance_and_rates(
    problem: Transport,
    x: Float[Array, "n 2"],
    p: Float[Array, " g"],
    m: Float[Array, " g"],
    growth: Float[Array, " g"],
    tau: Scalar,
    bath: Bath,
) -> tuple[Float[Array, " g"], Float[Array, " b"], Rates]:
    """What is missing in the `Balance`, the inflow, and the `Rates` of the flow."""
    equations, solvent = problem.problem, problem.solvent
    found, model = balance(problem, x, p, m, growth, tau, bath, rates=True), equations.model

    def layer(square, mu):
        return layer_flow(square, mu, model, equations.gel, solvent, bath, problem.D)

    square, mu = (
        along_sides(found.flow.squares, model, solvent),
        in_wet_groups(potentials(m, model), solvent, -1.0),
    )
    by_mu = jax.jvp(lambda mu: layer(square, mu), (mu,), (jnp.ones_like(square),))[1]
    by_square = jax.jvp(lambda square: layer(square, mu), (square,), (jnp.ones_like(square),))[1]
    share = linear_share(model, solvent, bath, problem.D)
    rates = Rates(found.carried.slopes, found.flow.rates, by_mu, by_square, share)
    return found.missing, found.inflow, rates


@program(J="g")
def solvent_in(problem: Transport, J: Float[Array, " g"]) -> Float[Array, ""]:
    """Solvent in the gel, mm^2, at the volume ratios ``J`` (g,)."""
    model = problem.model
    return jnp.sum(
        jnp.where(model.carries, all_volumes(model) * (axial_stretch(model) * J - 1), 0.0)
    )


@program(x="n", p="g", m="g", dx="f", dm="g", returns=("n", "g", "g"))
def _stepped(problem, x, p, m, share, dx, dm, now, at):
    """Positions, pressures and unknowns of mu after a ``share`` of a correction."""
    equations = problem.problem
    field = scatter(dx, equations.free)
    change = axial_stretch(equations.model) * jnp.where(
        equations.model.carries, potentials(dm, equations.model), 0.0
    )
    dp = pressure_step(field, now, at, equations.model) - change
    return x + share * field, p + share * dp, m + share * dm
