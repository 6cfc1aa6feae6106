"""Common interface to the optimisers: searches over scaled designs in [0, 1]^n.

Methods of optax and L-BFGS-B take constraints g >= 0 by an augmented Lagrangian, f + sum (max(0,
lambda - rho g)^2 - lambda^2) / (2 rho) (Nocedal & Wright 2006, section 17.4): it is smooth, needs
one reverse pass for all constraints together, and allows an infeasible start. A line search of
optax evaluates designs of its own, each logged and counted. SLSQP and MMA take constraints
directly. Bounds are kept by projection (optax) or natively: unlike a sigmoid they can be reached,
and do not flatten the objective near them.

The quasi-Newton methods work in boxes around the best design, the move limits of structural
optimisation: an invalid design halves the box, so that the method's model of the objective never
rests on a design without a value.
"""

import functools
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from .._types import Array, Float
from .lagrangian import MARGIN, PENALTY, SHORTEST, Invalid, Lagrangian, Stalled, Stuck
from .problem import violation
from .transformations import first_order

METHODS = ("slsqp", "mma", "lbfgs", "adam")
MOST_DENSE = 500  # parameters of SLSQP, whose steps take the cube of their number
LEARNING_RATE = 0.02  # of adam, in scaled parameters
INNER = 50  # iterations of a quasi-Newton method in one box
# that MMA adds at first: from 1, its own, it shrinks in steps so short that they would count as
# converged
CURVATURE = 1e-4
# step of a quasi-Newton method, in scaled parameters, that leaves the design as it was
STALLED = 1e-6


def optimiser(method: Any, step: float, tolerance: float) -> Callable:
    """Function of a search that runs ``method``, of ``METHODS`` or an optax transformation.

    A GradientTransformation; ValueError for others.
    """
    import optax  # slow to import, and only searches need it

    if isinstance(method, optax.GradientTransformation):
        return functools.partial(first_order, transformation=method, step=step)
    if method == "adam":
        return functools.partial(first_order, transformation=optax.adam(LEARNING_RATE), step=step)
    if method == "mma" and importlib.util.find_spec("nlopt") is None:
        raise ValueError("method: 'mma' needs nlopt; install it with pip install 'jaxgel[mma]'")
    if method == "lbfgs":
        return functools.partial(lbfgs, step=step, tolerance=tolerance)
    solve = {"slsqp": slsqp, "mma": mma}.get(method) if isinstance(method, str) else None
    if solve is None:
        raise ValueError(
            f"method: {method!r} is neither one of {', '.join(METHODS)} nor an optax "
            "GradientTransformation"
        )
    return functools.partial(in_boxes, solve=solve, step=step, tolerance=tolerance)


def lbfgs(search: Any, *, step: float, tolerance: float) -> None:
    """SciPy's L-BFGS-B on the augmented Lagrangian in boxes of half-width ``step``.

    The multipliers are updated after each box. It ends if the Lagrangian no longer falls and the
    constraints are met.
    """
    centre, reach, lagrangian = search.start, step, None
    while reach >= SHORTEST * step:
        here = search.settle(centre)
        lagrangian = lagrangian or Lagrangian(len(here.values) - 1)
        low, high = np.maximum(centre - reach, 0.0), np.minimum(centre + reach, 1.0)

        def value_and_gradient(v, worth=lagrangian):
            there = search.at(v)
            return worth.value(there.values), there.gradient(worth.weights(there.values))

        options = dict(
            bounds=np.stack([low, high], axis=1),
            method="L-BFGS-B",
            options=dict(ftol=tolerance, maxiter=INNER),
        )
        try:
            scipy.optimize.minimize(value_and_gradient, centre, jac=True, **options)
            failed = False
        except Invalid:
            failed = True
        best = search.best(lambda entry, worth=lagrangian: worth.value(np.array(entry["values"])))
        fall = lagrangian.value(here.values) - lagrangian.value(np.array(best["values"]))
        centre = np.array(best["vector"])
        lagrangian.update(np.array(best["values"]))
        if failed:
            reach *= 0.5
        elif fall <= tolerance and lagrangian.violation < 2 * MARGIN:
            return
    raise Stuck


