"""Continuation in the chemical potential: equilibria at given values of mu, or at values chosen on the way.

A step knows nothing of the sweep: it is a predicted state and Newton's method. The sweep extrapolates, cuts a step that failed, and
always ends: with all states, or with those so far and a status that says why it stopped.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .constraints import check_room, free_dofs, reduced, spread
from .contact import with_contact
from .energy import residual
from .equilibrium import Equilibrium, Status, acting, advice, dry_state, overlaps, prepare, solve, touches
from .implicit import known, state_tangents
from .incremental import incremental_step, prepare_incremental
from .linear_solve import few_threads, remember
from .material import check_gel
from .mixed import state_pressure, tangent_pattern
from .path import Path, Step
from .relaxation import relax, relax_along
from .stability import lowest_modes, nearby_modes, network_stiffness, stable_state
from .traced import columns, energies_and_pressures, is_traced, scan_states, warn
from .walls import prepare_walls, wall_step

BRANCHES = ("stable", "symmetric")
CONTACT = ("on", "off", "stop")
FORMULATIONS = ("total", "incremental")
EXTRAPOLATED = 7  # most states from which the next one is predicted
MAX_CUTS = 8  # halvings of a step in mu before the sweep gives up
SNAP = 5e-3  # kT: a step this short that fails with contact ends on another branch, by relaxation
GROWTH = {4: 2.0, 5: 1.6, 6: 1.3, 7: 1.1, 8: 1.0}  # of a chosen step after so many corrections; 0.6 after more
LEAST_RAMP = 1 / 200  # of the motion of a plate's edges, which may come in steps before the first state
MAX_STEPS = 400  # accepted states of a sweep with chosen steps


class SweepFailed(ArithmeticError):
    """Not even the first state of a sweep was found; the text says why."""


def sweep(
    model,
    gel,
    *,
    mu,
    branch="stable",
    contact="on",
    loads=None,
    on_step=None,
    start=None,
    max_steps=MAX_STEPS,
    formulation="total",
):
    """``Path`` of equilibria at the given increasing values ``mu`` (k,), or from ``mu = (first, last)`` in steps chosen on the way.

    A tuple of two numbers means chosen steps; a list or array means those values. Where the branch that is followed loses its stability,
    ``branch="stable"`` crosses to the stable branch that leaves it; ``"symmetric"`` goes on, as a perfectly symmetric cloud would.
    Either way ``path.negative_pivots`` says of each state whether it is stable (0). Where the sides of a hole meet, ``contact="on"`` keeps
    them apart (range and stiffness: ``contact.with_contact``), ``"off"`` lets them overlap, and ``"stop"`` ends the sweep. With contact a
    stable branch that ends, or turns unstable, is left by relaxation (``switched``). ``loads`` (n, 2) are dead nodal forces, see
    ``load_vector``. ``formulation="incremental"`` is the paper's algorithm instead of the total energy, see ``incremental``; like weak
    conditions (see ``walls``) it knows neither contact nor other branches. ``on_step(step)`` is called with each accepted ``Step``;
    ``start`` is a Step to continue from, or the list of all steps of an interrupted sweep, with which the path then begins: to the bit
    that of a sweep that was not interrupted. Raises ValueError for a gel or mu that cannot be used and ``SweepFailed`` where the first
    state is not found; later failures end the path early, with the reason in ``path.stop`` and ``path.stop_text``. Differentiating a
    state that has no good derivative warns of it (``IllPosedDerivative``). Inside ``jax.jit`` and ``jax.vmap``, for given mu only,
    states that are not reached are nan, and the branch that continues the dry state is followed whatever its stability.
    """
    if branch not in BRANCHES:
        raise ValueError(f"branch: {branch!r} is not one of {', '.join(BRANCHES)}")
    if contact not in CONTACT:
        raise ValueError(f"contact: {contact!r} is not one of {', '.join(CONTACT)}")
    if formulation not in FORMULATIONS:
        raise ValueError(f"formulation: {formulation!r} is not one of {', '.join(FORMULATIONS)}")
    own = formulation == "total" and model.conditions == "nodes"
    model = with_contact(model, gel) if contact == "on" and own else dataclasses.replace(model, contact=None)
    if not own:
        _check_own(model, formulation, is_traced((model, gel, mu, loads)))
    if is_traced((model, gel, mu, loads)):
        return _traced_sweep(model, gel, mu, branch, contact, loads, max_steps)
    targets, chosen = check_mu(mu)
    check_gel(gel)
    check_room(model.lists.topology.plate)
    before = [] if start is None else [start] if isinstance(start, Step) else list(start)
    if before and not targets[-1 if chosen else 0] > before[-1].mu:
        raise ValueError(f"mu: {targets[-1 if chosen else 0]:g} is not above the start's mu = {before[-1].mu:g}")
    if own:
        problem = prepare(model, gel, loads)
        attempt = functools.partial(_attempt, problem, network_stiffness(problem), branch == "stable")
    else:
        kind = (prepare_incremental, _incremental_attempt) if formulation == "incremental" else (prepare_walls, _weak_attempt)
        attempt = functools.partial(kind[1], kind[0](model, gel, loads, free_dofs(model.lists.topology)))
    attempt = functools.partial(_until_contact, attempt, model) if contact == "stop" else attempt
    with few_threads(2 * model.n_nodes):
        steps, stop, where = _chosen(attempt, targets, on_step, before, max_steps) if chosen else _given(attempt, targets, on_step, before)
    steps = steps[1:] if isinstance(start, Step) else steps
    if not steps:
        raise SweepFailed(f"sweep: no equilibrium at mu = {targets[0]:.6g}: {stop.text}{advice(model, stop)}")
    return Path.from_steps(model, gel, steps, stop=stop, stop_text="" if stop.ok else f"stopped after mu = {where:.6g}: {stop.text}")


def _check_own(model, formulation, traced):
    """ValueError for what weak conditions and the incremental formulation cannot do."""
    what = "formulation: 'incremental'" if formulation == "incremental" else f"conditions: {model.conditions!r}"
    plate, ask = model.lists.topology.plate, "use the total formulation and conditions at the nodes"
    if traced:
        raise ValueError(f"{what} cannot be differentiated; {ask}")
    if plate.moved or "periodic" in plate.edges.values():
        raise ValueError(f"{what} knows neither periodic edges nor edges that move; {ask}")


def check_mu(mu):
    """The values of mu as an array (k,) and whether steps are to be chosen between two; ValueError, one line, if unusable."""
    values = np.atleast_1d(np.asarray(mu, dtype=float))
    if values.ndim != 1 or len(values) == 0 or not np.all(np.isfinite(values)):
        raise ValueError(f"mu: {mu} is not accepted, it must be a list of finite numbers (chemical potential in kT)")
    if np.any(np.diff(values) <= 0):
        k = int(np.argmax(np.diff(values) <= 0))
        raise ValueError(f"mu: {values[k]:g} is followed by {values[k + 1]:g}, the values must increase")
    return values, isinstance(mu, tuple) and len(values) == 2


def _given(attempt, targets, on_step, before):
    """The states ``before`` and those at the given values; a failed step is cut, its intermediate states are not kept."""
    done = list(before)
    for target in targets:
        step, status = _reach(attempt, target, done)
        if step is None:
            return done, status, done[-1].mu if done else target
        step = step.told(on_step)
        done.append(step)
    return done, Status.CONVERGED, targets[-1]


def _reach(attempt, target, done):
    """Step at ``target`` from the states done, by way of intermediate states where the direct one fails; or None and a status."""
    history, spent, cuts, goal = list(done), 0, 0, target
    while True:
        found = attempt(goal, history)
        spent += found.newton_iterations
        if found.status.ok:
            if goal == target:
                return dataclasses.replace(found, newton_iterations=spent), found.status
            history.append(found)
            goal = target if cuts <= 1 else min(target, 2 * goal - history[-2].mu)
            cuts = max(0, cuts - 1)
        elif not history or cuts >= MAX_CUTS or found.status is Status.SELF_CONTACT:
            return None, found.status if not history or found.status is Status.SELF_CONTACT else Status.STEP_TOO_SMALL
        else:
            cuts += 1
            goal = history[-1].mu + 0.5 * (goal - history[-1].mu)


def _chosen(attempt, targets, on_step, before, max_steps):
    """The states ``before`` and those up to the last value, the step set by the number of Newton iterations the last one took."""
    first, last = targets
    done, least, spent = list(before), 1e-5 * (last - first), 0
    step = done[-1].stride if done and np.isfinite(done[-1].stride) else (last - first) / 8
    goal = _ahead(done[-1].mu, step, last) if done else first
    while len(done) < max_steps:
        found = attempt(goal, done)
        spent += found.newton_iterations
        if found.status.ok:
            step *= 2.0 if found.newton_iterations < 4 else GROWTH.get(found.newton_iterations, 0.6)
            found, spent = dataclasses.replace(found, newton_iterations=spent, stride=step).told(on_step), 0
            done.append(found)
            if goal >= last:
                return done, Status.CONVERGED, last
        elif not done or found.status is Status.SELF_CONTACT:
            return done, found.status, done[-1].mu if done else goal
        else:
            step = 0.4 * (goal - done[-1].mu)
            if step < least:
                return done, Status.STEP_TOO_SMALL, done[-1].mu
        goal = _ahead(done[-1].mu, step, last)
    return done, Status.TOO_MANY_STEPS, done[-1].mu


def _ahead(mu, step, last):
    """The mu a ``step`` ahead, or ``last`` where little would be left to it."""
    return last if mu + step > last - 0.3 * step else mu + step


def _weak_attempt(problem, mu, done):
    """``Step`` at ``mu`` of a model whose essential conditions are imposed weakly."""
    return wall_step(problem, mu, *_predict(problem, mu, _same_branch(done)))


def _incremental_attempt(problem, mu, done):
    """``Step`` at ``mu`` by the paper's algorithm."""
    return incremental_step(problem, mu, _predict(problem, mu, _same_branch(done))[0] if done else None)


