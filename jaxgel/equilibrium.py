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

from .constraints import free_dofs, picked, reduced, spread, start_positions
from .contact import closest, crosses, outline_loops, step_limit
from .energy import all_volumes, total_energy, volume_ratios
from .linear_solve import SingularTangent, factor
from .material import osmotic
from .mixed import condensed_rhs, constants, linearise, pressure_step, tangent, tangent_pattern

MAX_ITERATIONS = 30
TOLERANCE = 1e-10  # of the residual, relative to the forces of the network
CONSTRAINT_TOLERANCE = 1e-11  # of J - J*(p), see ``mixed.linearise``
FINE = 50  # spacings across the plate up to which round-off leaves less than a fifth of that; it grows with their number
SLOW = 0.1  # a step that leaves more than this of the imbalance makes a new factor worth its cost
LARGEST_RISE = 3.0  # of the imbalance in an iteration with contact: more is a pair of points thrown deep into each other, again and again
MAX_HALVINGS = 6  # of such a correction


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
    CROSSED = 8
    NEARLY_SINGULAR = 9

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
    Status.CROSSED: "a hole's boundary passed through itself: use smaller steps in mu, or stiffer contact (see with_contact)",
    Status.NEARLY_SINGULAR: "converged, but a fold or bifurcation is near: derivatives grow like 1 / lowest_eigenvalue and hold for tiny "
    "changes only",
}


