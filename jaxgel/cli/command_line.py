"""The entry point ``jaxgel``: parse, prepare the process, then import and run the command.

The exit codes are in `environment`. What a run has finished is in its folder, however the command
ends.
"""

import functools
import importlib
import os
import sys
import warnings

from ..continuation import SweepFailed
from .environment import (
    STOPPED,
    UNREAD,
    UNUSABLE,
    check_jaxlib,
    collect_seldom,
    prepare_environment,
)
from .parser import parse


def main(argv: list[str] | None = None) -> int:
    """Run the command line on ``argv`` and return its exit code; warnings are lines of stderr.

    By default it is the process's own, which is then prepared for JAX; a process that calls this
    with arguments is left as it is.
    """
    with warnings.catch_warnings():
        warnings.showwarning = functools.partial(_show_warning, warnings.showwarning)
        return _exit_code(argv)


def _exit_code(argv):
    try:
        try:
            args = parse(sys.argv[1:] if argv is None else list(argv))
            check_jaxlib()
            if argv is None:
                prepare_environment(getattr(args, "cache", None))
            name, command = args.command.split(".")
            module = importlib.import_module(f"{__package__}.{name}")
            if argv is None:
                collect_seldom()
            return getattr(module, command)(args)
        finally:
            sys.stdout.flush()
    except ValueError as problem:
        print(f"jaxgel: error: {problem}", file=sys.stderr)
        return UNUSABLE
    # a sweep without a state; a full disk, a lost folder, a closed pipe
    except (SweepFailed, OSError) as problem:
        if isinstance(problem, BrokenPipeError) and _output_is_closed():
            return UNREAD
        print(f"jaxgel: error: {problem}", file=sys.stderr)
        return STOPPED


def _show_warning(show_others, message, category, *where, **options):
    """Show a warning: one line without the place in the source if it is jaxgel's own."""
    if category.__module__.split(".")[0] == "jaxgel":
        print(f"jaxgel: warning: {message}", file=sys.stderr)
    else:
        show_others(message, category, *where, **options)


def _output_is_closed():
    """Whether the broken pipe is standard output.

    What is left for it is dropped then, so that Python's exit writes nothing.
    """
    try:
        print(flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return True
    return False
