"""Equilibrium at one chemical potential: Newton's method on the mixed form, with a status that says how it ended.

The loop runs on the host, so that a person sees each step; its kernels are compiled once per model shape, with everything that
changes along a sweep traced.
"""

import dataclasses
import enum
import functools

import jax
import jax.numpy as jnp
import numpy as np

from .constraints import free_dofs
from .energy import (
    all_volumes,
    internal_force,
    mixed_terms,
    network_force,
    tangent,
    tangent_constants,
    tangent_pattern,
    total_energy,
    volume_ratios,
)
from .linear_solve import SingularTangent, factor

MAX_ITERATIONS = 25
TOLERANCE = 1e-10  # of the residual, relative to the forces of the network
CONSTRAINT_TOLERANCE = 1e-11  # of J - J*(p), relative to J* - 1 (plus round-off in J)

ROUND_OFF = 1e-3  # J* - 1 below which the constraint is met to round-off in J: 1e-14 / CONSTRAINT_TOLERANCE


class Status(enum.IntEnum):
    """How a solve or a sweep ended."""

    CONVERGED = 0
    NOT_CONVERGED = 1
    SINGULAR = 2
    NOT_FINITE = 3
    STEP_TOO_SMALL = 4
    TOO_MANY_STEPS = 5
    INTERRUPTED = 6
    SELF_CONTACT = 7

    @property
    def ok(self):
        """Whether the state satisfies equilibrium."""
        return self is Status.CONVERGED

    @property
    def text(self):
        """One line that says what happened and what to try."""
        return _TEXTS[self]


_TEXTS = {
    Status.CONVERGED: "converged",
    Status.NOT_CONVERGED: "Newton did not converge: the step in mu was too large, or the tangent is nearly singular; use smaller steps",
    Status.SINGULAR: "the tangent is singular: a fold or bifurcation; look at the lowest eigenvalue",
    Status.NOT_FINITE: "Newton left the numbers: the start is too far from equilibrium; use smaller steps",
    Status.STEP_TOO_SMALL: "the step in mu fell below its least value: the branch folds back or creases here (see surface_ratio), "
    "or the cloud is too coarse for the deformation",
    Status.TOO_MANY_STEPS: "the largest number of steps was reached; raise max_steps",
    Status.INTERRUPTED: "interrupted by the user; the states so far are kept",
    Status.SELF_CONTACT: "hole boundaries touch or overlap; without contact the states from here on are invalid",
}


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """A model with its gel and loads, prepared for Newton's method."""

    model: object
    """The ``Model``."""
    gel: object
    """The ``Gel``."""
    loads: jax.Array
    """(n, 2) dead nodal loads, kT/v mm."""
    pattern: object
    """Pattern of the tangent."""
    constants: tuple
    """``energy.tangent_constants``."""


@dataclasses.dataclass(frozen=True, eq=False)
class Equilibrium:
    """Result of Newton's method at one mu."""

    x: jax.Array
    """(n, 2) nodal positions, mm."""
    pressure: jax.Array
    """(g,) pressure of the volume groups, kT/v."""
    status: Status
    """How the iteration ended."""
    iterations: int
    """Number of linear solves."""
    residual: float
    """Norm of the residual over the norm of the network's nodal forces."""
    contraction: float
    """Ratio of the last two Newton corrections; nan with fewer than two."""
    factor: object
    """``linear_solve.Factor`` of the tangent of the last iteration, None where there was none."""


def prepare(model, gel, loads=None):
    """``Problem`` for a model; ``loads`` (n, 2) are dead nodal forces in kT/v mm, none by default."""
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else jnp.asarray(loads)
    pattern = tangent_pattern(model.lists, free_dofs(model.lists.topology))
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    return Problem(model, gel, loads, pattern, tangent_constants(model))


def dry_state(problem):
    """Positions (n, 2) and pressures (g,) to start from without a previous state: the dry nodes, p = -Nv."""
    return problem.model.cloud.nodes, jnp.full(len(all_volumes(problem.model)), -problem.gel.Nv)


def solve(problem, mu, x, pressure):
    """``Equilibrium`` at the chemical potential ``mu`` (kT), from positions ``x`` (n, 2) and pressures (g,).

    Newton's method on the mixed form (see ``energy``): every p is feasible, so no line search guards J > 1. The last factor is kept;
    it belongs to the iterate before the last correction, which differs from the tangent at the solution by that correction.
    """
    args = problem.model, problem.gel, jnp.asarray(mu, dtype=float)
    free, kept, sizes, size, contraction = problem.pattern.free, None, [], np.inf, np.nan
    for iteration in range(MAX_ITERATIONS + 1):
        rhs, stiffness, measures = _newton_system(x, pressure, *args, problem.loads, free)
        size, constraint = (float(m) for m in measures)
        if not np.isfinite(size + constraint):
            return Equilibrium(x, pressure, Status.NOT_FINITE, iteration, size, contraction, kept)
        if size < TOLERANCE and constraint < CONSTRAINT_TOLERANCE:
            return Equilibrium(x, pressure, Status.CONVERGED, iteration, size, contraction, kept)
        if iteration == MAX_ITERATIONS:
            break
        try:
            pairs = _tangent(x, pressure, stiffness, *args[:2], problem.constants)
            kept = factor(problem.pattern, pairs)
            correction, _ = kept.solve(np.asarray(rhs))
        except SingularTangent:
            return Equilibrium(x, pressure, Status.SINGULAR, iteration, size, contraction, kept)
        x, pressure = _update(x, pressure, correction, *args, free)
        sizes.append(np.linalg.norm(correction))
        contraction = sizes[-1] / sizes[-2] if len(sizes) > 1 else np.nan
    return Equilibrium(x, pressure, Status.NOT_CONVERGED, MAX_ITERATIONS, size, contraction, kept)


@jax.jit
def _newton_system(x, p, model, gel, mu, loads, free):
    """Right-hand side (f,) of the condensed Newton step, stiffness k (g,), and the residual and constraint measures."""
    error, k, star = mixed_terms(x, p, model, gel, mu)
    rhs = (loads - internal_force(x, p + k * error, model, gel)).ravel()[free]
    imbalance = (loads - internal_force(x, p, model, gel)).ravel()[free]
    scale = jnp.linalg.norm(network_force(x, model, gel)) + jnp.linalg.norm(loads)
    return rhs, k, (jnp.linalg.norm(imbalance) / scale, jnp.max(jnp.abs(error) / (star - 1 + ROUND_OFF)))


_tangent = jax.jit(tangent)


@jax.jit
def _update(x, p, correction, model, gel, mu, free):
    """Positions and pressures after a Newton correction (f,) of the free degrees of freedom."""
    dx = jnp.zeros(x.size).at[free].set(correction).reshape(x.shape)
    error, k, _ = mixed_terms(x, p, model, gel, mu)
    _, dJ = jax.jvp(lambda y: volume_ratios(y, model), (x,), (dx,))
    return x + dx, p + k * (dJ + error)


energy_at = jax.jit(total_energy)
"""Compiled ``energy.total_energy``."""
