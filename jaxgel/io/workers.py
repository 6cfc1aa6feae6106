"""Executors of calls: processes of this machine or a Dask cluster, by one interface.

That of ``concurrent.futures.Executor``.
"""

import collections
import concurrent.futures
import contextlib
import logging
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from .._deprecated import old_arguments
from .files import one_line
from .terminal import interruptible

LOG = logging.getLogger(__name__)
TRIES = 3  # times that a call is begun, as its process may be killed


def run_calls(
    function: Callable[..., dict[str, Any]],
    calls: dict[int, tuple[Any, ...]],
    executor: concurrent.futures.Executor,
    *,
    ended: dict[int, dict[str, Any]],
    lost: Callable[[str], dict[str, Any]],
    write: Callable[[dict[int, dict[str, Any]]], object],
    unit: str,
    quiet: bool = True,
) -> dict[int, dict[str, Any]]:
    """Number -> result of ``function`` at each of ``calls`` on an executor, with a progress bar.

    Calls are number -> arguments; the bar counts in ``unit``. Those in ``ended`` (number -> result)
    are not run again; ``write`` is called with all results whenever there are more. A call that
    ends with an exception was lost by the executor: it is submitted again, and after ``TRIES``
    times its result is ``lost(reason)``. Ctrl-C (KeyboardInterrupt) ends the calls under way.
    """
    results, tries, under_way = dict(ended), collections.Counter(), {}
    waiting = collections.deque(k for k in calls if k not in ended)

    def submit():
        k = waiting.popleft()
        tries[k] += 1
        future = executor.submit(function, *calls[k])
        under_way[future] = k
        return {future} if future.done() else set()  # it ran in this process

    def keep(future):
        k = under_way.pop(future)
        try:
            results[k] = future.result()
        except Exception as problem:
            LOG.warning("call %d was lost, try %d of %d", k, tries[k], TRIES, exc_info=problem)
            if tries[k] < TRIES:
                waiting.append(k)
            else:
                results[k] = lost(f"its process was lost {TRIES} times: {one_line(problem)}")

    with (
        tqdm(total=len(calls), unit=unit, disable=True if quiet else None, leave=False) as bar,
        interruptible() as stop_if_asked,
    ):

        def show():
            write(results)
            bar.n = len(results)
            bar.refresh()

        show()
        try:
            while waiting or under_way:
                done = (
                    submit()
                    if waiting
                    else concurrent.futures.wait(
                        under_way, return_when=concurrent.futures.FIRST_COMPLETED
                    ).done
                )
                for future in done:
                    keep(future)
                stop_if_asked()
                if done:
                    show()
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise
    return results


class InThisProcess(concurrent.futures.Executor):
    """Runs every call where it is submitted."""

    def submit(self, function: Callable, /, *args: Any) -> concurrent.futures.Future:
        """Future, done, of ``function(*args)``."""
        future = concurrent.futures.Future()
        try:
            future.set_result(function(*args))
        except Exception as problem:
            future.set_exception(problem)
        return future


class Workers(concurrent.futures.Executor):
    """So many processes of this machine, one BLAS thread each.

    One that is killed loses the call it was at, and no other. That call ends with
    ``BrokenExecutor``; the next one finds a new process. Each process has a pool of its own, since
    a ``concurrent.futures.ProcessPoolExecutor`` of several loses all calls with one process.
    Processes are spawned, not forked, which JAX does not survive. They ignore Ctrl-C and end with
    this process, whatever ends it.
    """

    @old_arguments
    def __init__(
        self, number: int, start: Callable[[], object] | None = None, calls_each: int | None = None
    ) -> None:
        """``start``, a function that a new process can import, is called first in each.

        After ``calls_each`` calls a new one follows.
        """
        self._start, self._calls_each, self._idle = start, calls_each, queue.SimpleQueue()
        self._threads = concurrent.futures.ThreadPoolExecutor(number)
        # processes end when our end is closed
        self._theirs, self._ours = multiprocessing.Pipe(duplex=False)

    def submit(self, function: Callable, /, *args: Any) -> concurrent.futures.Future:
        """Future of ``function(*args)``, a function that a new process can import."""
        return self._threads.submit(self._call, function, args)

    def _call(self, function, args):
        try:
            pool = self._idle.get_nowait()
        except queue.Empty:
            pool = concurrent.futures.ProcessPoolExecutor(
                1,
                multiprocessing.get_context("spawn"),
                _start,
                (self._start, self._theirs),
                max_tasks_per_child=self._calls_each,
            )
        future = pool.submit(function, *args)
        if isinstance(future.exception(), concurrent.futures.BrokenExecutor):
            pool.shutdown()
        else:
            self._idle.put(pool)
        return future.result()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after the calls under way with ``wait``, otherwise at once."""
        if not wait:
            self._ours.close()
        self._threads.shutdown(cancel_futures=cancel_futures)
        while not self._idle.empty():
            self._idle.get().shutdown()
        self._ours.close()


def _start(start, parent):
    """What a new process does first: ``start`` if given.

    One thread for BLAS, deaf to Ctrl-C, not to outlive the end of its ``parent``.
    """
    if start is not None:
        start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    threadpool_limits(1)
    # if there is a cache, everything: other processes start sooner
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _end_with(parent):
    with contextlib.suppress(EOFError):
        parent.recv()
    os._exit(1)


@contextlib.contextmanager
def dask_executor(address: str) -> Iterator[concurrent.futures.Executor]:
    """Executor of the Dask cluster whose scheduler has that address, extra ``[distributed]``.

    ValueError if none answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ValueError(
            'scheduler: Dask is not installed; pip install "jaxgel[distributed]"'
        ) from None
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as problem:
        raise ValueError(
            f"scheduler: no Dask scheduler answers at {address!r}: {one_line(problem)}"
        ) from None
    with client:
        yield client.get_executor(pure=False)
