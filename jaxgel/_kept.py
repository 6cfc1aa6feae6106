"""Compiled programs kept in a folder: a later process neither traces, lowers nor compiles them.

A kept program is an executable of flat arrays. Its folder is named by all that the executable
depends on besides the function: jaxgel's sources, versions, processor, devices and XLA's flags; its
file by the function and the sizes. JAX stores executables as pickles, so folder and files must
belong to the user, and no one else may write there.

Some releases of jaxlib write executables that end the process which runs them. So a new file is
only waiting; a process of its own (`run_trial`), started when the one that wrote it ends, runs each
and only then makes it a program. A file whose run did not return stays marked as tried, and is
neither used nor written again. Whatever is missing, damaged or refused is compiled.
"""

import atexit
import contextlib
import functools
import hashlib
import logging
import os
import pickle
import platform
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.experimental import serialize_executable
from jax.experimental.compilation_cache import compilation_cache

MAX_BYTES = 2**30  # of all kept programs; those used least recently are removed
TRIAL_SECONDS = 120  # most that the trial of a program may take
WAITING, TRIED, PROGRAM = ".waiting", ".tried", ".program"  # what a file's name ends in
LOG = logging.getLogger(__name__)
COMPILING = threading.RLock()


class KeptPrograms:
    """The kept programs of this process; none until `keep` names a folder."""

    def __init__(self) -> None:
        self.root: Path | None = None
        self._imported, self._looked = time.time(), -np.inf

    def keep(self, root: Path | None) -> None:
        """Keep programs in the folder ``root``; None ends it.

        The folder is made and checked when a program is first needed.
        """
        self.root = root
        self.__dict__.pop("folder", None)

    @functools.cached_property
    def folder(self) -> Path | None:
        """The programs that serve this process, a folder in the root.

        None, and no root, if this is not the user's alone.
        """
        if self.root is None:
            return None
        key = surroundings()
        try:
            if key is None:
                raise OSError("jaxgel keeps programs of one CPU device, on Linux")
            folder = self.root / hashlib.sha256(key.encode()).hexdigest()[:16]
            for each in (self.root, folder):
                each.mkdir(mode=0o700, parents=True, exist_ok=True)
                check_private(each.stat())
        except OSError as problem:
            LOG.debug("no programs are kept: %s", problem, exc_info=True)
            self.root = None
            return None
        _register_linear_algebra()
        return folder

    def _check_sources(self):
        """Keep nothing from now on if jaxgel was edited since its import.

        Which functions run is not known then.
        """
        if self.root is not None and time.monotonic() > self._looked + 1.0:
            if max((file.stat().st_mtime for file in _sources()), default=0.0) > self._imported:
                LOG.debug(
                    "no programs are kept: jaxgel's sources have changed since it was imported"
                )
                self.keep(None)
            self._looked = time.monotonic()

    def load(self, name: str) -> tuple[Callable[..., list], Any] | None:
        """The program of a ``name``, and its results' structure; None if not kept.

        It is a function of arrays that returns arrays.
        """
        self._check_sources()
        try:
            return _read(self.folder / f"{name}{PROGRAM}") if self.folder else None
        except FileNotFoundError:
            return None
        except Exception as problem:  # a pickle raises of every kind
            LOG.debug("the kept program %s is not used: %s", name, problem, exc_info=True)
            return None

    def accepts(self, name: str) -> bool:
        """Whether a program of this ``name`` can be saved: no other waits or has failed.

        That is, waits for its trial or has failed it.
        """
        return self.folder is not None and not any(
            (self.folder / f"{name}{state}").exists() for state in (WAITING, TRIED)
        )

    def saved(self, name: str, lowered: jax.stages.Lowered, structure: Any) -> Callable[..., list]:
        """The ``lowered`` program of flat arrays, compiled, and kept to be tried.

        Its results have the tree ``structure``.
        """
        self._check_sources()
        try:
            stored = pickle.dumps(structure)
            if self.folder is None or pickle.loads(stored) != structure:  # noqa: S301
                raise ValueError("its results hold an object that is compared by identity")
        except Exception as problem:
            LOG.debug("the program %s is not kept: %s", name, problem, exc_info=True)
            return lowered.compile()
        program = _compiled_anew(lowered)
        try:
            payload = serialize_executable.serialize(program)[0]
            shapes = [(leaf.shape, leaf.dtype.str) for leaf in program.in_avals[0]]
            _write(
                self.folder / f"{name}{WAITING}",
                pickle.dumps((payload, shapes, stored, structure.num_leaves)),
            )
        except Exception as problem:  # what a release of jaxlib cannot serialise, a full disk
            LOG.debug("the program %s is not kept: %s", name, problem, exc_info=True)
            with contextlib.suppress(OSError):
                (self.folder / f"{name}{TRIED}").touch()  # later processes need not try
        return program