def _until_contact(attempt, model, mu, done):
    """``attempt`` that ends the sweep where hole boundaries overlap."""
    step = attempt(mu, done)
    return dataclasses.replace(step, status=Status.SELF_CONTACT) if step.status.ok and overlaps(model, step.x) else step


def _attempt(problem, stiffness, stable, mu, done):
    """``Step`` at ``mu`` (whatever its status) from the state extrapolated from those before on its branch."""
    history = _same_branch(done)
    (found, switched), modes = _reached(problem, stable, mu, history), None
    if found.status.ok:
        modes, start = nearby_modes(problem, stiffness, found, mu, history[-1].modes if history else None)
        if modes is None:
            found = dataclasses.replace(found, factor=None)  # its memory is wanted
            modes, found = lowest_modes(problem, stiffness, found, mu, start)
        other = _stable(problem, stiffness, mu, found, modes) if stable and modes.negative > 0 else None
        if other is not None:
            found, modes, switched = dataclasses.replace(other[0], iterations=found.iterations + other[0].iterations), other[1], True
    step = Step.at(problem, mu, found, modes, switched=switched)
    return step if done or not found.status.ok else dataclasses.replace(step, rate=_rate(problem, mu, found))


def _rate(problem, mu, state):
    """dx/dmu (n, 2), mm/kT, of the branch on which the ``Equilibrium`` at ``mu`` lies."""
    pull = _pull_of_mu(state.x, acting(problem, state).model, problem.gel, mu, problem.loads, problem.free)
    return np.asarray(spread(state.factor.apply(np.asarray(pull)), state.x.shape, problem.free))