def in_boxes(search: Any, *, solve: Callable, step: float, tolerance: float) -> None:
    """Run ``solve(search, centre, low, high, tolerance)`` in boxes until none is better.

    They have the half-width ``step`` and lie around the best design. Designs compare by objective +
    PENALTY * violation, so that a box may end next to a constraint and the following one meet it. A
    design that violates one by more than the ``tolerance``, as SLSQP itself has it, is no optimum:
    `Stuck`.
    """
    centre, reach = search.start, step
    while reach >= SHORTEST * step:
        here = search.settle(centre)
        low, high = np.maximum(centre - reach, 0.0), np.minimum(centre + reach, 1.0)
        failed = stalled = False
        try:
            solve(search, centre, low, high, tolerance)
        except Invalid:
            failed = True
        except Stalled:
            stalled = True
        best = search.best(_merit)
        centre, better = np.array(best["vector"]), _merit(here.entry) - _merit(best) > tolerance
        inside = np.all((centre > low) | (low == 0)) and np.all((centre < high) | (high == 1))
        if (
            inside
            and not better
            and not failed
            and not stalled
            and violation(best["values"][1:]) <= tolerance
        ):
            return
        if failed or not better:
            reach *= 0.5
    raise Stuck


def _merit(entry):
    """Objective and penalty of a logged design."""
    return entry["values"][0] + PENALTY * violation(entry["values"][1:])


def slsqp(
    search: Any,
    centre: Float[Array, " d"],
    low: Float[Array, " d"],
    high: Float[Array, " d"],
    tolerance: float,
) -> None:
    """SciPy's sequential quadratic programming in a box.

    `Stalled` if its line search shrinks on, as between constraints at odds.
    """
    here = search.at(centre)

    def at(v):
        nonlocal here
        moved = np.abs(v - here.vector).max()
        if 0 < moved < STALLED:
            raise Stalled
        here = search.at(v) if moved else here
        return here

    constraints = []
    if len(here.values) > 1:
        constraints = [
            {
                "type": "ineq",
                "fun": lambda v: at(v).values[1:],
                "jac": lambda v: at(v).jacobian()[1:],
            }
        ]
    scipy.optimize.minimize(
        lambda v: at(v).values[0],
        centre,
        jac=lambda v: at(v).jacobian()[0],
        bounds=np.stack([low, high], axis=1),
        constraints=constraints,
        method="SLSQP",
        options=dict(ftol=tolerance, maxiter=INNER),
    )


def mma(
    search: Any,
    centre: Float[Array, " d"],
    low: Float[Array, " d"],
    high: Float[Array, " d"],
    tolerance: float,
) -> None:
    """The method of moving asymptotes of nlopt (Svanberg 2002) in a box."""
    import nlopt

    solver = nlopt.opt(nlopt.LD_MMA, len(centre))
    solver.set_lower_bounds(low)
    solver.set_upper_bounds(high)
    raised = []

    def guarded(function):
        @functools.wraps(function)
        def call(*args):
            try:
                return function(*args)
            except BaseException as problem:
                raised.append(problem)
                raise

        return call

    @guarded
    def objective(v, gradient):
        here = search.at(v)
        if gradient.size:
            gradient[:] = here.jacobian()[0]
        return float(here.values[0])

    @guarded
    def constraints(result, v, gradient):
        here = search.at(v)
        result[:] = -here.values[1:]
        if gradient.size:
            gradient[:] = -here.jacobian()[1:]

    solver.set_min_objective(objective)
    count = len(search.at(centre).values) - 1
    if count:
        solver.add_inequality_mconstraint(constraints, np.full(count, 1e-8))
    solver.set_param("rho_init", CURVATURE)
    solver.set_ftol_abs(tolerance)
    solver.set_maxeval(INNER)
    try:
        solver.optimize(centre)
    # the last is nlopt's own failure without a reason
    except (nlopt.ForcedStop, nlopt.RoundoffLimited, RuntimeError):
        if raised:
            raise raised[0] from None
        raise Stuck from None
