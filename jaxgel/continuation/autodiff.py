"""A sweep as a function that JAX differentiates: the states are those of `follow`, and their factors serve the derivatives."""

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
    for_derivatives,
    no_tangents,
    remedy,
    state_tangents,
    with_derivatives_of,
)
from ..linalg import remember
from ..materials import LocalGel
from ..mechanics import (
    Problem,
    overlaps,
    prepare,
    state_pressure,
    total_energy,
)
from .follow import Followed, Following
from .options import check_sweep
from .path import Path

WITHOUT_DERIVATIVES = {
    "lowest_eigenvalue": "path.lowest_eigenvalue: the attribute has no derivative; use jaxgel.continuation.lowest_eigenvalue(path)",
    "residual": "path.residual: the residual of a converged state is round-off and has no derivative; use path.energy or path.x",
}


INSIDE_JIT = (
    "sweep: is not available inside jax.jit or jax.vmap, as it chooses steps and branches on the way; call it, its jax.grad, jax.jvp or "
    "jax.value_and_grad outside, and loop over gels or plates"
)


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
    """`sweep` under differentiation; states that are not reached are nan, with their status.

    Flags, and warns of, states without a meaningful derivative (`IllPosedDerivative`).
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
        raise ValueError(INSIDE_JIT)
    model, gel, control, values, loads = inputs
    values = check_values(static.ends or list(np.asarray(values)), control_name(control), unit_of(control)).numbers
    problem = prepare(model, gel, loads, control=control)
    check_sweep(problem, values)
    with few_threads(2 * model.n_nodes):
        followed = Followed(problem, values.tolist(), static.options)
        states = followed.light_states(lambda state: remember(state.factor, state.x))
    if not states:
        raise first_state_failed(control, values[0], followed.stop)
    values = np.array([state.value for state in states]) if static.ends else values
    return _columns(problem, states, followed.stop, values, static.options)


@functools.partial(_states.defjvp, symbolic_zeros=True)
def _states_jvp(static, primals, tangents):
    """The rule of `equilibrium.state_tangents` at every state; the numbers of the report have no derivatives."""
    floats, rest = primals
    x, report = _states(static, floats, rest)
    model, gel, control, values, loads = static.join(floats, rest)
    _warn_of_ill_posed(report, control_name(control))
    zeros = [np.zeros(np.shape(leaf), dtype=jax.dtypes.float0) for leaf in rest]
    floats_dot = [np.zeros(t.shape, t.dtype) if isinstance(t, SymbolicZero) else t for t in tangents[0]]
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


def first_state_failed(control: Control | None, value: float, status: Status) -> SweepFailed:
    """The error of a sweep whose first state was not found."""
    what = f"sweep: no equilibrium at {control_name(control)} = {value:.6g}: {status.text}"
    return SweepFailed(what + (remedy(status) if control is None else ""))


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, None, 0))
def _of_states(x, problem, value):
    """Total energy (k,), pressures (k, g) and mu (k,) of the states ``x`` (k, n, 2) at ``value`` (k,), in one program."""
    now, mu = problem.at(value)
    return total_energy(x, now.model, now.gel, mu, now.loads), state_pressure(x, now.model, now.gel, mu), mu


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


def _warn_of_ill_posed(report, name):
    """Warn (`IllPosedDerivative`) of every state whose derivative is ill-posed; of those that `jax.vmap` wraps once they are unwrapped."""
    warn = functools.partial(_warn, name)
    if is_traced(report):
        jax.debug.callback(warn, report["value"], report["status"])
    else:
        warn(report["value"], report["status"])


def _warn(name, values, status):
    values, status = np.asarray(values), np.asarray(status)
    for one in np.unique(status[status != Status.CONVERGED]):
        at = ", ".join(f"{value:.6g}" for value in values[status == one])
        warnings.warn(f"sweep: ill-posed derivative at {name} = {at}: {Status(int(one)).text}", IllPosedDerivative, stacklevel=3)