def advice(model, stop):
    """What to change where not even the first state of a sweep was found, after the text of its `Status`."""
    if stop is Status.SELF_CONTACT:
        return "; sweep with contact = 'on'"
    return (
        "; method = 'displacement' locks where the edges leave little room: take 'mixed'"
        if model.method == "displacement"
        else "; start at a lower mu"
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """A model with its gel and loads, prepared for Newton's method."""

    model: object
    """The ``Model``."""
    gel: object
    """The ``Gel``."""
    loads: jax.Array
    """(n, 2) dead nodal loads, kT/v mm."""
    fixed: object
    """``mixed.Constants`` of the model."""
    apart: object = None
    """The same ``Problem`` without self-contact, for states in which no outline is near itself; None where there is no contact."""

    @functools.cached_property
    def free(self):
        """(f,) numbers of the free degrees of freedom."""
        return free_dofs(self.model.lists.topology)

    @functools.cached_property
    def pattern(self):
        """Pattern of the tangent; that of contact, made when first asked for, couples all nodes near a hole and takes the longer."""
        return tangent_pattern(self.model.lists, self.free, self.model.contact, self.model.solver)


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
    factor: object
    """The last ``linear_solve.Factor``, of a tangent near the state; None where the start was the solution, or a factor failed."""
    apart: bool = False
    """Whether contact was left out, as no outline is near itself."""
    linearisation: object = None
    """The ``mixed.Linearisation`` about the state; None where the last one made is about another."""


def prepare(model, gel, loads=None):
    """``Problem`` for a model; ``loads`` (n, 2) are dead nodal forces in kT/v mm, none by default."""
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else jnp.asarray(loads)
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    apart = None if model.contact is None else prepare(dataclasses.replace(model, contact=None), gel, loads)
    return Problem(model, gel, loads, constants(model) if apart is None else apart.fixed, apart)


@jax.jit
def dry_state(model, gel, mu=None):
    """Positions (n, 2) and pressures (g,) to start from without a previous state: the dry nodes, moved as the edges are, and p = -Nv.

    With ``mu`` (kT) the pressures are higher where the moved edges leave the gel more room than that.
    """
    x, pressure = start_positions(model.lists.topology, model.cloud.nodes), -gel.Nv * jnp.ones_like(all_volumes(model))
    plate = model.lists.topology.plate
    if mu is None or not plate.moved:
        return x, pressure
    J = volume_ratios(x, model)
    return x, jnp.where(J > 1, jnp.maximum(osmotic(jnp.where(J > 1, J, 2.0), mu, gel), pressure), pressure)


def solve(problem, mu, x, pressure, *, fresh=False, near=None):
    """``Equilibrium`` at the chemical potential ``mu`` (kT), from positions ``x`` (n, 2) and pressures (g,).

    Newton's method on the mixed form (see ``mixed``): every p is feasible, so no line search guards J > 1. A factor serves for as
    long as each correction leaves less than ``SLOW`` of the imbalance; the last one is kept. With ``fresh`` every correction gets its
    own factor, and so does the solution. Contact is left out until an outline comes near itself: at the start, where ``near`` does not
    already say so, and in the solution. A state in which one crosses itself is not accepted.
    """
    if problem.apart is not None and not (touches(problem.model, x) if near is None else near):
        found = solve(problem.apart, mu, x, pressure, fresh=fresh)
        if not (found.status.ok and touches(problem.model, found.x)):
            return dataclasses.replace(found, apart=True)
    found = _newton(problem, mu, x, pressure, fresh=fresh or problem.apart is not None)
    if problem.apart is not None and found.status.ok and overlaps(problem.model, found.x):
        return dataclasses.replace(found, status=Status.CROSSED)
    return found


def acting(problem, state):
    """The problem that the ``Equilibrium`` solves: the one without contact where contact was not needed."""
    return problem.apart if state.apart else problem


def with_own_factor(problem, mu, state):
    """The ``Equilibrium`` at ``mu`` (kT) with a factor of its own tangent."""
    if state.linearisation is None:
        return dataclasses.replace(solve(problem, mu, state.x, state.pressure, fresh=True), iterations=state.iterations)
    problem = acting(problem, state)
    pairs = tangent_at(state.x, state.pressure, state.linearisation, problem.model, problem.gel, problem.fixed)
    return dataclasses.replace(state, factor=factor(problem.pattern, pairs))


def touches(model, x):
    """Whether an outline comes so near itself that contact acts."""
    return not float(_closest(x, model)) >= 1.0


def overlaps(model, x):
    """Whether a hole's outline crosses itself, another one or a wall."""
    return crosses([np.asarray(loop) for loop in _loops(x, model)], model.lists.topology.plate)


def _newton(problem, mu, x, pressure, *, fresh):
    args = problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads, problem.fixed
    now, measures = linearised(x, pressure, *args, problem.free)
    kept, basis, iterations, before = None, None, 0, np.inf
    while True:
        size, constraint = float(measures[0]), float(measures[1])
        if not np.isfinite(size + constraint):
            return Equilibrium(x, pressure, Status.NOT_FINITE, iterations, size, kept)
        if size < TOLERANCE and constraint < CONSTRAINT_TOLERANCE:
            if fresh:
                kept = None  # its memory is wanted
                kept = factor(problem.pattern, tangent_at(x, pressure, now, *args[:2], problem.fixed))
            return Equilibrium(x, pressure, Status.CONVERGED, iterations, size, kept, linearisation=now)
        if iterations == MAX_ITERATIONS:
            return Equilibrium(x, pressure, Status.NOT_CONVERGED, iterations, size, kept)
        imbalance = _imbalance(measures)
        try:
            if fresh or kept is None or imbalance > SLOW * before:
                basis, kept = now, None  # the memory of the last factor is wanted
                kept = factor(problem.pattern, tangent_at(x, pressure, basis, *args[:2], problem.fixed))
            rhs = free_rhs(now, basis, problem.model, problem.free)
            correction, _ = kept.solve(np.asarray(rhs), refine=False)
        except SingularTangent:
            return Equilibrium(x, pressure, Status.SINGULAR, iterations, size, kept)
        x, pressure, now, measures = _advanced(problem, x, pressure, correction, now, basis, imbalance, args)
        iterations, before = iterations + 1, imbalance


def _imbalance(measures):
    """The measures of `linearised` over their tolerances, the larger one."""
    return max(float(measures[0]) / TOLERANCE, float(measures[1]) / CONSTRAINT_TOLERANCE)


def _advanced(problem, x, pressure, correction, now, basis, imbalance, args):
    """``_advance`` by the whole correction, or where contact then multiplies the ``imbalance``, by half of it and so on."""
    whole = x, pressure, correction, now, basis, *args, problem.free
    found = _advance(*whole, 1.0)
    for halvings in range(1, MAX_HALVINGS + 1 if problem.apart is not None else 0):
        if _imbalance(found[3]) < max(LARGEST_RISE * imbalance, 1.0):
            break
        found = _advance(*whole, 0.5**halvings)
    return found


def solve_pinned(problem, mu, x, pressure, mode, origin, amplitude):
    """``Equilibrium`` under a force along ``mode`` (f,) that holds mode . (x - origin) at ``amplitude``, and the force ().

    Newton's method on the system bordered by the pin; the tangent may be indefinite but must not be singular.
    """
    args = problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads, problem.fixed
    free, force, kept = problem.free, 0.0, None
    origin = np.asarray(picked(np.asarray(origin), free))
    now, measures = linearised(x, pressure, *args, free)
    for iterations in range(MAX_ITERATIONS):
        rhs = np.asarray(free_rhs(now, now, problem.model, free)) + force * mode
        miss = amplitude - mode @ (picked(np.asarray(x), free) - origin)
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            size = float(np.linalg.norm(np.asarray(reduced(now.rhs, free)) + force * mode) * float(measures[2]))
        if not np.isfinite(size + float(measures[1])):
            return Equilibrium(x, pressure, Status.NOT_FINITE, iterations, size, None), force
        if size < TOLERANCE and float(measures[1]) < CONSTRAINT_TOLERANCE and abs(miss) < 1e-9 * abs(amplitude):
            return Equilibrium(x, pressure, Status.CONVERGED, iterations, size, kept), force
        try:
            kept = factor(problem.pattern, tangent_at(x, pressure, now, *args[:2], problem.fixed))
            both, _ = kept.solve(np.stack([rhs, mode], axis=1))
        except SingularTangent:
            return Equilibrium(x, pressure, Status.SINGULAR, iterations, size, None), force
        more = (miss - mode @ both[:, 0]) / (mode @ both[:, 1])
        x, pressure, now, measures = _advance(x, pressure, both[:, 0] + more * both[:, 1], now, now, *args, free, 1.0)
        force += more
    return Equilibrium(x, pressure, Status.NOT_CONVERGED, MAX_ITERATIONS, size, None), force


@jax.jit
def linearised(x, p, model, gel, mu, loads, fixed, free):
    """``mixed.linearise``, and the measures (relative residual, constraint, 1 / scale of the residual).

    The constraint is that of ``mixed.linearise`` over what a cloud as fine as this can reach: positions differ by a share spacing / size.
    """
    now, (network, constraint) = linearise(x, p, model, gel, mu, loads, fixed)
    topology = model.lists.topology
    across = max(topology.plate.width, topology.plate.height) / topology.node_spacing.min()
    constraint = constraint / max(1.0, across / FINE)
    per_force = 1 / (network + jnp.linalg.norm(loads))
    return now, (jnp.linalg.norm(reduced(now.rhs, free)) * per_force, constraint, per_force)


@jax.jit
def free_rhs(now, basis, model, free):
    """``mixed.condensed_rhs`` on the free degrees of freedom (f,)."""
    return reduced(condensed_rhs(now, basis, model), free)


tangent_at = jax.jit(tangent)
"""Compiled ``mixed.tangent``."""


@jax.jit
def _advance(x, p, correction, now, basis, model, gel, mu, loads, fixed, free, share):
    """Positions and pressures after a ``share`` of a correction (f,) of the free degrees of freedom, linearised there."""
    dx = spread(correction, x.shape, free)
    share = share * step_limit(x, dx, model) if model.contact is not None else share
    x, p = x + share * dx, p + share * pressure_step(dx, now, basis, model)
    return x, p, *linearised(x, p, model, gel, mu, loads, fixed, free)


def solve_traced(model, gel, mu, loads, x, pressure):
    """``solve`` inside jit or vmap: positions (n, 2), pressures (g,) and a dict of status, iterations, residual, negative pivots.

    The loop is a ``while_loop``; only the sparse solves leave for the host. Positions are nan where it did not converge.
    """
    pattern = tangent_pattern(model.lists, free_dofs(model.lists.topology), model.contact, model.solver)
    free, fixed = pattern.free, constants(model)
    args = model, gel, mu, loads, fixed, free

    def going(state):
        _, _, _, (size, constraint, _), iterations, _ = state
        done = (size < TOLERANCE) & (constraint < CONSTRAINT_TOLERANCE)
        return ~done & jnp.isfinite(size + constraint) & (iterations < MAX_ITERATIONS)

    def step(state):
        x, p, now, _, iterations, _ = state
        shapes = (jax.ShapeDtypeStruct(free.shape[:1], x.dtype), jax.ShapeDtypeStruct((), int))
        system = tangent(x, p, now, model, gel, fixed), free_rhs(now, now, model, free)
        correction, negative = jax.pure_callback(functools.partial(_host_step, pattern), shapes, *system, vmap_method="sequential")
        return *_advance(x, p, correction, now, now, *args, 1.0), iterations + 1, negative

    state = (x, pressure, *linearised(x, pressure, *args), jnp.asarray(0), jnp.asarray(0))
    x, p, _, (size, constraint, _), iterations, negative = jax.lax.while_loop(going, step, state)
    done = (size < TOLERANCE) & (constraint < CONSTRAINT_TOLERANCE)
    failed = jnp.where(jnp.isfinite(size + constraint), int(Status.NOT_CONVERGED), int(Status.NOT_FINITE))
    status = jnp.where(done, int(Status.CONVERGED), failed)
    report = dict(status=status, newton_iterations=iterations, residual=size, negative_pivots=negative)
    return jnp.where(done, x, jnp.nan), p, report


def _host_step(pattern, pairs, rhs):
    """Newton correction (f,) and number of negative pivots; nan and -1 where the tangent is singular."""
    try:
        made = factor(pattern, pairs)
        return made.solve(rhs)[0], np.asarray(made.negative_pivots)
    except SingularTangent:
        return np.full(rhs.shape, np.nan), np.asarray(-1)


_closest = jax.jit(closest)
_loops = jax.jit(outline_loops)

energy_at = jax.jit(total_energy)
"""Compiled ``energy.total_energy``."""
