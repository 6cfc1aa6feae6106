"""The releases of jaxlib that jaxgel does not run on."""

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
