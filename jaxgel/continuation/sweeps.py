"""The public verb of continuation: equilibria at given values of a control, or at values chosen on the way."""

import dataclasses
from collections.abc import Callable

from .._threads import few_threads
from .._types import Array, Float
from ..controls import Control, check_values, control_name, unit_of
from ..discretisation import Model
from ..equilibrium import State
from ..materials import AnyGel
from ..mechanics import localised, prepare, with_contact
from .autodiff import first_state_failed, is_traced, traced_sweep
from .follow import Followed, Following
from .options import MAX_STEPS, check_sweep
from .path import Path

Values = list[float] | tuple[float, ...] | Float[Array, " k"]


def sweep(
    model: Model,
    gel: AnyGel,
    *,
    mu: Values | None = None,
    control: Control | None = None,
    values: Values | None = None,
    branch: str = "stable",
    contact: str = "on",
    loads: Float[Array, "n 2"] | None = None,
    on_step: Callable[[State], None] | None = None,
    start: State | None = None,
    max_steps: int = MAX_STEPS,
    symmetry: str = "auto",
) -> Path:
    """`Path` of equilibria at the given values ``mu`` (k,), kT, or at ``values`` (k,) of another ``control``, which may rise and fall.

    A list or array means those values; a tuple means adaptive steps from its first number to its last, by way of those between, at which
    the control turns. A ``control`` (see ``controls``: ``temperature``, ``chi``, ``pH``, ``Stretch``, ``Load``, ``Driven`` for an own
    function) says for each value which mu, gel, motion of the edges and loads act. Where the branch that is followed loses its stability,
    ``branch="stable"`` crosses to the stable branch that leaves it; ``"symmetric"`` goes on, as a perfectly symmetric cloud would.
    Either way ``path.negative_pivots`` says of each state whether it is stable (0). Where the sides of a hole meet, ``contact="on"`` keeps
    them apart (range and stiffness: ``mechanics.with_contact``), ``"off"`` lets them overlap, and ``"stop"`` ends the sweep. With contact a
    stable branch that ends, or turns unstable, is left by relaxation (``switched``). ``loads`` (n, 2) are dead nodal forces, see
    ``load_vector``. ``symmetry="auto"`` finds symmetric states on a fundamental region of the plate (see ``symmetry``): the same
    states, sooner; ``"off"`` does not. ``on_step(state)`` is called with each accepted `State`, which still has its factor, of a symmetric
    state by blocks; ``start`` is a State to continue from. Raises ValueError for a gel, control or values that cannot be used and
    ``SweepFailed`` where the first state is not found; later failures end the path early, with the reason in ``path.stop`` and
    ``path.stop_text``. Differentiating a state without a meaningful derivative warns of it (``IllPosedDerivative``). Inside ``jax.jit`` and
    ``jax.vmap`` a sweep is refused.
    """
    values = values_of(mu, control, values)
    options = Following(branch, contact, isinstance(values, tuple) and len(values) >= 2, max_steps, symmetry)
    gel = localised(model, gel)
    traced = is_traced((model, gel, values, loads, control))
    model = with_contact(model, gel) if contact == "on" else dataclasses.replace(model, contact=None)
    if traced:
        return traced_sweep(model, gel, control, values, loads, options)
    numbers = check_values(values, control_name(control), unit_of(control)).numbers
    problem = prepare(model, gel, loads, control=control, operators=False)
    check_sweep(problem, numbers)
    if start is not None and (start.control is None) != (control is None):
        raise ValueError(f"start: is no state of a sweep along {control_name(control)}; leave it out, the first state is looked for")
    if start is not None and numbers[int(options.adaptive)] == start.value:
        raise ValueError(f"{control_name(control)}: {start.value:g} is the value of the start, the sweep must leave it")
    with few_threads(2 * model.n_nodes):
        followed = Followed(problem, numbers.tolist(), options, [] if start is None else [start])
        states = followed.light_states(on_step)
    if not states:
        raise first_state_failed(control, numbers[0], followed.stop)
    text = "" if followed.stop.ok else f"stopped after {control_name(control)} = {followed.value:.6g}: {followed.stop.text}"
    return Path.from_states(model, gel, states, control=control, stop=followed.stop, stop_text=text)


def values_of(mu: Values | None, control: Control | None, values: Values | None) -> Values:
    """The values of the control, from the two arguments that may hold them; ValueError, one line, where they do not fit each other."""
    if control is None:
        if values is not None:
            raise ValueError("values: are those of a control, and none is given; give mu, or a control")
        if mu is None:
            raise ValueError("mu: is missing; give the chemical potentials, or a control and its values")
        return mu
    if mu is not None:
        raise ValueError(f"mu: is not accepted beside the control {control_name(control)!r}, which says what mu is")
    if values is None:
        raise ValueError(f"values: are missing, those of the control {control_name(control)!r}")
    return values
