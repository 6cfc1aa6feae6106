"""The releases of jaxlib: those that jaxgel does not run on, and how programs compile fastest."""

import warnings
from importlib.metadata import version

REFUSED = {
    "0.10.2": "sums float64 numbers wrongly on the CPU (jax issue 39103)",
    "0.11.0": "is excluded with 0.11.1",
    "0.11.1": "copies whole buffers in every loop",
}  # as in pyproject.toml


def check_jaxlib(found=None):
    """Raise ValueError, one line, where the jaxlib ``found`` (by default the installed one) is known to compute wrongly or too slowly."""
    found = version("jaxlib") if found is None else found
    if found in REFUSED:
        excluded = ",".join(f"!={bad}" for bad in REFUSED)
        raise ValueError(f"jaxlib: {found} {REFUSED[found]}; pip install 'jax>=0.10.1,{excluded},<0.13' 'jaxlib>=0.10.1,{excluded},<0.13'")


def warn_of_flags(flags):
    """Warn (RuntimeWarning) where XLA's ``flags``, a str, are known to make it compute wrongly."""
    if "--xla_backend_optimization_level=0" in flags.split():
        text = "XLA_FLAGS: --xla_backend_optimization_level=0 makes XLA compute wrongly; 1, 2 and 3 do not"
        warnings.warn(text, RuntimeWarning, stacklevel=3)


def quick_flags(found=None):
    """XLA's flags, a list, under which jaxgel's programs compile in half the time and run as fast, for the jaxlib ``found``.

    Releases after 0.10 have no other emitters left to choose, and end the process at a flag that they do not know.
    """
    found = version("jaxlib") if found is None else found
    return ["--xla_backend_optimization_level=2", *(["--xla_cpu_use_fusion_emitters=false"] if found.startswith("0.10.") else [])]


def in_one_part(found=None):
    """Compiler options, a dict: LLVM compiles a program in one part, not 32: less work, but on one core; {} where unknown."""
    found = version("jaxlib") if found is None else found
    return {"xla_cpu_parallel_codegen_split_count": 1} if found.startswith("0.10.") else {}
