"""Derivatives of marched states with respect to all that they depend on.

The times of the steps are held. Every stage s satisfies r_s(x_s, m_s; J of the stages that it began
from, everything else) = 0, the forces and the balance of the solvent of `stage`. Differentiated,

    T_s (dx_s, dm_s) = dr_s at fixed x_s and m_s - (0, sum of c_k B_k dx_k over the stages k that it
    began from)

with the matrix T_s of a Newton step, which is no approximation here, and B dx = P^T V dJ. So
tangents march forwards in time and cotangents backwards, with one factor per stage, that of the
symmetric part, and GMRES.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiled import tangents as tangents_of
from .._primitives import primitive
from .._programs import fitted
from .._sizes import padded, rung
from .._threads import few_threads
from .._types import Array, Float, Int
from ..equilibrium import Motions, moved
from ..linalg import SingularTangent
from ..mechanics import (
    Bath,
    gather,
    linearise,
    potentials,
    pressure_at,
    residual,
    total_energy,
    volume_ratios,
)
from .march import GAMMA, Step
from .problem import Transport
from .stage import Stage, acting_potential, acting_problem, balance, balance_and_rates
from .tangent import FlowChange, Tangent, factorised

ACCURATE = 1e-12  # of the right-hand side, left by GMRES
POOR = 1e-7  # of the right-hand side: what no solution leaves


class Stages(NamedTuple):
    """The state that a run started from, number 0, and the S stages after it; a pytree."""

    x: Float[Array, "S+1 n 2"]
    """Positions, mm."""
    pressure: Float[Array, "S+1 g"]
    """Pressures, kT/v."""
    m: Float[Array, "S+1 g"]
    """Unknowns of mu, kT."""
    end: Int[Array, " S"]
    """Number of the state at the beginning of each stage's step."""
    first: Int[Array, " S"]
    """Of a second stage that of the first one; of a first one the same as ``end``."""
    tau: Float[Array, " S"]
    """Lengths."""
    bath: Bath
    """The bath (S, b) at their ends."""

    @property
    def shares(self) -> Float[Array, " S"]:
        """Of the change of J from ``end`` to ``first`` with which each stage begins."""
        return (self.first != self.end) * ((1 - GAMMA) / GAMMA)

    def shared(self, lengths: dict[str, int]) -> "Stages":
        """The same in the sizes of a shared form, with room for more stages: the last one again."""
        rows = rung(len(self.tau), 4)
        own = {"x": "kn", "pressure": "kg", "m": "kg"}
        states = {
            name: padded(fitted(getattr(self, name), axes, lengths), rows + 1)
            for name, axes in own.items()
        }
        bath = Bath(*(padded(values, rows) for values in self.bath))
        return self._replace(
            **states,
            bath=bath,
            **{name: padded(getattr(self, name), rows) for name in ("end", "first", "tau")},
        )


def stages_of(first: Stage, steps: Sequence[Step], tau: Float[Array, " S"], bath: Bath) -> Stages:
    """`Stages` of a run from the ``first`` state, of lengths ``tau`` and ``bath`` (S, b)."""
    states = [first, *(stage for step in steps for stage in (step.first, step.second))]
    columns = (
        np.stack([getattr(state, name) for state in states]) for name in ("x", "pressure", "m")
    )
    number = np.arange(0, 2 * len(steps), 2)
    return Stages(
        *columns, np.repeat(number, 2), np.stack([number, number + 1], axis=1).ravel(), tau, bath
    )


class Observed(NamedTuple):
    """What a path has of the states of a run."""

    x: Float[Array, "S+1 n 2"]
    """Positions, mm."""
    energy: Float[Array, " S+1"]
    """Total energies, kT/v mm^2."""
    pressure: Float[Array, "S+1 g"]
    """Pressures, kT/v."""
    potential: Float[Array, "S+1 g"]
    """Chemical potentials of the groups, kT."""
    supplied: Float[Array, "S+1 b"]
    """Solvent that has come in, mm^2; at the ends of steps."""


def stage_tangents(
    march: "March", dots: Stages, transport: Transport, transport_dot: Transport
) -> Observed:
    """Tangents of what is `Observed` at the stages of a `March`, in the sizes of their shared form.

    They are those for tangents of the transport in its shared form, and ``dots`` of the stages: of
    the state at the start, of lengths and bath, 0 for what is solved for.
    """
    stages = march.stages.shared(transport.lengths)
    leaves, structure = jax.tree.flatten((stages, transport))
    (rows, g), shapes = (
        march.shapes[1],
        [jax.ShapeDtypeStruct(shape, float) for shape in (stages.x.shape, *march.shapes)],
    )
    motion, forces, missing = tangents_of(
        _Residuals(structure), leaves, _moving((dots, transport_dot)), shapes
    )
    dx, dm = marched.bind(forces, missing, march=march, transposed=False)
    x_dot = jnp.concatenate([motion[:1], moved(motion[1:], dx, transport.problem.free)])
    dots = dots._replace(x=x_dot, m=jnp.concatenate([dots.m[:1], dm]))
    parts = len(stages.bath.mu[0])
    shapes = [
        jax.ShapeDtypeStruct((rows + 1, *shape), float) for shape in ((), (g,), (g,), (parts,))
    ]
    return Observed(
        x_dot, *tangents_of(_OfStages(structure), leaves, _moving((dots, transport_dot)), shapes)
    )


