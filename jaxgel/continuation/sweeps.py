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

from .._threads import few_threads
from ..equilibrium import Step, advice, known, prepare, prepare_incremental, prepare_walls, state_tangents
from ..linalg import remember
from ..materials import check_gel
from ..mechanics import check_room, free_dofs, tangent_pattern, with_contact
from .autodiff import columns, energies_and_pressures, is_traced, scan_states, warn
from .follow import SweepFailed, _attempt, _incremental_attempt, _until_contact, _weak_attempt
from .options import BRANCHES, CONTACT, FORMULATIONS, MAX_STEPS, check_mu
from .path import Path
from .stability import network_stiffness
from .steps import _chosen, _given


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
