"""A sweep that JAX differentiates: the states of `follow`, their factors for derivatives."""

import dataclasses
import functools
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .._compiled import tangents as tangents_of
from .._primitives import differentiated_value
from .._programs import fitted
from .._tracing import is_traced
from ..controls import check_values
from ..equilibrium import Status, no_tangents, state_tangents
from ..linalg import RECENT_FACTORS
from ..mechanics import Problem, shared_tangents, state_pressure, total_energy, touching_tangents
from ..symmetry import NAMES
from .follow import Followed, Following
from .frames import group_of_sweep
from .options import check_sweep
from .path import Path
from .steps import Adaptive
from .traced import check_for_program, pattern_in_program, states_in_program
from .traced_search import RESIDUAL, TracedSearch, padded_columns

# what is a function of the states: its axes
OF_STATES = {"energy": "k", "pressure": "kg", "mu": "kg"}
WITHOUT_DERIVATIVES = {
    "lowest_eigenvalue": (
        "path.lowest_eigenvalue: the attribute has no derivative; use "
        "jaxgel.continuation.lowest_eigenvalue(path)"
    ),
    "residual": RESIDUAL,
}
COLUMNS = (
    *OF_STATES,
    *WITHOUT_DERIVATIVES,
    "x",
    "status",
    "derivative",
    "newton_iterations",
    "negative_pivots",
    "switched",
)
INSIDE_JIT = (
    "problem: is not accepted as an argument of jax.jit or jax.vmap; make it inside, from numbers "
    "that are"
)


class IllPosedDerivative(UserWarning):
    """Warning that a state of a sweep is differentiated which has no meaningful derivative.

    The state is nearly singular, in self-contact, or was not reached.
    """


def traced_sweep(problem: Problem, values: object, options: Following) -> Path:
    """`sweep` under differentiation; states that are not reached are nan, with their status.

    Flags, and warns of, states without a meaningful derivative (`IllPosedDerivative`).
    """
    ends = values if isinstance(values, Adaptive) else None
    given = jnp.zeros(0) if ends else jnp.atleast_1d(jnp.asarray(values, dtype=float))
    inputs, options = (
        (problem.replace(operators=None), given),
        dataclasses.replace(options, eigenvalues=True),
    )
    concrete, own = jax.tree.map(differentiated_value, inputs), ()
    if is_traced(concrete):
        own = group_of_sweep(concrete[0], options.symmetry)
    search, floats = TracedSearch.of(inputs, (ends, options, own), INSIDE_JIT)
    x, report = _states(search, floats)
    value = report["value"] if ends else given
    found = search.found
    if not found:  # in a program what was not reached has the last state in its place
        ok = report["status"] == Status.CONVERGED
        report |= {
            name: jnp.where(ok.reshape(-1, *[1] * (report[name].ndim - 1)), report[name], jnp.nan)
            for name in OF_STATES
        }
        x = jnp.where(ok[:, None, None], x, jnp.nan)
        found = {"symmetry": (NAMES[own],) * len(value)}
    report = {name: column for name, column in report.items() if name not in ("operators", "value")}
    return Path(problem=problem, value=value, x=x, **report, **found)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _states(search, floats):
    """Equilibria (k, n, 2) and their report, a dict (k,), pressure and `mechanics.Operators`.

    The report has the columns of a `Path`; the pressure is (k, g); the operators are those of the
    model.
    """
    problem, values = inputs = search.inputs(floats)
    ends, options, own = search.options
    if is_traced(inputs):
        check_for_program(options, chosen=ends is not None)
        return states_in_program(problem, values, options.newton, own)
    control = problem.control
    values = check_values(ends.values if ends else np.asarray(values), control.name, control.unit)
    check_sweep(problem, values)
    problem = problem.prepared
    followed = Followed(problem, ends or values.tolist(), options)
    states = followed.light_states(lambda state: _keep_factor(problem, state))
    path = Path.from_states(problem, states, stop=followed.stop, stop_text=followed.stop_text)
    search.found.update(symmetry=path.symmetry, stop=path.stop, stop_text=path.stop_text)
    values = path.value if ends else values
    report = padded_columns(path, COLUMNS, len(values) - len(path))
    return report.pop("x"), report | {"value": jnp.asarray(values), "operators": problem.operators}


