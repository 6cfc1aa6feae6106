"""Sweeps: equilibria at prescribed values of a control, or at adaptively chosen ones."""

from .._deprecated import old_arguments
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import Inadmissible, check_kind
from ..controls import check_values
from ..equilibrium import NEWTON, UNOBSERVED, Newton, Observer, State
from ..mechanics import Problem
from .autodiff import traced_sweep
from .follow import Followed, Following
from .options import check_sweep
from .path import Path
from .steps import STEP_CONTROL, Adaptive, StepControl

Values = list[Scalar] | tuple[Scalar, ...] | Float[Array, " k"] | Adaptive


@old_arguments
def sweep(
    problem: Problem,
    values: Values,
    *,
    branch: str = "stable",
    symmetry: str = "auto",
    eigenvalues: bool = False,
    until_contact: bool = False,
    start: State | None = None,
    newton: Newton = NEWTON,
    steps: StepControl = STEP_CONTROL,
    observer: Observer = UNOBSERVED,
) -> Path:
    """`Path` of equilibria of a problem at prescribed values of its control.

    Arguments:

    - `problem`: the `Problem`; its control decides the unit of the values.
    - `values` (k,): values of the control, of mu in kT by default; may rise and fall.
      `Adaptive(first, last)` in their place lets the sweep choose its steps.
    - `branch`: "stable" switches to the stable branch if the branch followed loses its stability;
      "symmetric" stays on it, as a perfectly symmetric cloud would.
    - `symmetry`: "auto" computes symmetric states on a fundamental region of the plate (see
      `symmetry`): the same states in less time; "off" does not. Inside `jax.jit` and `jax.vmap` it
      uses those that are known without the values of their arguments. The name of a group, as "C4",
      says that the sheets have it: one that has not is nan there, with the status ASYMMETRIC.
    - `eigenvalues`: whether to compute `path.lowest_eigenvalue` of every state.
    - `until_contact`: whether a sweep without contact ends if the sides of a hole overlap.
    - `start`: a `State` to continue from, at another value than the first one; by default the first
      state is computed from the dry state.
    - `newton`, `steps`: tolerances of Newton's method, step control.
    - `observer`: functions called at every step.

    Returns the path. `path.negative_pivots` is 0 for a stable state, from a factorisation of its
    own tangent. With contact in the problem a stable branch that ends, or turns unstable, is left
    by relaxation; `path.switched` gives the reason if a state does not continue those before it.
    Later failures end the path early, with the reason in `path.stop` and `path.stop_text`. Inside
    `jax.jit` and `jax.vmap` a sweep is one program, for given values and without contact: if the
    branch loses stability or touches itself the states are nan from there on, with their status.

    Raises `ValueError` for an unusable gel, control or values, `SweepFailed` if the first state is
    not found. Warns (`IllPosedDerivative`) if a state without a meaningful derivative is
    differentiated. Example: docs/index.md, docs/howto/control.md.
    """
    check_kind("problem", problem, Problem, "a Problem, as Problem(model, gel) makes it")
    if until_contact and problem.has_contact:
        raise Inadmissible(
            "until_contact: holes with contact never overlap; give Problem(..., contact=False)"
        )
    options = Following(branch, symmetry, eigenvalues, until_contact, newton, steps, observer)
    if is_traced((problem, values)):
        return traced_sweep(problem, values, options)
    control, chosen = problem.control, isinstance(values, Adaptive)
    numbers = check_values(values.values if chosen else values, control.name, control.unit)
    check_sweep(problem, numbers)
    if start is not None and numbers[int(chosen)] == start.value:
        raise ValueError(
            f"{control.name}: {start.value:g} is the value of the start, the sweep must leave it"
        )
    followed = Followed(
        problem, values if chosen else numbers.tolist(), options, [] if start is None else [start]
    )
    states = followed.light_states()
    return Path.from_states(problem, states, stop=followed.stop, stop_text=followed.stop_text)
