"""Transient swelling that JAX differentiates: states of `run`, derivatives by marching.

They march on their own.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .._compiled import compiled
from .._primitives import differentiated_value
from .._programs import fitted
from .._sizes import resized, taken
from .._tracing import is_traced, value_and_tangents
from ..continuation import (
    OF_SOLVENT,
    RESIDUAL,
    SCALARS,
    Path,
    TracedSearch,
    padded_columns,
    warn_of_ill_posed,
)
from ..equilibrium import Newton, Observer, first_order_only, no_tangents
from ..mechanics import Bath as Instant
from .bath import Bath, Time, moved_times, values_of
from .derivatives import March, stage_tangents, stages_of
from .march import GAMMA, jump_share
from .problem import Transport
from .run import Start, check_numbers, check_swelling, run

COLUMNS = {"x": "kn", "energy": "k", "pressure": "kg", "potential": "kg", "supplied": "kb"}
"""What is a function of the states: its axes."""
INSIDE_JIT = (
    "swell: is not available inside jax.jit or jax.vmap, as it cuts its steps on the way; take "
    "jax.grad or jax.jvp outside of them"
)
OF_PATH = {*SCALARS, "derivative", "x", "pressure", *OF_SOLVENT} - {"value", "mu"}


def traced_swell(
    transport: Transport,
    start: Start,
    baths: Sequence[Bath],
    times: Sequence[float],
    time: Time,
    branch: str,
    newton: Newton,
    observer: Observer,
) -> Path:
    """`swell` under differentiation.

    States that are not reached are nan, with the status of the run.
    """
    problem = transport.problem.replace(operators=None)
    inputs = (
        dataclasses.replace(transport, problem=problem),
        [(bath.mu, bath.times) for bath in baths],
        start,
    )
    options = tuple(times), jax.tree.map(differentiated_value, time), branch, newton, observer
    search, floats = TracedSearch.of(inputs, options, INSIDE_JIT)
    report = _states(search, floats)
    t = moved_times(np.array([0.0, *times]), baths, [bath.numbers for bath in baths])
    mu = _mean_mu(t, inputs[1], start.mean(problem.model))
    return Path(
        problem=problem.replace(control=time), value=t, mu=mu, **report, **search.found["end"]
    )


@compiled()
def _mean_mu(t, tables, at_start):
    """Mean of mu (k,) of all baths, of (mu, times) each, at the times ``t`` (k,).

    The first one is that ``at_start``.
    """
    values = [Bath(*map(jnp.asarray, table)).at(t[1:]) for table in tables]
    return jnp.append(at_start, jnp.mean(jnp.stack(values), axis=0))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _states(search, floats):
    """The columns of a `Path`, a dict; nan for states that were not reached."""
    inputs = search.inputs(floats)
    if is_traced(inputs):
        raise ValueError(INSIDE_JIT)
    transport, tables, start = inputs
    baths = [Bath(*map(np.asarray, table)) for table in tables]
    check_swelling(transport.problem)
    check_numbers(transport.problem, baths, transport.D)
    transport = dataclasses.replace(
        transport, problem=transport.problem.prepared, D=float(transport.D)
    )
    path, first, steps = run(transport, Start(*map(np.asarray, start)), baths, *search.options)
    before, after = (np.array([getattr(step, name) for step in steps]) for name in ("start", "end"))
    times = before, after, [np.asarray(times) for _, times in tables]
    march = March(
        transport, stages_of(first, steps, *_scheduled(*times, tables, start.mean(transport.model)))
    )
    end = {"symmetry": path.symmetry, "stop": path.stop, "stop_text": path.stop_text}
    search.found.update(
        march=march,
        times=times,
        rows=2 * np.append(0, 1 + np.searchsorted(after, path.t[1:])),
        end=end,
    )
    return padded_columns(path, OF_PATH, 1 + len(search.options[0]) - len(path))


@compiled()
def _scheduled(before, after, numbers, tables, at_start):
    """Stage lengths (S,) of steps between times, and baths (S, b) at their ends.

    Each step is between two times; the baths are by (mu, times) of each.
    """
    baths = [Bath(*map(jnp.asarray, table)) for table in tables]
    before, after = (moved_times(t, baths, numbers) for t in (before, after))
    dt = after - before
    t = jnp.stack([before + GAMMA * dt, after], axis=1).ravel()
    share = jnp.repeat(jump_share(before, after), 2)
    return jnp.repeat(GAMMA * dt, 2), Instant(*values_of(baths, [at_start] * len(baths), t, share))


@functools.partial(_states.defjvp, symbolic_zeros=True)
def _states_jvp(search, primals, tangents):
    """By `stage_tangents` for all that has derivatives."""
    (floats,) = primals
    report = _states(search, floats)
    times, time, *_ = search.options
    warn_of_ill_posed({"value": np.array([0.0, *times])} | report, time.name, "swell")
    march, rows = search.found["march"], search.found["rows"]
    if not len(march.stages.tau):  # stopped before the first step
        return report, jax.tree.map(SymbolicZero.from_primal_value, report)
    inputs, dots = search.inputs(first_order_only(floats, "swell")), search.tangents(tangents[0])
    shared, shared_dot = value_and_tangents(
        lambda transport: _observed_by_none(transport).shared, inputs[0], dots[0]
    )

    model, stages, lengths = inputs[0].model, march.stages, shared.lengths
    schedule = functools.partial(_scheduled, *search.found["times"])
    tau_dot, bath_dot = jax.jvp(
        schedule, (inputs[1], inputs[2].mean(model)), (dots[1], dots[2].mean(model))
    )[1]
    at_start = {"x": dots[2].x, "m": dots[2].unknowns(model)}
    states = {
        name: resized(at_start[name][None], np.shape(getattr(stages, name))) for name in at_start
    }
    stages_dot = stages._replace(
        **states, pressure=np.zeros(stages.pressure.shape), tau=tau_dot, bath=bath_dot
    ).shared(lengths)
    nothing = np.zeros(len(stages_dot.end), jax.dtypes.float0)
    stages_dot = stages_dot._replace(end=nothing, first=nothing)
    found = stage_tangents(march, stages_dot, shared, shared_dot)
    report_dot = jax.tree.map(SymbolicZero.from_primal_value, report)
    for name, axes in COLUMNS.items():
        dot = fitted(taken(getattr(found, name), rows), axes, march.transport.lengths)
        report_dot[name] = resized(dot, (len(report[name]), *dot.shape[1:]))
    x_dot = report_dot["x"]
    return report, report_dot | {"residual": no_tangents(report["residual"], [x_dot], RESIDUAL)}


def _observed_by_none(transport):
    """Without the outline, on which no residual depends."""
    problem = transport.problem
    return dataclasses.replace(
        transport, problem=problem.replace(model=dataclasses.replace(problem.model, outline=None))
    )
