"""Quantities of transient swelling between states, and times at which they reach a value."""

from collections.abc import Callable, Sequence

import jax.numpy as jnp

from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import one_of
from ..continuation import Path
from .in_time import ROUNDING, first_time, interpolated
from .quantities import QUANTITIES
from .solvent import check_in_time, kinks_of
from .states import of_path

Values = str | Callable[[Path], Float[Array, "k ..."]] | Float[Array, "k *v"]
NAMES = [name for name, quantity in QUANTITIES.items() if quantity.kind is not str]


@of_path
def at_time(
    path: Path, quantity: Values, t: Scalar | Sequence[float] | Float[Array, " p"]
) -> Float[Array, "..."]:
    """Values () at a time, or (p,) at several, of a quantity of transient swelling.

    Arguments:

    - `path`: the `Path` of `swell`.
    - `quantity`: a name in `observables.QUANTITIES`, in the unit there, a function of the path, or
      an array with a row for every state, whose further axes are preserved.
    - `t` () or (p,): the times, in the unit of time of `swell`.

    The interpolation is cubic through four states, in the logarithm of the time since the last kink
    of the bath; in the first two intervals after a kink, time 0 included, in the root of that time.

    Raises `ValueError` for a time beyond the states (nan if it is traced), for an unknown quantity,
    and for equilibrium states.

    >>> import jaxgel
    >>> plate = jaxgel.Plate(1.0, 1.0, edges={"top": "free"})
    >>> model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.25))
    >>> problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.swell(problem, -0.4, [0.01, 0.03, 0.1, 0.3, 1.0], start=-0.5)
    >>> J = at_time(path, "J_mean", [0.2, 0.5])
    >>> bool(J[0] < J[1]), round(float(time_to(path, "J_mean", J[0])), 9)
    (True, 0.2)
    """
    values, times = _checked(path, quantity), jnp.asarray(path.value)
    t = jnp.asarray(t, dtype=float)
    result = interpolated(times, kinks_of(path), values, jnp.ravel(t))
    reach = ROUNDING * times[-1]
    beyond = jnp.ravel((t < times[0] - reach) | (t > times[-1] + reach))
    if not is_traced(beyond) and beyond.any():
        first, last = float(times[0]), float(times[-1])
        wrong = float(jnp.ravel(t)[beyond][0])
        raise ValueError(
            f"t: {wrong:g} is beyond the path, which runs from {first:g} to {last:g}; give a time "
            "within"
        )
    return result.reshape(*t.shape, *values.shape[1:])


@of_path
def time_to(path: Path, quantity: Values, value: Scalar) -> Float[Array, ""]:
    """Time () at which a quantity of transient swelling first reaches a value.

    Arguments:

    - `path`: the `Path` of `swell`.
    - `quantity`: as in `at_time`, with one number for each state.
    - `value` (): in the unit of `quantity`.

    Returns the root of the interpolation of `at_time` between the first state that has reached the
    value, from above or below, and the state before, in the unit of time of `swell`. It has
    derivatives with respect to `quantity` and `value`.

    Raises `ValueError` if no state reaches the value (nan if it is traced), and as `at_time`.

    Example: in `at_time`, and docs/howto/time.md.
    """
    values = _checked(path, quantity)
    if values.ndim != 1:
        raise ValueError(f"quantity: has the shape {values.shape}, it must be ({len(path)},)")
    value = jnp.asarray(value, dtype=float)
    result = first_time(jnp.asarray(path.value), kinks_of(path), values, value)
    if not is_traced(result) and jnp.isnan(result):
        name = quantity if isinstance(quantity, str) else "quantity"
        low, high, end = (float(v) for v in (values.min(), values.max(), path.value[-1]))
        raise ValueError(
            f"value: {name} does not reach {float(value):g}, its values until t = {end:.4g} are "
            f"between {low:.6g} and {high:.6g}; give one of these, or swell for longer"
        )
    return result


def _checked(path, quantity):
    """Values (k, ...) of a quantity; ValueError, see `at_time`."""
    check_in_time(path)
    if isinstance(quantity, str):
        one_of("quantity", quantity, NAMES)
        quantity = QUANTITIES[quantity].function
    values = jnp.asarray(quantity(path) if callable(quantity) else quantity, dtype=float)
    if values.shape[:1] != (len(path),) or len(path) < 2:
        raise ValueError(
            f"quantity: has the shape {values.shape}, it must have a row for each of {len(path)} "
            "states, at least two"
        )
    return values
