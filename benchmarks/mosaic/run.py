"""jaxgel and NGSolve in the domain of ``domain.py``, by Mosaic's own check of gradients.

Run it by python benchmarks/mosaic/run.py [--quick]. Needs ``pip install mosaic-bench`` beside the
extra ``[bench]``. The solvers run in this process (Mosaic runs its own in containers). For each
task, solver and differentiated input a row: the largest difference of Mosaic's directional
derivatives from central differences at the best of its steps, relative to the largest derivative;
seconds of a call and of a call with its gradient, the second of two. Rows of one task also show how
far the values of both solvers are apart.
"""

import argparse
import pathlib
import time

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)  # before Mosaic makes its random directions

from domain import TASKS, inputs
from mosaic.benchmarks.core.experiment import KernelContext
from mosaic.benchmarks.problems.shared.gradient import fd_check
from tesseract_core import Tesseract

HERE = pathlib.Path(__file__).parent
SOLVERS = {"jaxgel": tuple(TASKS), "NGSolve": ("pattern",)}
STEPS = [1e-2, 1e-3, 1e-4, 1e-5]  # of the input's root mean square


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--directions", type=int, default=2, help="random directions of the check (2)"
    )
    parser.add_argument(
        "--tasks", nargs="+", choices=TASKS, default=list(TASKS), help="tasks (all)"
    )
    parser.add_argument(
        "--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS), help="solvers (all)"
    )
    parser.add_argument("--quick", action="store_true", help="jaxgel's onset alone, one direction")
    options = parser.parse_args()
    print(
        f"{'task':>8}{'solver':>9}{'by':>7}{'gradient':>10}{'value s':>9}{'and gradient s':>16}  "
        "values"
    )
    for task in ["onset"] if options.quick else options.tasks:
        for solver in options.solvers:
            if task in SOLVERS[solver]:
                rows(task, solver, 1 if options.quick else options.directions)


def rows(task, solver, directions):
    """Print the rows of a solver."""
    tesseract, given = Tesseract.from_tesseract_api(HERE / f"{solver.lower()}_api.py"), inputs(task)
    value, seconds = timed(lambda: tesseract.apply(given)["value"])
    for key in ("shape", "gel"):
        context = KernelContext(
            name=solver,
            cfg=None,
            ic=given[key],
            phys={},
            sweep_key=None,
            sweep_value=None,
            ic_key=key,
            output_key="value",
            make_inputs=lambda *_, **__: given,
            domain_extent=1.0,
            run={"fd": {"eps_values": STEPS, "n_dirs": directions}},
        )
        found = fd_check(tesseract, context)["metrics"]
        exact = np.array(found["vjp_arr"])
        error = (
            min(
                np.abs(np.array(one["fd_arr"]) - exact).max() for one in found["eps_sweep"].values()
            )
            / np.abs(exact).max()
        )
        _, both = timed(
            lambda key=key: tesseract.vector_jacobian_product(
                given, [key], ["value"], {"value": np.ones_like(value)}
            )
        )
        text = " ".join(f"{number:.5g}" for number in value)
        print(
            f"{task:>8}{solver:>9}{key:>7}{error:>10.1e}{seconds:>9.2f}{both:>16.2f}  {text}",
            flush=True,
        )


def timed(call):
    """Result and seconds of the second of two calls."""
    call()
    begin = time.perf_counter()
    return call(), time.perf_counter() - begin


if __name__ == "__main__":
    main()
