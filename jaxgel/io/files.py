"""Atomic writes, checked reads: a file is written beside its place and moved there.

Nothing that is read is trusted or executed.
"""

import csv
import io
import json
import os
import traceback
import zipfile
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path as File
from typing import Any, BinaryIO

import numpy as np

from .._deprecated import old_arguments
from .._validation import Inadmissible

MAX_BYTES = 2**31  # most that is read of one file


def open_folder(folder: str | File) -> File:
    """The folder as a ``pathlib.Path``, made if it is missing.

    ValueError when it cannot be written.
    """
    folder = File(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".jaxgel-probe.part"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as problem:
        raise ValueError(
            f"out: cannot write in {str(folder)!r}: {problem.strerror}; choose a folder that can "
            "be written"
        ) from None
    return folder


@old_arguments
def write_atomically(file: File, write: Callable[[BinaryIO], Any]) -> None:
    """Call ``write(stream)`` on a temporary file, then move it to ``file`` atomically.

    No reader sees half of it.
    """
    part = file.with_name(file.name + ".part")
    with part.open("wb") as stream:
        write(stream)
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(file)


def write_json(file: File, record: dict[str, Any]) -> None:
    """Write a dict as JSON, whole or not at all."""
    encoded = json.dumps(record, indent=1, allow_nan=False).encode()
    write_atomically(file, lambda stream: stream.write(encoded))


def read_record(file: File, version: int) -> dict[str, Any] | None:
    """The dict that `write_json` has written with ``format`` = ``version``.

    None if there is no such file.
    """
    try:
        record = json.loads(file.read_bytes())
        return record if record["format"] == version else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_csv(file: File, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table, whole or not at all: the names of its columns, and rows of as many values.

    None is written as nothing.
    """
    table = io.StringIO(newline="")
    csv.writer(table, lineterminator="\n").writerows([columns, *rows])
    write_atomically(file, lambda stream: stream.write(table.getvalue().encode()))


def one_line(problem: BaseException) -> str:
    """What an exception says, in one line; its kind if it says nothing."""
    return " ".join(str(problem).split()) or type(problem).__name__


TRACEBACK = "traceback.txt"


def failure(problem: Exception, folder: File) -> str:
    """What an exception says, in one line.

    Its traceback is in `TRACEBACK` in the folder unless it is `Inadmissible` or `StateNotFound`.
    """
    # not before: commands without a sweep do not import JAX
    from ..equilibrium import StateNotFound

    if not isinstance(problem, Inadmissible | StateNotFound):
        (folder / TRACEBACK).write_text(
            "".join(traceback.format_exception(problem)), encoding="utf-8"
        )
    return one_line(problem)


def guarded(file: File, read: Callable[[bytes], Any]) -> Any:
    """``read(bytes)`` of a file.

    ValueError, one line, for one that cannot be read, is too large or damaged.
    """
    try:
        if file.stat().st_size > MAX_BYTES:
            raise ValueError(
                f"it has {file.stat().st_size} bytes, more than the {MAX_BYTES} allowed"
            )
        return read(file.read_bytes())
    except (OSError, ValueError, RecursionError, csv.Error) as problem:
        raise ValueError(
            f"folder: {str(file)!r} is damaged or not written by jaxgel: {one_line(problem)[:200]}"
        ) from problem


def read_arrays(content: bytes) -> dict[str, np.ndarray]:
    """Name -> array of the bytes of an .npz file, whose size is checked before they are read.

    ValueError for objects.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MAX_BYTES:
            raise ValueError(f"its arrays take {size} bytes, more than the {MAX_BYTES} allowed")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {name: np.asarray(arrays[name]) for name in arrays.files}
    # of damaged bytes
    except (zipfile.BadZipFile, zlib.error, EOFError, MemoryError, RuntimeError) as problem:
        raise ValueError(one_line(problem)) from problem
