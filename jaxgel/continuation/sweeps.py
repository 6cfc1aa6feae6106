"""The public verb of continuation: equilibria at given values of a control, or at values chosen on the way."""

from .._tracing import is_traced
from .._types import Array, Float
from .._validation import Inadmissible, check_kind
from ..controls import check_values
from ..equilibrium import NEWTON, UNOBSERVED, Newton, Observer, State
from ..mechanics import Problem
from .autodiff import traced_sweep
from .follow import Followed, Following
from .options import check_sweep
from .path import Path
from .steps import STEP_CONTROL, Adaptive, StepControl

Values = list[float] | tuple[float, ...] | Float[Array, " k"] | Adaptive


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
    """`Path` of equilibria of a `Problem` at the given ``values`` (k,) of its control, of mu in kT by default, which may rise and fall.

    ``Adaptive(first, last)`` in place of the values lets the sweep choose its steps. Where the branch that is followed loses its stability,
    ``branch="stable"`` crosses to the stable branch that leaves it; ``"symmetric"`` goes on, as a perfectly symmetric cloud would.
    Either way ``path.negative_pivots`` says of each state whether it is stable (0), by a factor of its own tangent. With contact in the
    problem a stable branch that ends, or turns unstable, is left by relaxation; ``path.switched`` says of each state why it does not
    continue those before it. ``until_contact`` ends the sweep of a problem without contact where the sides of a hole overlap.
    ``symmetry="auto"`` finds symmetric states on a fundamental region of the plate (see ``symmetry``): the same states, sooner;
    ``"off"`` does not. ``eigenvalues`` asks for the lowest eigenvalue of every state, ``path.lowest_eigenvalue``. ``start`` is a State to
    continue from; ``newton`` and ``steps`` hold tolerances, and the ``observer`` is told of every step.

    Raises ValueError for a gel, control or values that cannot be used and ``SweepFailed`` where the first state is not found; later
    failures end the path early, with the reason in ``path.stop`` and ``path.stop_text``. Differentiating a state without a meaningful
    derivative warns of it (``IllPosedDerivative``). Inside ``jax.jit`` and ``jax.vmap`` a sweep is
    one program, for values that are given and without contact: where the branch loses stability or touches itself the states are nan from
    there on, with their status.
    """
    check_kind("problem", problem, Problem, "a Problem, as Problem(model, gel) makes it")
    if until_contact and problem.has_contact:
        raise Inadmissible("until_contact: holes with contact never overlap; give Problem(..., contact=False)")
    options = Following(branch, symmetry, eigenvalues, until_contact, newton, steps, observer)
    if is_traced((problem, values)):
        return traced_sweep(problem, values, options)
    control, chosen = problem.control, isinstance(values, Adaptive)
    numbers = check_values(values.values if chosen else values, control.name, control.unit)
    check_sweep(problem, numbers)
    if start is not None and numbers[int(chosen)] == start.value:
        raise ValueError(f"{control.name}: {start.value:g} is the value of the start, the sweep must leave it")
    followed = Followed(problem, values if chosen else numbers.tolist(), options, [] if start is None else [start])
    states = followed.light_states()
    return Path.from_states(problem, states, stop=followed.stop, stop_text=followed.stop_text)
