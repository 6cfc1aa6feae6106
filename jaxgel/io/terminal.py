"""A run seen from a terminal: its progress, and Ctrl-C."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator

from tqdm import tqdm


class Progress:
    """A bar over the interval of mu on the terminal, with mu, Newton iterations and rotation of the last state."""

    def __init__(self, ends: tuple[float, float], quiet: bool) -> None:
        self.start = ends[0]
        span = max(ends[1] - ends[0], 1e-12)
        form = "{percentage:3.0f}%|{bar:24}| {elapsed}{postfix}"
        self.bar = tqdm(total=span, bar_format=form, disable=True if quiet else None, leave=False)
        self.bar.set_postfix_str("compiling")

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.close()

    def show(self, mu: float, iterations: int, rotation: float | None = None) -> None:
        """A state at ``mu``, in kT, that took so many Newton iterations, with its rotation in degrees where that is known yet."""
        self.bar.n = min(float(mu) - self.start, self.bar.total)
        turned = "" if rotation is None else f", rotation {rotation:.2f} deg"
        self.bar.set_postfix_str(f"mu {mu:.4f}, {iterations} Newton iterations{turned}", refresh=True)


@contextlib.contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """A function that raises KeyboardInterrupt once Ctrl-C was pressed: the exception itself is lost where it meets a destructor."""
    pressed = []

    def note(number, frame):
        pressed.append(number)
        signal.default_int_handler(number, frame)

    def stop_if_asked():
        if pressed:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only the main thread hears signals
        yield stop_if_asked
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield stop_if_asked
    finally:
        signal.signal(signal.SIGINT, before)
