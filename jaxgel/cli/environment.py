"""The process of the command line: exit codes, refused jaxlibs, XLA's flags, threads, programs.

Only this module of jaxgel sets environment variables, and only for a process of its own: as a
library jaxgel leaves the process alone.

Exit codes: 0 done; 2 unusable input, with one line that names it; 3 the run stopped early; 130
interrupted; 141 when the reader of the output closes the pipe, as ``| head`` does.
"""

import gc
import os
from importlib.metadata import version
from pathlib import Path

import jax

from .._kept import KEPT, user_folder

DONE, UNUSABLE, STOPPED, INTERRUPTED, UNREAD = 0, 2, 3, 130, 141
REFUSED = {
    "0.10.2": "sums float64 numbers wrongly on the CPU (jax issue 39103)",
    "0.11.0": "is excluded with 0.11.1",
    "0.11.1": "copies whole buffers in every loop",
}  # as in pyproject.toml
CACHE = "JAXGEL_CACHE"  # variable with the folder of compiled programs, or off


def check_jaxlib() -> None:
    """Raise ValueError, one line, for a jaxlib known to compute wrongly or too slowly."""
    found = version("jaxlib")
    if found in REFUSED:
        excluded = ",".join(f"!={bad}" for bad in REFUSED)
        raise ValueError(
            f"jaxlib: {found} {REFUSED[found]}; pip install 'jax>=0.10.1,{excluded},<0.13' "
            f"'jaxlib>=0.10.1,{excluded},<0.13'"
        )


def prepare_environment(cache: str | None = None) -> None:
    """Set what JAX and Matplotlib read when they start, here and in worker processes.

    Variables that the user has set are kept. ``cache`` is the folder of compiled programs or "off",
    see `cache_folder`. Programs are kept there, see `keep_programs`, unless it is that of
    ``JAX_COMPILATION_CACHE_DIR``, which users may share.
    """
    # a GPU gains nothing on programs that the host drives, see docs/dependencies.md
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    own = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = " ".join(
        [own, *(flag for flag in quick_flags() if flag.split("=")[0] not in own)]
    ).strip()
    if (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()) == 1:
        # XLA's threads: a host callback waits on one for its arguments, which another one copies
        os.environ.setdefault("NPROC", "2")
    os.environ.setdefault("MPLBACKEND", "Agg")  # Matplotlib would look for a screen
    # 1 is what JAX itself has set
    if os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1") == "1" and "JAX_LOGGING_LEVEL" not in os.environ:
        # XLA writes its machine's features for every program from the cache
        os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
        jax.config.update("jax_logging_level", "CRITICAL")
    folder, shared = cache_folder(cache), not cache and "JAX_COMPILATION_CACHE_DIR" in os.environ
    if folder is None:
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    else:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = folder
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        jax.config.update(
            "jax_persistent_cache_min_compile_time_secs",
            float(os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"]),
        )
    # JAX has read its variables when it was imported
    jax.config.update("jax_enable_compilation_cache", folder is not None)
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_platforms", os.environ["JAX_PLATFORMS"])
    KEPT.keep(None if folder is None or shared else Path(folder) / "programs")


def collect_seldom() -> None:
    """Have Python's garbage collector leave alone what is imported and run less often.

    Tracing makes many objects that stay: the first state of a second run comes 15 % sooner.
    """
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


def cache_folder(cache: str | None = None) -> str | None:
    """The folder of compiled programs, None for "off".

    The first that is given of ``cache``, ``JAX_COMPILATION_CACHE_DIR``, ``JAXGEL_CACHE`` and the
    user's cache folder.
    """
    chosen = cache or os.environ.get("JAX_COMPILATION_CACHE_DIR") or os.environ.get(CACHE)
    if chosen == "off":
        return None
    if chosen:
        return str(Path(chosen).expanduser())
    return str(user_folder())


def prepare_device(device: str | None) -> None:
    """Let JAX see accelerators if ``device``, one of `DEVICES`, may be one; not in workers.

    The CPU stays the default. To be called before JAX computes anything. A user's ``JAX_PLATFORMS``
    is kept.
    """
    if device not in ("gpu", "auto"):
        return
    if os.environ["JAX_PLATFORMS"] == "cpu":
        jax.config.update("jax_platforms", None)
    jax.config.update("jax_default_device", jax.local_devices(backend="cpu")[0])


def prepare_worker(threads: int, programs: Path | None) -> None:
    """Initialiser of a worker: ``threads`` for XLA, before it starts; folder of kept programs."""
    os.environ["NPROC"] = str(threads)
    KEPT.keep(programs)


def quick_flags(found: str | None = None) -> list[str]:
    """XLA's flags that halve the compile time at equal speed, for the jaxlib ``found``.

    Releases after 0.10 have no other emitters left to choose, and end the process at an unknown
    flag.
    """
    found = version("jaxlib") if found is None else found
    return [
        "--xla_backend_optimization_level=2",
        *(["--xla_cpu_use_fusion_emitters=false"] if found.startswith("0.10.") else []),
    ]