def _keep_factor(problem, state):
    gel = problem.at(state.value)[0].gel  # two networks may have the same positions and pressures
    RECENT_FACTORS.add(state.factor, problem.model.lists, (state.x, state.pressure, gel))


@functools.partial(_states.defjvp, symbolic_zeros=True)
def _states_jvp(search, primals, tangents):
    """The rule of `equilibrium.state_tangents` at every state.

    The numbers of the report have no derivatives.
    """
    (floats,) = primals
    x, report = _states(search, floats)
    problem, values = search.inputs(floats)
    in_program = not search.found
    if not in_program:
        warn_of_ill_posed(report, problem.control.name)
    problem_dot, values_dot = search.tangents(tangents[0])
    ends, _, own = search.options
    if ends or in_program:
        values = report["value"]
        values_dot = jnp.zeros_like(values) if ends else values_dot
    problem = problem.replace(operators=report["operators"])
    touched = [() if in_program else np.asarray(differentiated_value(part)) for part in (x, values)]
    problem, problem_dot = touching_tangents(problem, problem_dot, *map(list, touched))
    shared, shared_dot = shared_tangents(problem, problem_dot)
    x_dot = state_tangents(
        x,
        report["pressure"],
        problem,
        values,
        shared,
        shared_dot,
        values_dot,
        pattern=pattern_in_program(problem, own) if in_program else None,
    )
    found = tuple(fitted(report[name], axes, shared.lengths) for name, axes in OF_STATES.items())
    leaves, structure = jax.tree.flatten((fitted(x, "kn", shared.lengths), shared, values))
    dots = [
        None if dot.dtype == jax.dtypes.float0 else dot
        for dot in jax.tree.leaves((x_dot, shared_dot, values_dot))
    ]
    dots = tangents_of(_OfStates(structure), leaves, dots, found)
    x_dot = fitted(x_dot, "kn", problem.lengths)
    report_dot = jax.tree.map(SymbolicZero.from_primal_value, report)
    report_dot |= {
        name: fitted(dot, axes, problem.lengths)
        for dot, (name, axes) in zip(dots, OF_STATES.items(), strict=True)
    }
    report_dot |= {
        name: no_tangents(report[name], [x_dot], text) for name, text in WITHOUT_DERIVATIVES.items()
    }
    return (x, report), (x_dot, report_dot)


@dataclasses.dataclass(frozen=True)
class _OfStates:
    """Energy (k,), pressures (k, g) and mu (k,) of states, of the leaves of x, problem, values.

    These are (x (k, n, 2), problem, values (k,)).
    """

    structure: object
    """Tree structure of the leaves."""

    def __call__(self, *leaves):
        x, problem, values = jax.tree.unflatten(self.structure, leaves)

        def of_state(x, value):
            now, mu = problem.at(value)
            return [
                total_energy(x, now.model, now.gel, mu, now.loads),
                state_pressure(x, now.model, now.gel, mu),
                mu,
            ]

        return jax.vmap(of_state)(x, values)


def warn_of_ill_posed(report: dict[str, Any], name: str, verb: str = "sweep") -> None:
    """Warn (`IllPosedDerivative`) of every state whose derivative is ill-posed.

    Of those that `jax.vmap` wraps once they are unwrapped.
    """
    warn = functools.partial(_warn, name, verb)
    if is_traced(report):
        jax.debug.callback(warn, report["value"], report["derivative"])
    else:
        warn(report["value"], report["derivative"])


def _warn(name, verb, values, status):
    values, status = np.asarray(values), np.asarray(status)
    for one in np.unique(status[status != Status.CONVERGED]):
        at = ", ".join(f"{value:.6g}" for value in values[status == one])
        warnings.warn(
            f"{verb}: ill-posed derivative at {name} = {at}: {Status(int(one)).text}",
            IllPosedDerivative,
            stacklevel=3,
        )
