"""Time of the parts of a sweep, beside SuperLU and beside what stability adds, in the same run.

    python benchmarks/kernels.py [--cases sample-1 ...] [--repeats N]

Prints, for each case on its default cloud: the linearisation, tangent, factor and solve of one Newton step at mu = -3 (medians of
``--repeats``), the same factor and solve by SciPy's SuperLU in symmetric mode, a sweep of 30 steps to -0.9178 on the stable branch, and
what its eigenvalues and pivots add to that. BLAS and SuperLU use one thread, XLA what the machine has.
"""  # fmt: skip

import argparse
import statistics
import time

import jax
import numpy as np
from scipy.sparse.linalg import splu

import jaxgel
from jaxgel.continuation import StabilityAnalysis
from jaxgel.linalg import factor
from jaxgel.mechanics import linearise, prepare, tangent

MU = np.linspace(-4.9678, -0.9178, 30)  # kT
SUPERLU = dict(permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=dict(SymmetricMode=True, Equil=False))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=["sample-1", "sample-7", "sample-4", "lattice"], help="built-in names")
    parser.add_argument("--repeats", type=int, default=15, help="runs of which the median is taken (15)")
    options = parser.parse_args()
    names = ("DOFs", "linearise", "tangent", "factor", "solve", "SuperLU", "solve", "ratio", "sweep", "added")
    print(f"{'case':10}", *(name.rjust(9) for name in names))
    for name in options.cases:
        plate = jaxgel.sample(name)
        model = jaxgel.discretise(jaxgel.make_cloud(plate))
        dofs, kernels = newton_step(model, plate.gel, options.repeats)
        ratio = (kernels["SuperLU"] + kernels["its solve"]) / (kernels["factor"] + kernels["solve"])
        rest, added = stability(model, plate.gel, options.repeats)
        times = " ".join(f"{1e3 * seconds:7.2f}ms" for seconds in kernels.values())
        print(f"{name:10} {dofs:9d} {times} {ratio:9.1f} {rest:8.3f}s {added:9.0%}", flush=True)


def newton_step(model, gel, repeats):
    """Number of free degrees of freedom, and median seconds of each part of a Newton step at mu = -3."""
    path = jaxgel.sweep(model, gel, mu=[-3.5, -3.0], contact="off")
    problem, x, pressure = prepare(model, gel), path.x[-1], path.pressure[-1]
    pattern, now = problem.pattern, linearise(problem, x, pressure, -3.0)
    pairs = tangent(problem, x, pressure, now)
    made, matrix, rhs = factor(pattern, pairs), pattern.matrix(pairs), np.ones(len(pattern.free))
    order = np.argsort(splu(matrix, **SUPERLU).perm_c)  # its analysis, once, as in a sweep
    permuted = matrix[order][:, order].tocsc()
    ordered = SUPERLU | dict(permc_spec="NATURAL")
    lu = splu(permuted, **ordered)
    return len(rhs), {
        "linearise": median(lambda: linearise(problem, x, pressure, -3.0), repeats),
        "tangent": median(lambda: tangent(problem, x, pressure, now), repeats),
        "factor": median(lambda: factor(pattern, pairs), repeats),
        "solve": median(lambda: made.apply(rhs), repeats),
        "SuperLU": median(lambda: splu(permuted, **ordered), repeats),
        "its solve": median(lambda: lu.solve(rhs), repeats),
    }


def stability(model, gel, repeats):
    """Median seconds of a sweep on the stable branch without what its eigenvalues take, and the median of that over the rest."""
    spent, rows = [], []
    own = {name: getattr(StabilityAnalysis, name) for name in ("by_nearby_factor", "by_own_factor")}

    def timed(function):
        def call(*args):
            begin = time.perf_counter()
            found = function(*args)
            spent.append(time.perf_counter() - begin)
            return found

        return call

    for name, function in own.items():
        setattr(StabilityAnalysis, name, timed(function))
    for _ in range(repeats + 1):
        spent.clear()
        begin = time.perf_counter()
        jaxgel.sweep(model, gel, mu=MU)
        rest = time.perf_counter() - begin - sum(spent)
        rows.append((rest, sum(spent) / rest))
    for name, function in own.items():
        setattr(StabilityAnalysis, name, function)
    return (statistics.median(column) for column in zip(*rows[1:], strict=True))


def median(function, repeats):
    """Median seconds of a function after a first call."""
    jax.block_until_ready(function())
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(function())
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds)


if __name__ == "__main__":
    main()
