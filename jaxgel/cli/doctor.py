"""Whether this installation computes what it should: versions, float64, threads, and an audit of compiled kernels.

A released jaxlib (0.10.2) sums float64 numbers wrongly beyond 16,384 rows, without an error. So each kernel is compiled for more points
than that and compared with the same points in small batches, which are another program; and one number is compared with its known digits.
"""

import dataclasses
import platform
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_info

from .._threads import usable_cores
from ..discretisation import shape_functions
from ..materials import Gel, cauchy_stress, free_energy, free_swelling
from .environment import DONE, STOPPED, in_one_part

POINTS, BATCH = 16_385, 1000  # points of a compiled kernel; points that differ, the rest are repetitions of these
AGREEMENT = 1e-9  # largest difference over the largest value: round-off stays below 1e-11, a wrong program is wrong in the first digits
GEL = Gel(Nv=1e-3, chi=0.2)
SWOLLEN = 1.073959312922861  # free swelling of that gel at mu = -1


@dataclasses.dataclass(frozen=True)
class Finding:
    """What the audit of one kernel found."""

    name: str
    """What was computed."""
    difference: float
    """Largest difference over the largest value; nan where a value is not finite."""

    @property
    def ok(self) -> bool:
        """Whether the difference is round-off."""
        return self.difference < AGREEMENT


def doctor(_: Namespace) -> int:
    """``jaxgel doctor``: versions, float64, threads, and the audit; the exit code."""
    print(*describe(), f"audit at {POINTS:,} points, compiled at once and in batches of {BATCH:,}:", sep="\n")
    began, failed = time.perf_counter(), []
    for found in audit():
        print(f"  {found.name:<40} {found.difference:8.1e}{'' if found.ok else '  WRONG'}", flush=True)
        failed += [] if found.ok else [found.name]
    print(f"audited in {time.perf_counter() - began:.1f} s")
    if failed:
        print(f"jaxgel: this installation computes wrongly: {', '.join(failed)}; install another jaxlib", file=sys.stderr)
    return STOPPED if failed else DONE


def describe() -> list[str]:
    """Lines that say what is installed and how it runs."""
    packages = ("jaxgel", "jax", "jaxlib", "numpy", "scipy", "shapely", "matplotlib", "optax")
    pools = {f"{pool.get('internal_api', pool['user_api'])} {pool['num_threads']}" for pool in threadpool_info()}
    return [
        f"Python {platform.python_version()} on {platform.platform()}",
        ", ".join(f"{name} {version(name)}" for name in packages),
        f"float64: {'on' if jnp.zeros(()).dtype == jnp.float64 else 'OFF: something switched jax_enable_x64 off'}",
        f"device: {jax.devices()[0].platform}; {usable_cores()} cores; threads: {', '.join(sorted(pools))}",
    ]


def audit() -> Iterator[Finding]:
    """A `Finding` for every kernel and for the known digits."""
    with ThreadPoolExecutor(usable_cores()) as pool:  # compiling releases Python's lock
        for name, found in [(name, pool.submit(_difference, *kernel)) for name, kernel in kernels().items()]:
            yield Finding(name, found.result())
    yield Finding("free swelling, known digits", abs(float(free_swelling(-1.0, GEL)) / SWOLLEN - 1))


def _difference(function: Callable, arguments: tuple) -> float:
    """Largest difference over the largest value of a function of one point between all points at once and a batch of them."""
    program = jax.jit(jax.vmap(function), compiler_options=in_one_part())
    repeated = np.arange(POINTS) % BATCH
    expected = [np.asarray(value)[repeated] for value in jax.tree.leaves(program(*arguments))]
    found = [np.asarray(value) for value in jax.tree.leaves(program(*(a[repeated] for a in arguments)))]
    return max(float(np.max(np.abs(a - b)) / (np.max(np.abs(b)) + 1e-300)) for a, b in zip(found, expected, strict=True))


def kernels() -> dict[str, tuple[Callable, tuple]]:
    """Name -> (function of one point, its arguments for ``BATCH`` points)."""
    rng = np.random.default_rng(5)
    F = 1.3 * np.eye(2) + rng.uniform(-0.2, 0.2, (BATCH, 2, 2))
    mu, x = rng.uniform(-5, -0.5, BATCH), rng.uniform(-0.5, 0.5, (BATCH, 2))
    rows, matrix = rng.normal(size=(BATCH, 3)), rng.normal(size=(3, 3))
    grid = np.stack(np.meshgrid(*2 * [np.arange(-2.0, 3.0)]), axis=-1).reshape(-1, 2)
    nodes = grid + rng.uniform(-0.2, 0.2, (BATCH, 25, 2))

    def derivatives(F, mu):
        return jax.value_and_grad(free_energy)(F, mu, GEL), jax.hessian(free_energy)(F, mu, GEL)

    return {
        "matrix times row of 3, squared, summed": (lambda row: jnp.sum((matrix @ row) ** 2), (rows,)),  # the defect of jaxlib 0.10.2
        "free energy, stress, tangent": (derivatives, (F, mu)),
        "Cauchy stress": (lambda F, mu: cauchy_stress(F, mu, GEL), (F, mu)),
        "free swelling": (lambda mu: free_swelling(mu, GEL), (mu,)),
        "shape functions": (lambda x, nodes: shape_functions(x, nodes, 2.95, kind="imls"), (x, nodes)),
    }
