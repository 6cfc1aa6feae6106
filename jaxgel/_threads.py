"""Processors and threads that this process may use."""

import contextlib
import functools
import os

from threadpoolctl import ThreadpoolController

# unknowns up to which BLAS uses one thread: their fronts are too small for several
ONE_THREAD = 20_000


def few_threads(unknowns: int) -> contextlib.AbstractContextManager:
    """Context in which BLAS uses one thread if the ``unknowns`` are few.

    A sweep stays within it: BLAS threads that are released after every front or product spin on a
    core each until the next one.
    """
    return (
        _thread_pools().limit(limits=1, user_api="blas")
        if unknowns <= ONE_THREAD
        else contextlib.nullcontext()
    )


@functools.cache
def _thread_pools():
    return ThreadpoolController()  # searching the loaded libraries takes milliseconds, so once


def usable_cores() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
