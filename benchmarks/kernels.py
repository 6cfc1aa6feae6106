"""Time of the parts of a sweep, beside SuperLU and beside what stability adds, in the same run.

    python benchmarks/kernels.py [--cases sample-1 ...] [--repeats N]

Prints, for each case on its default cloud: the linearisation, tangent, factor and solve of one
Newton step at mu = -3 (medians of ``--repeats``); the same factor and solve by SciPy's SuperLU in
symmetric mode, and their time over jaxgel's; the seconds of a sweep of 30 steps to -0.9178 on the
stable branch and the whole plate (``symmetry="off"``), the share of its eigenvalues and pivots, and
the share outside compiled programs and LAPACK ("rest"). BLAS and SuperLU use one thread, XLA what
the machine has. With jax 0.12 or later ``--library`` prints instead the processor seconds of
linearise and tangent with the library to which XLA hands small reductions, and over those without
it: medians of 20 times as many calls, with and without in turn.
"""  # fmt: skip

import argparse
import statistics
import time

import jax
import numpy as np
from scipy.sparse.linalg import splu

import jaxgel
from jaxgel import Problem
from jaxgel._programs import fitted
from jaxgel.continuation.frames import Frame
from jaxgel.equilibrium import newton
from jaxgel.linalg import Factor, factor
from jaxgel.mechanics import linearise, tangent, tangent_blocks

MU = np.linspace(-4.9678, -0.9178, 30)  # kT
STABILITY = ((Frame, "factorised"), (Frame, "check"))
KERNELS = (
    *STABILITY,
    *((newton, name) for name in ("linearise", "condensed_rhs", "_stepped", "factorised_tangent")),
    (Factor, "solve"),
)  # what a sweep calls besides its own Python; none calls another of them, but once
WITHOUT_LIBRARY = {"xla_cpu_experimental_ynn_fusion_type": ""}
SUPERLU = dict(
    permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=dict(SymmetricMode=True, Equil=False)
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--cases",
        nargs="+",
        default=["sample-1", "sample-7", "sample-4", "lattice"],
        help="built-in names",
    )
    parser.add_argument(
        "--repeats", type=int, default=15, help="runs of which the median is taken (15)"
    )
    parser.add_argument(
        "--library",
        action="store_true",
        help="compare with and without XLA's library for small reductions",
    )
    options = parser.parse_args()
    if options.library:
        for name in options.cases:
            plate = jaxgel.sample(name)
            print(
                name,
                *library(
                    jaxgel.discretise(jaxgel.make_cloud(plate)), plate.gel, 20 * options.repeats
                ),
                flush=True,
            )
        return
    names = (
        "DOFs",
        "linearise",
        "tangent",
        "factor",
        "solve",
        "SuperLU",
        "solve",
        "ratio",
        "sweep",
    )
    names += ("stability", "rest")
    print(f"{'case':10}", *(name.rjust(9) for name in names))
    for name in options.cases:
        plate = jaxgel.sample(name)
        model = jaxgel.discretise(jaxgel.make_cloud(plate))
        dofs, kernels = newton_step(model, plate.gel, options.repeats)
        ratio = (kernels["SuperLU"] + kernels["its solve"]) / (kernels["factor"] + kernels["solve"])
        seconds, eigenvalues, rest = sweep(model, plate.gel, options.repeats)
        times = " ".join(f"{1e3 * seconds:7.2f}ms" for seconds in kernels.values())
        shares = f"{seconds:8.3f}s {eigenvalues:9.0%} {rest:9.0%}"
        print(f"{name:10} {dofs:9d} {times} {ratio:9.1f} {shares}", flush=True)


def newton_step(model, gel, repeats):
    """Number of degrees of freedom, median seconds of each part of a Newton step."""
    path = jaxgel.sweep(jaxgel.Problem(model, gel, contact=False), [-3.5, -3.0])
    problem, x, pressure = (
        Problem(model, gel, contact=False).prepared,
        path.x[-1],
        path.pressure[-1],
    )
    pattern, now = problem.pattern, linearise(problem, x, pressure, -3.0)
    pairs = tangent(problem, x, pressure, now)
    made, matrix, rhs = factor(pattern, pairs), pattern.matrix(pairs), np.ones(len(pattern.free))
    order = np.argsort(splu(matrix, **SUPERLU).perm_c)  # its analysis, once, as in a sweep
    permuted = matrix[order][:, order].tocsc()
    ordered = SUPERLU | dict(permc_spec="NATURAL")
    lu = splu(permuted, **ordered)
    return (
        len(rhs),
        {
            "linearise": median(lambda: linearise(problem, x, pressure, -3.0), repeats),
            "tangent": median(lambda: tangent(problem, x, pressure, now), repeats),
            "factor": median(lambda: factor(pattern, pairs), repeats),
            "solve": median(lambda: made.apply(rhs), repeats),
            "SuperLU": median(lambda: splu(permuted, **ordered), repeats),
            "its solve": median(lambda: lu.solve(rhs), repeats),
        },
    )


def library(model, gel, repeats):
    """Processor seconds of linearise and tangent with XLA's library for small reductions.

    They are also given over those without it.
    """
    path = jaxgel.sweep(jaxgel.Problem(model, gel, contact=False), [-3.5, -3.0])
    problem, x, pressure = (
        Problem(model, gel, contact=False).prepared,
        path.x[-1],
        path.pressure[-1],
    )
    shared, now = problem.shared, linearise(problem, x, pressure, -3.0)
    at = fitted(x, "n", shared.lengths), fitted(pressure, "g", shared.lengths)
    for function, args in ((linearise, (shared, *at, -3.0)), (tangent_blocks, (shared, *at, now))):
        lowered = jax.jit(function.__wrapped__).lower(*args)
        programs, seconds = (
            [lowered.compile(compiler_options=options) for options in ({}, WITHOUT_LIBRARY)],
            ([], []),
        )
        for number in range(2 * (repeats + 1)):
            begin = time.process_time()
            jax.block_until_ready(programs[number % 2](*args))
            seconds[number % 2].append(time.process_time() - begin)
        own, other = (statistics.median(some[1:]) for some in seconds)
        count = programs[0].as_text().count("ynn_fusion")
        yield (
            f"{function.__name__} {1e3 * own:.2f} ms, ratio {own / other:.2f}, ynn_fusion {count} "
            "times;"
        )


def sweep(model, gel, repeats):
    """Median seconds of a stable sweep, and medians of the shares of stability and of host work."""
    spent, rows = dict.fromkeys(KERNELS, 0.0), []

    def timed(place, name):
        function = getattr(place, name)

        def call(*args, **options):
            begin = time.perf_counter()
            found = function(*args, **options)
            jax.block_until_ready(
                [leaf for leaf in jax.tree.leaves(found) if isinstance(leaf, jax.Array)]
            )
            spent[place, name] += time.perf_counter() - begin
            return found

        setattr(place, name, call)
        return place, name, function

    own = [timed(*kernel) for kernel in KERNELS]
    for _ in range(repeats + 1):
        spent.update(dict.fromkeys(spent, 0.0))
        begin = time.perf_counter()
        jaxgel.sweep(jaxgel.Problem(model, gel), MU, symmetry="off")
        seconds = time.perf_counter() - begin
        rows.append(
            (
                seconds,
                sum(spent[kernel] for kernel in STABILITY) / seconds,
                1 - sum(spent.values()) / seconds,
            )
        )
    for place, name, function in own:
        setattr(place, name, function)
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
