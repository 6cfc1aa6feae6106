"""Equilibria of the paper's scheme at given chemical potentials, for up to a few thousand nodes.

The pressure of each volume group is an unknown beside the positions, as in ``mechanics.mixed``:
with the volume ratio J*(p) at which the gel has the pressure p, k = dp/dJ there, and G = d(V J)/dx,

    dp = k (G^T dx / V + J - J*),
    (network'' + sum_g [p d2(V J)/dx2 + (k/V) G G^T]) dx = - network' - sum_g [p + k (J - J*)] G

Every p is feasible, and the matrix is the Hessian of the energy wherever J = J*(p): the sum of the
paper's, Eqs. (47)-(49).
"""

import dataclasses
import functools
from collections.abc import Generator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from .._types import Array, Float
from .._validation import one_of
from ..continuation import Path, extrapolated, first_state_failed, given_values
from ..equilibrium import NEWTON, UNOBSERVED, Observer, Stability, State, Status, of_outlines
from ..linalg import SingularTangent
from ..materials import Gel, bulk_stiffness, flory_rehner, neo_hookean, volume_ratio_at
from ..mechanics import ROUND_OFF, Problem, state_pressure
from .increments import incremented
from .matrices import assembled, negative_eigenvalues, solved
from .scheme import (
    MINORS,
    Scheme,
    deformation_gradients,
    network_energy,
    scheme_energy,
    strain_operators,
    volume_ratios,
)

ALGORITHMS = ("total", "incremental")
EPS = np.finfo(float).eps
PATIENCE = 8  # iterations without progress after which Newton's method is given up


class SchemePath(Path):
    """A path of the paper's scheme for observables, which use its ``model``.

    They read it by the interpolating shape functions of that.
    """


def equilibria(
    scheme: Scheme,
    gel: Gel,
    mu: Sequence[float],
    *,
    algorithm: str = "total",
    until_overlap: bool = False,
) -> Generator[State, None, tuple[Status, float]]:
    """Yield states at the ``mu``, kT, while the branch continues; returns its end.

    Their ``x`` are nodal values. ``algorithm="incremental"`` is the paper's, with increments from
    the freely swollen plate. A symmetric branch is followed whatever its stability.
    ``until_overlap`` ends it if hole outlines overlap. Raises ValueError for a gel of another
    energy than the paper's, neo-Hookean and Flory-Rehner.
    """
    one_of("algorithm", algorithm, ALGORITHMS)
    if getattr(gel, "network", None) is not neo_hookean or gel.volumetric is not flory_rehner:
        raise ValueError(
            "gel: the paper's scheme needs the Flory-Rehner energy with a neo-Hookean network"
        )
    if algorithm == "incremental" and (
        scheme.cells.method != "displacement" or scheme.conditions != "nodes"
    ):
        given = f"{scheme.cells.method!r} and {scheme.conditions!r}"
        raise ValueError(
            "algorithm: 'incremental' needs method 'displacement' and conditions at the 'nodes', "
            f"not {given}"
        )
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    start = np.asarray(scheme.cloud.nodes), np.full(scheme.cells.volumes.shape, -float(gel.Nv))

    def attempt(mu, before):
        x, pressure = extrapolated(mu, before) if before else start
        if algorithm == "incremental":
            found = incremented(scheme, gel, mu, x if before else None)
        else:
            found = equilibrium(scheme, gel, mu, x, pressure)
        if until_overlap and found.status.ok:
            return dataclasses.replace(
                found, status=of_outlines(found.x, scheme.model, contact=False)
            )
        return found

    return given_values(attempt, list(map(float, mu)), [])


def scheme_path(
    scheme: Scheme,
    gel: Gel,
    mu: Sequence[float],
    *,
    observer: Observer = UNOBSERVED,
    **options: Any,
) -> SchemePath:
    """`SchemePath` of the `equilibria` with the same ``options``; SweepFailed without a state.

    Its shape functions interpolate. Its pressures are those at the volume ratios that its ``model``
    has. The ``observer`` is told of each state.
    """
    path_problem, stop, states = Problem(scheme.model, gel, contact=False), Status.CONVERGED, []

    def followed():
        nonlocal stop
        stop, _ = yield from equilibria(scheme, gel, mu, **options)

    for state in followed():
        observer.accepted(state)
        pressure = state_pressure(jnp.asarray(state.x), path_problem.model, gel, state.mu)
        states.append(dataclasses.replace(state, pressure=np.asarray(pressure)))
    if not states:
        raise first_state_failed(path_problem.control, mu[0], stop)
    return SchemePath.from_states(path_problem, states, stop=stop)


def equilibrium(
    scheme: Scheme, gel: Gel, mu: float, x: Float[Array, "n 2"], pressure: Float[Array, "c g"]
) -> State:
    """`State` at ``mu``, whatever its status, from nodal values ``x`` and pressures.

    Its stability is that within the edges.
    """
    found, matrix = newton(scheme, gel, mu, x, pressure)
    found = dataclasses.replace(found, energy=float(scheme_energy(found.x, scheme.cells, gel, mu)))
    return (
        dataclasses.replace(
            found, stability=Stability(negative_eigenvalues(matrix) - len(scheme.rows))
        )
        if found.status.ok
        else found
    )