@jax.jit
def _pull_of_mu(x, model, gel, mu, loads, free):
    """Forces (f,) on the free degrees of freedom that an increase of mu brings, mm/v."""
    return -reduced(jax.jvp(lambda mu: residual(x, model, gel, mu, loads), (mu,), (1.0,))[1], free)


@jax.jit
def _pressure_rate(x, rate, model, gel, mu):
    """dp/dmu (g,), 1/v, at positions ``x`` (n, 2) that change at the ``rate`` (n, 2)."""
    return jax.jvp(lambda x, mu: state_pressure(x, model, gel, mu), (x, mu), (rate, 1.0))[1]


def _reached(problem, stable, mu, history):
    """``Equilibrium`` at ``mu`` from the state that ``history`` predicts, and whether it lies on another branch.

    Where holes touch, a step that moves the gel farther than the range of contact is refused, and a short one that fails relaxes.
    """
    x, pressure = _predict(problem, mu, history)
    if not history:
        found = solve(problem, mu, x, pressure)
        return found if found.status.ok or not problem.model.cloud.plate.moved else _ramped(problem, mu, found), False
    if problem.apart is None:
        return solve(problem, mu, x, pressure), False
    last, most = history[-1], float(problem.model.contact.range)
    far = not np.abs(x - last.x).max() < most
    acted = touches(problem.model, last.x) if last.apart is None else not last.apart
    near = (acted or far) and touches(problem.model, x)
    if far and (acted or near):
        return Equilibrium(x, pressure, Status.NOT_CONVERGED, 0, float("nan"), None), False
    found = solve(problem, mu, x, pressure, near=near)
    if found.status.ok and not found.apart and not np.abs(found.x - last.x).max() < most:
        found = dataclasses.replace(found, status=Status.NOT_CONVERGED)
    if found.status.ok or not stable or mu - last.mu > SNAP:
        return found, False
    relaxed = relax(problem, mu, last.x, last.pressure)
    return dataclasses.replace(relaxed, iterations=found.iterations + relaxed.iterations), relaxed.status.ok


