"""Where calls run: processes of this machine, or a Dask cluster, behind one interface, that of ``concurrent.futures.Executor``."""

import concurrent.futures
import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
from threadpoolctl import threadpool_limits


class Workers(concurrent.futures.Executor):
    """So many processes of this machine, one BLAS thread each; one that is killed loses the call it was at, and no other.

    That call ends with ``BrokenExecutor``; the next one finds a new process. Processes are started anew, not forked, which JAX does not
    survive. They ignore Ctrl-C and end with this process, whatever ends it.

    ``concurrent.futures.ProcessPoolExecutor`` loses more: of 40 calls on two processes, one of which is killed after the first call, it
    loses 39, `Workers` 1. Nor can it replace one process after a call that has filled its memory with programs.
    """

    def __init__(self, number: int, start: Callable[[], object] | None = None, spent: Callable[[Any], bool] | None = None) -> None:
        """``start``, a function that a new process can import, is called first in each; ``spent`` says of a result to end its process."""
        self._start, self._spent = start, spent
        self._threads = concurrent.futures.ThreadPoolExecutor(number)
        self._own = threading.local()  # the pool of one process that a thread stands before
        self._pids, self._ended = {}, False

    def submit(self, function: Callable, /, *args: Any) -> concurrent.futures.Future:
        """Future of ``function(*args)``, a function that a new process can import."""
        return self._threads.submit(self._call, function, args)

    def _call(self, function, args):
        try:
            pool = getattr(self._own, "pool", None) or self._new_pool()
            result = pool.submit(function, *args).result()
            if self._spent is not None and self._spent(result):
                self._pids.pop(pool, None)
                self._own.pool = None
                pool.shutdown()
            return result
        except concurrent.futures.BrokenExecutor:
            self._pids.pop(self._own.pool, None)
            self._own.pool = None
            raise

    def _new_pool(self):
        pool = concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _start, (self._start,))
        self._own.pool = pool
        self._pids[pool] = pool.submit(os.getpid).result()
        if self._ended:  # while it started
            self._kill(self._pids[pool])
        return pool

    @staticmethod
    def _kill(pid):
        with contextlib.suppress(ProcessLookupError):  # it ended by itself
            os.kill(pid, signal.SIGTERM)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after the calls under way with ``wait``, otherwise at once."""
        self._ended = not wait
        for pid in [] if wait else list(self._pids.values()):
            self._kill(pid)
        self._threads.shutdown(cancel_futures=cancel_futures)
        for pool in list(self._pids):
            pool.shutdown()


def _start(start):
    """What a new process does first: ``start`` where given; one thread for BLAS, deaf to Ctrl-C, not to outlive its parent."""
    if start is not None:
        start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    threadpool_limits(1)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # if there is a cache, everything: other processes start sooner


def _end_with_parent():
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def dask_executor(address: str) -> Iterator[concurrent.futures.Executor]:
    """Executor of the Dask cluster whose scheduler has that address, extra ``[distributed]``; ValueError where none answers."""
    try:
        from distributed import Client
    except ImportError:
        raise ValueError('scheduler: Dask is not installed; pip install "jaxgel[distributed]"') from None
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as problem:
        raise ValueError(f"scheduler: no Dask scheduler answers at {address!r}: {' '.join(str(problem).split())}") from None
    with client:
        yield client.get_executor(pure=False)