KEPT = KeptPrograms()
"""Those of this process."""


def keep_programs(folder: str | Path | None = None) -> None:
    """Keep compiled programs in a folder for later processes.

    `folder` is its path, by default in the user's cache folder. Call this before the first
    computation. Programs are those of jaxgel's functions and of their derivatives: a notebook that
    is started again neither traces nor compiles them. New ones are tried by another process when
    this one ends, and used from then on. The folder is JAX's compilation cache too, for all other
    programs, unless JAX has one. The command line does the same. Kept programs are executable: a
    folder that belongs to someone else, or to which others can write, is not used. They are kept on
    Linux, for one CPU device. See README.
    """
    root = user_folder() if folder is None else Path(folder).expanduser()
    KEPT.keep(root / "programs")
    if jax.config.jax_compilation_cache_dir is None:
        jax.config.update("jax_compilation_cache_dir", str(root))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def user_folder() -> Path:
    """The folder of compiled programs in the user's cache folder."""
    from platformdirs import user_cache_path

    return user_cache_path("jaxgel", appauthor=False) / f"jaxlib-{version('jaxlib')}"


def check_private(status: os.stat_result) -> None:
    """PermissionError for a file or folder of this ``status`` that others own or can write."""
    if status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError("it belongs to another user, or others can write to it")


@functools.cache
def surroundings() -> str | None:
    """All that a program depends on besides function and sizes, as text.

    None if programs cannot be kept here. They are kept for one CPU device, on systems that describe
    their processor in ``/proc/cpuinfo``.
    """
    devices = jax.devices()
    try:
        processor = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
    except OSError:
        return None
    if [device.platform for device in devices] != ["cpu"]:
        return None
    names = (
        "vendor_id",
        "cpu family",
        "model",
        "model name",
        "stepping",
        "flags",
        "Features",
        "CPU implementer",
        "CPU part",
    )
    lines = [line for line in processor.splitlines() if line.split(":")[0].strip() in names]
    sources = hashlib.sha256()
    for file in _sources():
        sources.update(file.read_bytes())
    versions = (
        version("jaxgel"),
        jax.__version__,
        version("jaxlib"),
        np.__version__,
        platform.python_version(),
        platform.machine(),
    )
    flags = (
        os.environ.get("XLA_FLAGS", ""),
        jax.config.jax_enable_x64,
        jax.config.jax_default_matmul_precision,
    )
    return repr((sources.hexdigest(), versions, flags, devices[0].device_kind, lines))


def _sources():
    return sorted(Path(__file__).parent.rglob("*.py"))


def _register_linear_algebra():
    """Have jaxlib register its LAPACK kernels, which lowering does.

    An executable that calls one before ends the process.
    """
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _compiled_anew(lowered):
    """The ``lowered`` program, compiled without JAX's compilation cache.

    Executables that come from that cannot be serialised again.
    """
    with COMPILING:
        enabled = jax.config.jax_enable_compilation_cache
        _enable_compilation_cache(False)
        try:
            return lowered.compile()
        finally:
            _enable_compilation_cache(enabled)


