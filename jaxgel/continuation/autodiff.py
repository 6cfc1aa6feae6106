"""A sweep as a JAX function: inside ``jit`` and ``vmap``, and its derivatives.

Outside JAX's transformations the states are those of `follow`, and their factors serve the derivatives. Inside ``jit`` and ``vmap`` they
are one traced loop; their inertia, lowest eigenvalue and crossing outlines are found on the host.
"""

import dataclasses
import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .._threads import few_threads
from .._types import Array, Float
from ..controls import Control, check_values, control_name, unit_of
from ..discretisation import Model
from ..equilibrium import (
    StateNotFound,
    Status,
    dry_state,
    for_derivatives,
    no_tangents,
    remedy,
    solve_traced,
    state_tangents,
    with_derivatives_of,
)
from ..linalg import SingularTangent, extreme_eigenvalues, factor, network_matrix, remember
from ..materials import LocalGel
from ..mechanics import (
    Problem,
    crosses,
    linearise,
    outline_arcs,
    overlaps,
    prepare,
    state_pressure,
    tangent,
    total_energy,
    walls,
)
from .follow import Followed, Following
from .options import check_sweep
from .path import Path

WITHOUT_DERIVATIVES = {
    "lowest_eigenvalue": "path.lowest_eigenvalue: the attribute has no derivative; use jaxgel.continuation.lowest_eigenvalue(path)",
    "residual": "path.residual: the residual of a converged state is round-off and has no derivative; use path.energy or path.x",
}


class SweepFailed(StateNotFound):
    """Not even the first state of a sweep was found; the text says why."""


class IllPosedDerivative(UserWarning):
    """A sweep is differentiated at a state without a meaningful derivative: nearly singular, in self-contact, or not reached."""


