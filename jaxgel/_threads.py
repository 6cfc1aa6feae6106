"""Processors and threads that this process may use."""

import contextlib
import functools
import os

from threadpoolctl import ThreadpoolController

ONE_THREAD = 20_000  # unknowns up to which BLAS uses one thread: several fight over fronts as small as theirs


def few_threads(unknowns):
    """Context in which BLAS uses one thread where the ``unknowns`` are few.

    A sweep stays within it: threads that are let go after every front or product wait for the next one by turning over a core each.
    """
    return _thread_pools().limit(limits=1, user_api="blas") if unknowns <= ONE_THREAD else contextlib.nullcontext()


@functools.cache
def _thread_pools():
    return ThreadpoolController()  # searching the loaded libraries takes milliseconds, so once


def usable_cores():
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usable_threads():
    """Number of threads that this process may compute with: XLA's, which the environment variable NPROC sets if it is a number."""
    number = os.environ.get("NPROC", "")
    return max(1, int(number)) if number.isdecimal() else usable_cores()