def _moving(dots):
    """The tangents of a tree's leaves; None for what has none."""
    return [None if dot.dtype == jax.dtypes.float0 else dot for dot in jax.tree.leaves(dots)]


@dataclasses.dataclass(frozen=True)
class _Residuals:
    """Positions (S+1, n, 2), forces (S, f) and missing solvent (S, g) of all stages.

    They depend on the leaves of (`Stages`, `Transport`). The positions move with the nodes of the
    dry plate as ``equilibrium.Motions`` says.
    """

    structure: object
    """Tree structure of the leaves."""

    def __call__(self, *leaves):
        stages, transport = jax.tree.unflatten(self.structure, leaves)
        problem, model = transport.problem, transport.model
        own = lax.stop_gradient(stages.x[1:])
        motion = Motions(problem)(
            own, jnp.zeros(len(own)), model.nodes - lax.stop_gradient(model.nodes)
        )
        x = jnp.concatenate([stages.x[:1], stages.x[1:] + motion])

        def of_stage(stage):
            x, begun, other, p, m, share, tau, bath = stage
            mu, J = potentials(m, model), volume_ratios(begun, model)
            forces = -gather(residual(x, model, problem.gel, mu, problem.loads, p), problem.free)
            old = J + share * (volume_ratios(other, model) - J)
            now = volume_ratios(x, model)
            p = pressure_at(now, model, problem.gel, mu)
            found = balance(transport, x, p, m, now - old, tau, bath, reverse=True)
            return forces, found.missing

        columns = (
            x[1:],
            x[stages.end],
            x[stages.first],
            stages.pressure[1:],
            stages.m[1:],
            stages.shares,
            stages.tau,
            stages.bath,
        )
        return [x, *lax.map(jax.checkpoint(of_stage), columns)]


@dataclasses.dataclass(frozen=True)
class _OfStages:
    """Energy, pressures, potentials and solvent supplied, see `Observed`, of the same leaves."""

    structure: object
    """Tree structure of the leaves."""

    def __call__(self, *leaves):
        stages, transport = jax.tree.unflatten(self.structure, leaves)
        problem, model = transport.problem, transport.model

        def of_state(state):
            x, m = state
            mu, J = potentials(m, model), volume_ratios(x, model)
            return (
                total_energy(x, model, problem.gel, mu, problem.loads),
                pressure_at(J, model, problem.gel, mu),
                mu,
            )

        def inflow(stage):
            x, p, m, tau, bath = stage
            return balance(transport, x, p, m, jnp.zeros(p.shape), tau, bath, reverse=True).inflow

        energy, pressure, potential = lax.map(jax.checkpoint(of_state), (stages.x, stages.m))
        rates = lax.map(
            jax.checkpoint(inflow),
            (stages.x[1:], pressure[1:], stages.m[1:], stages.tau, stages.bath),
        )
        weights = jnp.where(stages.first == stages.end, (1 - GAMMA) / GAMMA, 1.0) * stages.tau
        supplied = jnp.cumsum(weights[:, None] * rates, axis=0)
        return [
            energy,
            pressure,
            potential,
            jnp.concatenate([jnp.zeros((1, rates.shape[1])), supplied]),
        ]