def _ramped(problem, mu, failed):
    """First ``Equilibrium`` of a plate whose edges are moved step by step, where moving them at once ``failed``."""
    model, (x, pressure) = problem.model, dry_state(problem.model, problem.gel)
    whole, x = x - model.cloud.nodes, model.cloud.nodes
    share, step, iterations = 0.0, 1 / 8, failed.iterations
    while share < 1:
        more = min(step, 1 - share)
        found = solve(problem, mu, x + more * whole, pressure)
        iterations += found.iterations
        if found.status.ok:
            x, pressure, share = found.x, found.pressure, share + more
        elif step < LEAST_RAMP:
            break
        else:
            step /= 2
    return dataclasses.replace(found, iterations=iterations)


def _stable(problem, stiffness, mu, found, modes):
    """Stable ``Equilibrium`` and its ``Modes`` from an unstable one: next to it on a branch that leaves there, or by relaxation."""
    other = None if problem.apart is not None and touches(problem.model, found.x) else stable_state(problem, mu, found, modes)
    if other is None and problem.apart is not None:
        state = relax_along(problem, mu, found, modes.vectors[:, 0])
        if state.status.ok:
            modes, state = lowest_modes(problem, stiffness, state, mu)
            other = (state, modes) if modes.negative == 0 else None
    return other


def _same_branch(done):
    """The last states, at most ``EXTRAPOLATED``, that lie on one branch."""
    recent = done[-EXTRAPOLATED:]
    first = max((k for k, step in enumerate(recent) if step.switched), default=0)
    return recent[first:]


def _predict(problem, mu, history):
    """Positions and pressures at ``mu`` by extrapolation through states of ``history``; the dry state without any.

    The first state of a sweep has its rate of change, which serves where it is alone.
    It goes through as many of the last states as would have predicted the last one best, and through one more where that is all of them:
    a polynomial of high degree is good on a smooth path and leaves the branch where that has turned.
    """
    if not history:
        return dry_state(problem.model, problem.gel, mu)
    if len(history) == 1 and history[0].rate is not None:
        last, share = history[0], mu - history[0].mu
        rate = _pressure_rate(last.x, last.rate, problem.model, problem.gel, last.mu)
        return np.asarray(last.x) + share * last.rate, np.asarray(last.pressure) + share * np.asarray(rate)
    at = np.array([step.mu for step in history])
    x = np.stack([np.asarray(step.x) for step in history])
    misses = [np.linalg.norm(np.tensordot(_weights(at[-k - 1 : -1], at[-1]), x[-k - 1 : -1], 1) - x[-1]) for k in range(1, len(at))]
    best = int(np.argmin(misses)) + 1 if misses else 1
    used = len(at) if best == len(at) - 1 else best
    weights = _weights(at[-used:], mu)
    return np.tensordot(weights, x[-used:], 1), np.tensordot(weights, [np.asarray(step.pressure) for step in history[-used:]], 1)


def _weights(at, mu):
    """Weights (k,) with which states at the values ``at`` (k,) of mu give the state at ``mu`` on the polynomial through them (Lagrange)."""
    others = [np.delete(at, i) for i in range(len(at))]
    return np.array([np.prod((mu - other) / (a - other)) for a, other in zip(at, others, strict=True)])


# --- sweeps inside JAX transformations ---------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Static:
    """What identifies a traced sweep besides its arrays; hashable."""

    structure: object
    """Tree structure of (model, gel, mu, loads)."""
    floating: tuple
    """Which leaves are floating-point arrays, that is differentiable."""
    chosen: tuple | None
    """(first, last) of chosen steps."""
    branch: str
    """Branch to follow."""
    contact: str
    """What happens where hole boundaries meet."""
    max_steps: int
    """Most steps."""

    def join(self, floats, rest):
        """(model, gel, mu, loads) from the two kinds of leaves."""
        floats, rest = iter(floats), iter(rest)
        return jax.tree.unflatten(self.structure, [next(floats) if f else next(rest) for f in self.floating])


