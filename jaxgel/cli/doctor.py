"""``jaxgel doctor``: versions, float64, threads, and two computations whose results are known.

A released jaxlib sums float64 numbers wrongly beyond 16,384 rows, without an error; so both are computed at more points than that.
"""

import platform
import sys
from argparse import Namespace
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_info

from .._threads import usable_cores
from ..materials import Gel, free_swelling
from .environment import DONE, STOPPED

POINTS = 16_385
AGREEMENT = 1e-9  # relative: round-off stays below 1e-11, a wrong program is wrong in the first digits
SWOLLEN = 1.073959312922861  # free-swelling stretch of Gel(Nv=1e-3, chi=0.2) at mu = -1


def doctor(_: Namespace) -> int:
    """``jaxgel doctor``: what is installed, and the difference of each computation from its known result; the exit code."""
    packages = ("jaxgel", "jax", "jaxlib", "numpy", "scipy", "shapely", "matplotlib", "optax")
    pools = {f"{pool.get('internal_api', pool['user_api'])} {pool['num_threads']}" for pool in threadpool_info()}
    print(f"Python {platform.python_version()} on {platform.platform()}")
    print(", ".join(f"{name} {version(name)}" for name in packages))
    print(f"float64: {'on' if jnp.zeros(()).dtype == jnp.float64 else 'OFF: something switched jax_enable_x64 off'}")
    print(f"device: {jax.devices()[0].platform}; {usable_cores()} cores; threads: {', '.join(sorted(pools))}")
    wrong = []
    for name, difference in differences().items():
        print(f"{name}: relative difference {difference:.1e}", flush=True)
        wrong += [] if difference < AGREEMENT else [name]  # nan is wrong
    if wrong:
        print(f"jaxgel: this installation computes wrongly: {', '.join(wrong)}; install another jaxlib", file=sys.stderr)
    return STOPPED if wrong else DONE


def differences() -> dict[str, float]:
    """Name of a computation at ``POINTS`` points -> its largest relative difference from the known result; nan if it is not finite."""
    rng = np.random.default_rng(5)
    rows, matrix = rng.normal(size=(POINTS, 3)), rng.normal(size=(3, 3))
    sums = jax.jit(jax.vmap(lambda row: jnp.sum((matrix @ row) ** 2)))(rows)
    stretches = jax.jit(jax.vmap(lambda mu: free_swelling(mu, Gel(Nv=1e-3, chi=0.2))))(np.full(POINTS, -1.0))
    known = {"sums of three squares": (sums, np.sum((rows @ matrix.T) ** 2, axis=1)), "free swelling": (stretches, SWOLLEN)}
    return {name: float(np.max(np.abs(found / expected - 1))) for name, (found, expected) in known.items()}