# --- marching -------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class March:
    """A run that was made, numbers; hashed by identity."""

    transport: Transport
    """What it solved."""
    stages: Stages
    """Its stages."""

    @property
    def shapes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Those (S, f) and (S, g) of the right-hand sides, in the sizes of the shared form."""
        rows, lengths = rung(len(self.stages.tau), 4), self.transport.shared.lengths
        return (rows, lengths["f"]), (rows, lengths["g"])

    def forwards(
        self, forces: Float[np.ndarray, "S f"], missing: Float[np.ndarray, "S u"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes (S, f) and (S, u) of the unknowns for these right-hand sides of the stages."""
        dx, dm, stages = np.zeros(forces.shape), np.zeros(missing.shape), self.stages
        taken = np.zeros((len(missing) + 1, missing.shape[1]))
        for s, share in enumerate(stages.shares):
            end, first = taken[stages.end[s]], taken[stages.first[s]]
            rhs = np.concatenate([forces[s], missing[s] - end - share * (first - end)])
            if np.any(rhs):
                T = self._tangent(s)
                solution = _solved(T, rhs)
                dx[s], dm[s] = np.split(solution, [len(dx[s])])
                taken[s + 1] = T.taken_up(dx[s])
        return dx, dm

    def backwards(
        self, dx: Float[np.ndarray, "S f"], dm: Float[np.ndarray, "S u"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """The transpose of `forwards`."""
        forces, missing, stages = np.zeros(dx.shape), np.zeros(dm.shape), self.stages
        taken = np.zeros((len(dm) + 1, dm.shape[1]))
        for s in reversed(range(len(dm))):
            if np.any(dx[s]) or np.any(dm[s]) or np.any(taken[s + 1]):
                T, share = self._tangent(s), stages.shares[s]
                rhs = np.concatenate([dx[s] + T.forces(taken[s + 1]), dm[s]])
                forces[s], missing[s] = np.split(_solved(T, rhs, transposed=True), [len(dx[s])])
                taken[stages.end[s]] -= (1 - share) * missing[s]
                taken[stages.first[s]] -= share * missing[s]
        return forces, missing

    def _tangent(self, s):
        """The matrix of stage ``s`` at its end."""
        transport, stages = self.transport, self.stages
        x, p, m, tau = (
            stages.x[s + 1],
            stages.pressure[s + 1],
            stages.m[s + 1],
            np.float64(stages.tau[s]),
        )
        acting = acting_problem(transport, m)
        now = linearise(acting, x, p, acting_potential(transport, m))
        rates = balance_and_rates(
            transport,
            x,
            p,
            m,
            np.zeros(p.shape),
            tau,
            Bath(*(np.asarray(values[s]) for values in stages.bath)),
        )[-1]
        # one after the other: heaps grow with every stage if programs allocate while NumPy does
        change = FlowChange.of(transport, tau, *jax.block_until_ready((now, rates)))
        return Tangent(factorised(transport, acting, now, x, p, change), change)


def _solved(T, rhs, *, transposed=False):
    """The solution, nan if the matrix is singular."""
    solution = T.solve(rhs, ACCURATE, transposed=transposed)
    left = rhs - (T.transposed(solution) if transposed else T.product(solution))
    if not np.linalg.norm(left) <= POOR * np.linalg.norm(rhs):
        raise SingularTangent("derivatives in time: a stage's matrix is nearly singular")
    return solution


def _marched(forces, missing, *, march, transposed):
    """On the host, in the sizes of the shared form."""
    groups, f, S = (
        march.transport.saddle.groups,
        len(march.transport.problem.free),
        len(march.stages.tau),
    )
    own = np.asarray(forces)[:S, :f], np.asarray(missing)[:S][:, groups]
    with few_threads(f):
        found = march.backwards(*own) if transposed else march.forwards(*own)
    dx, dm = np.zeros(forces.shape), np.zeros(missing.shape)
    dx[:S, :f], dm[:S, groups] = found
    return [jax.device_put(dx), jax.device_put(dm)]


def _marched_jvp(args, dots, *, march, transposed):
    dots = [
        jnp.zeros_like(arg) if dot is None else dot for arg, dot in zip(args, dots, strict=True)
    ]
    return [marched.bind(*some, march=march, transposed=transposed) for some in (args, dots)]


def _marched_transpose(cotangents, _, *, march, transposed):
    if all(one is None for one in cotangents):
        return [None, None]
    given = [
        jnp.zeros(shape) if one is None else one
        for one, shape in zip(cotangents, march.shapes, strict=True)
    ]
    return marched.bind(*given, march=march, transposed=not transposed)


def _marched_batch(args, axes, **parameters):
    size = next(arg.shape[axis] for arg, axis in zip(args, axes, strict=True) if axis is not None)
    rows = [
        [
            arg if axis is None else jnp.moveaxis(arg, axis, 0)[k]
            for arg, axis in zip(args, axes, strict=True)
        ]
        for k in range(size)
    ]
    found = [marched.bind(*row, **parameters) for row in rows]
    return [jnp.stack(part) for part in zip(*found, strict=True)], [0, 0]


def _refuse(*_, **__):
    raise ValueError("derivatives of swell: are not available inside jax.jit; take them outside")


marched = primitive(
    "marched_tangents",
    value=_marched,
    traced=_refuse,
    shapes=lambda *args, **_: list(args),
    jvp=_marched_jvp,
    transpose=_marched_transpose,
    batch=_marched_batch,
    several=True,
)
"""`March.forwards` of right-hand sides (S, f), (S, g), or `backwards` if ``transposed``.

`March.backwards`; in the sizes of the shared form.
"""
