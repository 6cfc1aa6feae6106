"""A sweep that never leaves the device: dense factors under ``jax.jit`` and ``jax.vmap``, against jaxgel's sparse ones on the host.

    python benchmarks/gpu.py [--spacing 1.1] [--batch 8] [--states 12] [--repeats 3] [--out FILE]

Sample 1 without contact on the default device of JAX, a GPU where there is one, and otherwise the processor; the same kernels, with
the tangent filled into a dense matrix and factorised on the device. Prints and writes gpu.json beside this file: seconds per sweep of one
dense sweep, of a batch of gels, and of ``jaxgel.sweep``, and the largest difference of a nodal position between dense and sparse, which
must stay below 1e-9 mm.
"""  # fmt: skip

import argparse
import dataclasses
import json
import os
import statistics
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel
from jaxgel import Problem
from jaxgel.equilibrium import NEWTON, dry_state
from jaxgel.mechanics import assembly, condensed_rhs, linearise, pressure_step

AGREEMENT = 1e-9  # mm


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spacing", type=float, default=1.1, help="node spacing in mm (1.1)")
    parser.add_argument("--batch", type=int, default=8, help="gels at once (8)")
    parser.add_argument("--states", type=int, default=12, help="states from mu = -4.9678 to -0.9178 (12)")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the median is taken (3)")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("gpu.json"))
    options = parser.parse_args()
    plate = jaxgel.sample("sample-1")
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=options.spacing))
    mu, problem = jnp.linspace(-4.9678, -0.9178, options.states), Problem(model, plate.gel, contact=False).prepared
    gels = np.array([1e-3, 1e-4]) * (1 + 0.1 * np.random.default_rng(5).uniform(-1, 1, (options.batch, 2)))

    def one(values):
        return dense_sweep(problem, jaxgel.Gel(Nv=values[0], chi=values[1]), mu)

    def sparse():
        found = [
            jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(Nv=v[0], chi=v[1]), contact=False), mu.tolist(), branch="symmetric") for v in gels
        ]
        return jnp.stack([jnp.asarray(path.x) for path in found])

    single, batch = jax.jit(one), jax.jit(jax.vmap(one))
    seconds, x = {}, {}
    for name, function in (("dense", lambda: jnp.stack([single(v) for v in gels])), ("batch", lambda: batch(gels)), ("sparse", sparse)):
        seconds[name], x[name] = timed(function, options.repeats)
    difference = {name: float(jnp.abs(x[name] - x["sparse"]).max()) for name in ("dense", "batch")}
    row = {"device": str(jax.devices()[0]), "jax": jax.__version__, "nodes": model.n_nodes, "dofs": len(problem.free)}
    row |= {f"{name}_s": value / len(gels) for name, value in seconds.items()} | {f"{n}_difference_mm": d for n, d in difference.items()}
    row |= {"batch": options.batch, "states": options.states, "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")}
    print(*(f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}" for name, value in row.items()), sep="\n")
    options.out.write_text(json.dumps(row, indent=1) + "\n")
    if not max(difference.values()) < AGREEMENT:
        sys.exit(f"gpu.py: dense and sparse sweeps differ by more than {AGREEMENT:g} mm")


def dense_sweep(problem, gel, mu):
    """Equilibria (k, n, 2) at the values ``mu`` (k,), nan where not reached, each from the line through the two before; traceable."""
    operators = dataclasses.replace(problem.operators, network=problem.operators.network * (gel.Nv / problem.gel.Nv))
    problem = problem.replace(gel=gel, operators=operators)
    free, shared = problem.free, problem.shared
    rows, columns, source = _places(problem.pattern)

    def newton(mu, x, p):
        def solved(now):
            return (now.residual_norm < NEWTON.tolerance) & (now.violation < NEWTON.constraint_tolerance)

        def going(state):
            _, _, now, count = state
            return ~solved(now) & jnp.isfinite(now.residual_norm + now.violation) & (count < NEWTON.max_iterations)

        def step(state):
            x, p, now, count = state
            entries = assembly._tangent(problem, x, p, now).ravel()[source]
            K = jnp.zeros((len(free),) * 2).at[rows, columns].set(entries)
            dx = jnp.zeros(x.size).at[free.masters].set(jnp.linalg.solve(K, condensed_rhs(problem, now, now))).reshape(x.shape)
            wide = jnp.zeros(shared.model.nodes.shape).at[: len(dx)].set(dx)
            x, p = x + dx, p + pressure_step(wide, now, now, shared.model)[: len(p)]
            return x, p, linearise(problem, x, p, mu), count + 1

        x, p, now, _ = jax.lax.while_loop(going, step, (x, p, linearise(problem, x, p, mu), 0))
        return jnp.where(solved(now), x, jnp.nan), p

    def advance(carry, mu):
        (mu_1, x_1, p_1), (mu_2, x_2, p_2) = carry
        ratio = jnp.where(mu_1 > mu_2, (mu - mu_1) / jnp.where(mu_1 > mu_2, mu_1 - mu_2, 1.0), 0.0)
        x, p = newton(mu, x_1 + ratio * (x_1 - x_2), p_1 + ratio * (p_1 - p_2))
        return ((mu, x, p), (mu_1, x_1, p_1)), x

    start = mu[0], *dry_state(problem)
    return jax.lax.scan(advance, (start, start), mu)[1]


def _places(pattern):
    """Row, column and source of every entry of the free-free matrix."""
    matrix = pattern.structure.tocoo()
    return matrix.row, matrix.col, pattern.source


def timed(function, repeats):
    """Median seconds of a function after a first call, and what it gave."""
    result, seconds = jax.block_until_ready(function()), []
    for _ in range(repeats):
        begin = time.perf_counter()
        result = jax.block_until_ready(function())
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds), result


if __name__ == "__main__":
    main()