def _enable_compilation_cache(enabled):
    jax.config.update("jax_enable_compilation_cache", enabled)
    compilation_cache.reset_cache()  # which else goes on as it began


# --- files ----------------------------------------------------------------------------------------


def _write(file, content):
    """Write a file behind the checksum of its content, whole or not at all."""
    # readable by its user alone
    with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as stream:
        try:
            stream.write(hashlib.sha256(content).digest() + content)
            stream.close()
            Path(stream.name).replace(file)
        except OSError:
            Path(stream.name).unlink()
            raise


def _read(file):
    """The program in a file and the structure of its results.

    OSError or ValueError for one that cannot be trusted.
    """
    program, _, structure = _unpacked(file)
    with contextlib.suppress(OSError):
        os.utime(file)  # the last time that it was used
    return program, structure


def _unpacked(file):
    with file.open("rb") as stream:
        check_private(os.fstat(stream.fileno()))
        digest, content = stream.read(32), stream.read()
    if hashlib.sha256(content).digest() != digest:
        raise ValueError("it is damaged")
    # the user's own, as checked
    payload, shapes, structure, count = pickle.loads(content)  # noqa: S301
    flat = [jax.tree.structure(((0,) * len(shapes), {})), jax.tree.structure([0] * count)]
    return (
        serialize_executable.deserialize_and_load(payload, *flat),
        shapes,
        pickle.loads(structure),  # noqa: S301
    )


# --- trial ----------------------------------------------------------------------------------------


@atexit.register
def start_trial(*, wait: bool = False) -> None:
    """Start a process that tries waiting programs of such processes; ``wait`` for it if asked."""
    folder = KEPT.__dict__.get("folder")  # None if no program was asked for
    if not sys.executable or folder is None or not any(folder.glob(f"*{WAITING}")):
        return
    trial = (
        f"import sys; sys.path.append({str(Path(__file__).parents[1])!r}); from {__name__} import "
        "run_trial as run; run(sys.argv[1])"
    )
    silent = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    with contextlib.suppress(OSError):
        running = subprocess.Popen(  # noqa: S603
            [sys.executable, "-P", "-c", trial, str(KEPT.root)],
            start_new_session=not wait,
            **silent,
        )
        if wait:
            running.wait()


def run_trial(root: str) -> None:
    """What the process does that tries programs."""
    atexit.unregister(start_trial)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    os.nice(10)
    try_waiting(root)


def try_waiting(root: str | Path) -> None:
    """Run each waiting program in a folder on zeros, which makes it one that is used.

    Then remove what is more than ``MAX_BYTES``. A program in whose run the process ends counts as
    tried; if somebody ends the process, it waits again.
    """
    KEPT.keep(Path(root))
    for file in sorted(KEPT.folder.glob(f"*{WAITING}")) if KEPT.folder else ():
        tried = file.with_suffix(TRIED)
        try:
            file.rename(tried)
        except FileNotFoundError:  # another process tries it
            continue
        signal.alarm(TRIAL_SECONDS)
        try:
            program, shapes, _ = _unpacked(tried)
            jax.block_until_ready(program(*(np.zeros(*shape) for shape in shapes)))
            tried.rename(file.with_suffix(PROGRAM))
        except (SystemExit, KeyboardInterrupt):
            tried.rename(file)
            raise
        except Exception as problem:
            LOG.debug("the program %s is not used: %s", file.stem, problem, exc_info=True)
    signal.alarm(0)
    _remove_least_recent(Path(root))


def _remove_least_recent(root):
    sizes = []
    for file in root.glob("*/*"):
        with contextlib.suppress(FileNotFoundError):  # another process is at it
            status = file.stat()
            sizes.append((-status.st_mtime, status.st_size, file))
    for (_, _, file), total in zip(
        sorted(sizes), np.cumsum([size for _, size, _ in sorted(sizes)]), strict=True
    ):
        if total > MAX_BYTES:
            file.unlink(missing_ok=True)