def newton(
    scheme: Scheme, gel: Gel, mu: float, x: Float[Array, "n 2"], pressure: Float[Array, "c g"]
) -> tuple[State, sp.csr_array | None]:
    """Final `State` of Newton's method with multipliers, and its last matrix (f + m, f + m).

    The unknowns are displacements and multipliers.
    """
    dry, free, cells, matrix, best, improved, iteration = (
        np.asarray(scheme.cloud.nodes),
        scheme.free,
        scheme.cells,
        None,
        np.inf,
        0,
        0,
    )
    rows, multipliers = sp.csr_array(scheme.rows), np.zeros(len(scheme.rows))
    while True:
        force, condensed, now = _residual(x, pressure, cells, gel, mu)
        u = (np.asarray(x) - dry).ravel()
        reaction = scheme.stiffness @ u + rows.T @ multipliers
        residual = -np.asarray(force).ravel() - reaction
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            scale = float(now["network"]) + np.linalg.norm(reaction)
            # large terms of a stiff penalty cancel
            rounded = EPS * np.linalg.norm(abs(scheme.stiffness) @ np.abs(x).ravel()) / scale
            size = max(
                np.linalg.norm(residual[free]) / scale,
                np.linalg.norm(rows @ u) / np.linalg.norm(dry),
            )
        error, allowed = float(now["violation"]), max(NEWTON.tolerance, rounded)
        total = max(size / allowed, error / NEWTON.constraint_tolerance)
        if total < 0.5 * best:
            best, improved = total, iteration
        status = Status.NOT_CONVERGED
        if not np.isfinite(size + error):
            status = Status.NOT_FINITE
        elif total < 1 and iteration:
            status = Status.CONVERGED
        elif iteration < min(NEWTON.max_iterations, improved + PATIENCE + 1):
            K = (
                assembled(_tangents(x, pressure, now["stiffness"], cells, gel), cells, len(dry))
                + scheme.stiffness
            )
            matrix = sp.block_array(
                [[K[free][:, free], rows[:, free].T], [rows[:, free], None]], format="csr"
            )
            right, dx = (
                np.append((-np.asarray(condensed).ravel() - reaction)[free], -rows @ u),
                np.zeros(dry.size),
            )
            try:
                dx[free], step = np.split(solved(matrix, right), [len(free)])
            except SingularTangent:
                status = Status.SINGULAR
            else:
                x, pressure = _advanced(x, pressure, dx.reshape(-1, 2), now, cells)
                multipliers, iteration = multipliers + step, iteration + 1
                continue
        x, pressure = np.asarray(x), np.asarray(pressure)
        return State(
            float(mu),
            float(mu),
            x,
            pressure,
            status,
            newton_iterations=iteration,
            residual=float(size),
        ), matrix


@jax.jit
def _residual(x, p, cells, gel, mu):
    """Internal forces (n, 2), the same condensed, and what a Newton step needs of the state."""
    J, real = volume_ratios(x, cells), cells.volumes > 0
    star = volume_ratio_at(jnp.where(real, p, -gel.Nv), mu, gel)
    stiffness, error = bulk_stiffness(star, gel), jnp.where(real, J - star, 0.0)
    network = jax.grad(network_energy)(x, cells, gel)
    of_pressure = jax.grad(lambda x, p: jnp.sum(p * cells.volumes * volume_ratios(x, cells)))
    violation = jnp.max(jnp.abs(error) / (star - 1 + ROUND_OFF))
    now = dict(
        stiffness=stiffness, error=error, violation=violation, network=jnp.linalg.norm(network)
    )
    return network + of_pressure(x, p), network + of_pressure(x, p + stiffness * error), now


@jax.jit
def _tangents(x, p, stiffness, cells, gel):
    """Condensed tangents (c, 2 a, 2 a) of the cells."""
    F, (c, q, a, _) = deformation_gradients(x, cells), cells.dphi.shape
    B = strain_operators(cells.dphi).reshape(c, q, 4, 2 * a)
    A = jax.vmap(jax.vmap(jax.hessian(lambda F: gel.network(F, gel))))(F).reshape(c, q, 4, 4)
    weighted = jnp.einsum(
        "cqij,cqja->cqia", cells.weight[..., None, None] * (A + p[..., None, None] * MINORS), B
    )
    K = jnp.einsum("cxa,cxb->cab", B.reshape(c, 4 * q, -1), weighted.reshape(c, 4 * q, -1))
    G = jnp.einsum("cq,cqi,cqia->cqa", cells.weight, F.reshape(c, q, 4) @ MINORS, B)
    G = G if cells.method == "displacement" else jnp.sum(G, axis=1, keepdims=True)
    k_over_V = jnp.where(
        cells.volumes > 0, stiffness / jnp.where(cells.volumes > 0, cells.volumes, 1.0), 0.0
    )
    return K + jnp.einsum("cga,cgb->cab", k_over_V[..., None] * G, G)


@jax.jit
def _advanced(x, p, dx, now, cells):
    """Positions and pressures after the step ``dx`` (n, 2)."""
    dJ = jax.jvp(functools.partial(volume_ratios, cells=cells), (x,), (dx,))[1]
    return x + dx, p + now["stiffness"] * (dJ + now["error"])