def _traced_sweep(model, gel, mu, branch, contact, loads, max_steps):
    """``sweep`` under differentiation, jit or vmap; states that are not reached are nan, with their status.

    Differentiation flags, and warns of, states without a good derivative (``IllPosedDerivative``): nearly singular or self-contacting.
    """
    chosen = isinstance(mu, tuple) and len(mu) == 2
    if chosen and is_traced(mu):
        raise ValueError("mu: chosen steps need concrete numbers (first, last); differentiate with respect to a list of values instead")
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    loads = jnp.asarray(np.zeros((model.n_nodes, 2)) if loads is None else loads, dtype=float)
    values = jnp.zeros(0) if chosen else jnp.atleast_1d(jnp.asarray(mu, dtype=float))
    leaves, structure = jax.tree.flatten((model, gel, values, loads))
    floating = tuple(jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in leaves)
    static = _Static(structure, floating, tuple(map(float, mu)) if chosen else None, branch, contact, max_steps)
    floats = [leaf for leaf, f in zip(leaves, floating, strict=True) if f]
    x, report = _states(static, floats, [leaf for leaf, f in zip(leaves, floating, strict=True) if not f])
    values = report["mu"] if chosen else values
    found = report.pop("energy"), report.pop("pressure")
    energy, pressure = known(energies_and_pressures, found, x, model, gel, values, loads)
    report = {name: column for name, column in report.items() if name not in ("apart", "fixed", "mu")}
    return Path(model=model, gel=gel, mu=values, x=x, pressure=pressure, energy=energy, stop=None, stop_text="", **report)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _states(static, floats, rest):
    """Equilibria (k, n, 2) and what is known of them, see ``scan_states``."""
    inputs = static.join(floats, rest)
    if is_traced(inputs):
        if static.chosen is not None:
            raise ValueError("mu: chosen steps cannot be found inside jit or vmap; give a list of values")
        return scan_states(*inputs, static.contact)
    model, gel, mu, loads = inputs
    apart, fixed = [], []

    def keep(step):
        remember(step.factor, step.x)
        apart.append(bool(step.apart))
        fixed[:] = [step.fixed]

    options = dict(branch=static.branch, contact=static.contact, loads=loads, max_steps=static.max_steps)
    path = sweep(model, gel, mu=static.chosen or list(np.asarray(mu)), on_step=keep, **options)
    return columns(path, path.mu if static.chosen is not None else mu, apart, fixed[0], static.contact)


@functools.partial(_states.defjvp, symbolic_zeros=True)
def _states_jvp(static, primals, tangents):
    """The rule of ``implicit.state_tangents`` at every state; what is reported of the states has no derivative."""
    floats, rest = primals
    x, report = _states(static, floats, rest)
    warn(report, static.branch)
    model, gel, mu, loads = static.join(floats, rest)
    zeros = [np.zeros(np.shape(leaf), dtype=jax.dtypes.float0) for leaf in rest]
    none = jnp.zeros if is_traced(primals) else np.zeros  # NumPy's need no program each
    floats_dot = [none(t.shape, t.dtype) if isinstance(t, SymbolicZero) else t for t in tangents[0]]
    model_dot, gel_dot, mu_dot, loads_dot = static.join(floats_dot, zeros)
    if static.chosen is not None:
        mu, mu_dot = report["mu"], jnp.zeros_like(report["mu"])
    if model.contact is not None and not is_traced(report) and np.all(report["apart"]):
        model, model_dot = (dataclasses.replace(m, contact=None) for m in (model, model_dot))  # no energy and no derivative, but a cost
    pattern = tangent_pattern(model.lists, free_dofs(model.lists.topology), model.contact, model.solver)
    inputs, inputs_dot = (model, gel, mu, loads), (model_dot, gel_dot, mu_dot, loads_dot)
    x_dot = state_tangents(x, report["pressure"], inputs, inputs_dot, pattern, report["fixed"])
    return (x, report), (x_dot, jax.tree.map(SymbolicZero.from_primal_value, report))
