"""A run seen from a terminal: its progress, and Ctrl-C."""

import contextlib
import itertools
import signal
import threading
from collections.abc import Callable, Iterator, Sequence

from tqdm import tqdm

from ..equilibrium import State


class Progress:
    """Progress bar of the control with its value, Newton iterations and last rotation.

    ``turns`` are its first value, those at which it turns, and the last, ``done`` the values of the
    states that there are already. The bar is linear in the ``scale`` of the value, and the value
    has the format ``digits``.
    """

    def __init__(
        self,
        turns: Sequence[float],
        quiet: bool,
        *,
        name: str = "mu",
        unit: str = "kT",
        done: Sequence[float] | None = None,
        scale: Callable[[float], float] = float,
        digits: str = ".4f",
    ) -> None:
        turns, passed = (
            [scale(value) for value in turns],
            [scale(value) for value in (turns[0], *(done or ()))],
        )
        self.scale, self.digits = scale, digits
        self.name, self.unit, self.last, self.way = (
            name,
            f" {unit}" if unit else "",
            passed[-1],
            _length(passed),
        )
        span = max(_length(turns), 1e-12)
        form = "{percentage:3.0f}%|{bar:24}| {elapsed}{postfix}"
        self.bar = tqdm(total=span, bar_format=form, disable=True if quiet else None, leave=False)
        self.bar.set_postfix_str("compiling")

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def show(self, state: State, rotation: float | None = None) -> None:
        """An accepted state, with its rotation in degrees if that is known yet.

        `Observer(accepted=progress.show)`.
        """
        value, iterations = state.value, state.newton_iterations
        at = self.scale(value)
        self.way, self.last = self.way + abs(at - self.last), at
        self.bar.n = min(self.way, self.bar.total)
        turned = "" if rotation is None else f", rotation {rotation:.2f} deg"
        self.bar.set_postfix_str(
            f"{self.name} {value:{self.digits}}{self.unit}, {iterations} Newton iterations{turned}",
            refresh=True,
        )


def _length(values):
    """The way from the first of some values to the last by way of the others."""
    return sum(abs(after - before) for before, after in itertools.pairwise(values))


@contextlib.contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """A function that raises KeyboardInterrupt after Ctrl-C.

    The exception itself is lost if it meets a destructor.
    """
    pressed = []

    def note(number, frame):
        pressed.append(number)
        signal.default_int_handler(number, frame)

    def stop_if_asked():
        if pressed:
            raise KeyboardInterrupt

    # only the main thread hears signals
    if threading.current_thread() is not threading.main_thread():
        yield stop_if_asked
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield stop_if_asked
    finally:
        signal.signal(signal.SIGINT, before)