def is_traced(tree: object) -> bool:
    """Whether any leaf of the pytree is a JAX tracer."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


@dataclasses.dataclass(frozen=True)
class _Static:
    """What identifies a traced sweep besides its arrays; hashable."""

    structure: object
    """Tree structure of (model, gel, control, values, loads)."""
    floating: tuple
    """Which leaves are floating-point arrays, that is differentiable."""
    ends: tuple | None
    """First and last value of adaptive steps, with turning points; None for given values."""
    options: Following
    """How the branch is followed."""

    def join(self, floats, rest):
        """(model, gel, control, values, loads) from the two kinds of leaves."""
        floats, rest = iter(floats), iter(rest)
        return jax.tree.unflatten(self.structure, [next(floats) if f else next(rest) for f in self.floating])


def traced_sweep(
    model: Model, gel: LocalGel, control: Control | None, values: object, loads: Float[Array, "n 2"] | None, options: Following
) -> Path:
    """`sweep` under differentiation, jit or vmap; states that are not reached are nan, with their status.

    Differentiation flags, and warns of, states without a meaningful derivative (`IllPosedDerivative`).
    """
    if options.adaptive and is_traced(values):
        ends = "(first, last)"
        raise ValueError(f"{control_name(control)}: chosen steps need concrete numbers {ends}; differentiate by a list of values instead")
    gel, control = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), (gel, control))
    loads = jnp.asarray(np.zeros((model.n_nodes, 2)) if loads is None else loads, dtype=float)
    given = jnp.zeros(0) if options.adaptive else jnp.atleast_1d(jnp.asarray(values, dtype=float))
    leaves, structure = jax.tree.flatten((model, gel, control, given, loads))
    floating = tuple(jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in leaves)
    static = _Static(structure, floating, tuple(map(float, values)) if options.adaptive else None, options)
    floats = [leaf for leaf, f in zip(leaves, floating, strict=True) if f]
    x, report = _states(static, floats, [leaf for leaf, f in zip(leaves, floating, strict=True) if not f])
    given = report["value"] if options.adaptive else given
    found = report.pop("energy"), report.pop("pressure"), report["mu"]
    energy, pressure, mu = with_derivatives_of(_of_states, found, x, Problem(model, gel, loads, None, control), given)
    report = {name: column for name, column in report.items() if name not in ("contact_active", "operators", "mu", "value")}
    mu = given if control is None else mu
    return Path(model=model, gel=gel, mu=mu, value=given, control=control, x=x, pressure=pressure, energy=energy, **report)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _states(static, floats, rest):
    """Equilibria (k, n, 2) and their report, a dict (k,) of value, mu, status, newton_iterations, residual, negative_pivots,
    lowest_eigenvalue, switched, contact_active and energy, of the pressure (k, g), and of the
    `mechanics.Operators` of the model.
    """
    inputs = static.join(floats, rest)
    if is_traced(inputs):
        if static.ends is not None:
            raise ValueError(f"{control_name(inputs[2])}: chosen steps cannot be found inside jit or vmap; give a list of values")
        return _scanned(*inputs, static.options)
    model, gel, control, values, loads = inputs
    values = check_values(static.ends or list(np.asarray(values)), control_name(control), unit_of(control)).numbers
    problem = prepare(model, gel, loads, control=control)
    check_sweep(problem, values)
    with few_threads(2 * model.n_nodes):
        followed = Followed(problem, values.tolist(), static.options)
        states = followed.light_states(lambda state: remember(state.factor, state.x))
    if not states:
        raise first_state_failed(model, control, values[0], followed.stop)
    values = np.array([state.value for state in states]) if static.ends else values
    return _columns(problem, states, followed.stop, values, static.options)


@functools.partial(_states.defjvp, symbolic_zeros=True)
def _states_jvp(static, primals, tangents):
    """The rule of `equilibrium.state_tangents` at every state; the numbers of the report have no derivatives."""
    floats, rest = primals
    x, report = _states(static, floats, rest)
    model, gel, control, values, loads = static.join(floats, rest)
    _warn_of_ill_posed(report, static.options.branch, control_name(control))
    zeros = [np.zeros(np.shape(leaf), dtype=jax.dtypes.float0) for leaf in rest]
    none = jnp.zeros if is_traced(primals) else np.zeros  # NumPy's need no program each
    floats_dot = [none(t.shape, t.dtype) if isinstance(t, SymbolicZero) else t for t in tangents[0]]
    model_dot, gel_dot, control_dot, values_dot, loads_dot = static.join(floats_dot, zeros)
    if static.ends is not None:
        values, values_dot = report["value"], jnp.zeros_like(report["value"])
    problem = Problem(model, gel, loads, report["operators"], control)
    problem_dot = Problem(model_dot, gel_dot, loads_dot, None, control_dot)
    if problem.has_contact and not is_traced(report) and not np.any(report["contact_active"]):
        problem, problem_dot = problem.without_contact, problem_dot.without_contact  # no energy and no derivative, but a cost
    x_dot = state_tangents(x, report["pressure"], problem, values, problem_dot, values_dot)
    report_dot = jax.tree.map(SymbolicZero.from_primal_value, report)
    report_dot |= {name: no_tangents(report[name], [x_dot], text) for name, text in WITHOUT_DERIVATIVES.items()}
    return (x, report), (x_dot, report_dot)


def first_state_failed(model: Model, control: Control | None, value: float, status: Status) -> SweepFailed:
    """The error of a sweep whose first state was not found."""
    what = f"sweep: no equilibrium at {control_name(control)} = {value:.6g}: {status.text}"
    return SweepFailed(what + (remedy(model, status) if control is None else ""))


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, None, 0))
def _of_states(x, problem, value):
    """Total energy (k,), pressures (k, g) and mu (k,) of the states ``x`` (k, n, 2) at ``value`` (k,), in one program."""
    now, mu = problem.at(value)
    return total_energy(x, now.model, now.gel, mu, now.loads), state_pressure(x, now.model, now.gel, mu), mu


# --- outside jit -------------------------------------------------------------------------------------------------------------


def _columns(problem, states, stop, values, options):
    """States (k, n, 2) and report of `_states` that were asked for at ``values`` (k,); nan where they were not reached.

    The statuses of states without a meaningful derivative say so.
    """
    path, missing = Path.from_states(problem.model, problem.gel, states), len(values) - len(states)
    eigenvalues = zip(path.status, path.lowest_eigenvalue, path.x, strict=True)
    contact = options.contact == "on"
    touching = np.array([state.contact_active is not False for state in states])
    status = [for_derivatives(s, e, crossing=not contact and overlaps(x, problem.model), contact=contact) for s, e, x in eigenvalues]

    def pad(values, fill):  # in NumPy: nothing is compiled
        return jax.device_put(np.concatenate([values, np.full((missing, *np.shape(values)[1:]), fill)]))

    return pad(path.x, jnp.nan), dict(
        value=jnp.asarray(values),
        mu=jnp.asarray(values) if problem.control is None else pad(path.mu, jnp.nan),
        status=pad(np.array(status, dtype=int), int(stop)),
        newton_iterations=pad(path.newton_iterations, 0),
        residual=pad(path.residual, jnp.nan),
        negative_pivots=pad(path.negative_pivots, -1),
        lowest_eigenvalue=pad(path.lowest_eigenvalue, jnp.nan),
        switched=pad(path.switched, False),
        contact_active=pad(touching, False),
        operators=problem.operators,
        energy=pad(path.energy, jnp.nan),
        pressure=pad(path.pressure, jnp.nan),
    )


def _warn_of_ill_posed(report, branch, name):
    """Warn (`IllPosedDerivative`) of every state whose derivative is ill-posed; inside jit when the program runs."""
    asked = {key: report[key] for key in ("value", "status", "negative_pivots")}
    if is_traced(asked):
        jax.debug.callback(functools.partial(_warn, branch=branch, name=name), **asked)
    else:
        _warn(**asked, branch="symmetric", name=name)  # a sweep outside jit has tried to leave an unstable branch


def _warn(value, status, negative_pivots, branch, name):
    status, unstable = np.asarray(status), (np.asarray(negative_pivots) > 0) & (branch == "stable")
    texts = [(Status(int(s)).text, status == s) for s in np.unique(status[status != Status.CONVERGED])]
    texts.append(("the state is unstable, and inside jit or vmap no branch is left", unstable & (status == Status.CONVERGED)))
    for text, where in texts:
        if np.any(where):
            at = ", ".join(f"{one:.6g}" for one in np.asarray(value)[where])
            warnings.warn(f"sweep: ill-posed derivative at {name} = {at}: {text}", IllPosedDerivative, stacklevel=3)


# --- inside jit and vmap -----------------------------------------------------------------------------------------------------


def _scanned(model, gel, control, values, loads, options):
    """States and report of `_states` as one traced loop; linear extrapolation between states.

    The branch that continues the dry state is followed whatever its stability; states that are not reached are nan.
    """
    problem = prepare(model, gel, loads, control=control)
    start, pressure = dry_state(problem, values[0])

    def step(carry, value):
        (value_1, x_1, p_1), (value_2, x_2, p_2), count = carry
        apart = (count > 1) & (value_1 != value_2)
        ratio = jnp.where(apart, (value - value_1) / jnp.where(apart, value_1 - value_2, 1.0), 0.0)
        x, p, report = solve_traced(problem, value, x_1 + ratio * (x_1 - x_2), p_1 + ratio * (p_1 - p_2))
        report |= _examined(problem, value, x, p, report["status"], options.contact)
        x = jnp.where(report["status"] == Status.CROSSED, jnp.nan, x)
        return ((value, x, p), (value_1, x_1, p_1), count + 1), (x, p, report)

    _, (x, _, report) = jax.lax.scan(step, ((values[0], start, pressure),) * 2 + (0,), values)
    report |= dict(zip(("energy", "pressure", "mu"), _of_states(x, problem, values), strict=True))
    many = values.shape
    flags = dict(switched=jnp.zeros(many, dtype=bool), contact_active=jnp.ones(many, dtype=bool))
    return x, dict(report, value=values, operators=problem.operators, **flags)


def _examined(problem, value, x, p, status, contact):
    """Status, negative_pivots and lowest_eigenvalue of one traced state (n, 2), by a factor of its own tangent on the host."""
    network = problem.operators.network
    problem, mu = problem.at(value)
    now = linearise(problem, x, p, mu)
    patterns = problem.pattern, problem.without_contact.pattern
    examine = functools.partial(_examine, patterns, contact)
    shapes = tuple(jax.ShapeDtypeStruct((), dtype) for dtype in (status.dtype, int, float))
    arrays = status, x, tangent(problem, x, p, now), network, outline_arcs(x, problem.model), walls(x, problem.model.lists.topology)
    found = jax.pure_callback(examine, shapes, *arrays, vmap_method="sequential")
    return dict(zip(("status", "negative_pivots", "lowest_eigenvalue"), found, strict=True))


def _examine(patterns, contact, status, x, pairs, network, arcs, held):
    """`_examined` on the host; the factor serves the derivatives of the state, see `linalg.solve_near`."""
    if status != Status.CONVERGED:
        return status, np.asarray(-1), np.asarray(np.nan)
    try:
        made = factor(patterns[0], pairs)
        remember(made, x)
        lowest, nearest = extreme_eigenvalues(made, network_matrix(patterns[1], network))
        negative = made.negative_pivots
    except SingularTangent:
        negative, lowest, nearest = -1, 0.0, 0.0
    crossing = crosses([np.asarray(arc) for arc in arcs], np.asarray(held))
    flagged = for_derivatives(Status.CONVERGED, nearest, crossing=crossing, contact=contact == "on")
    return np.asarray(int(flagged), dtype=status.dtype), np.asarray(negative), np.asarray(lowest)
