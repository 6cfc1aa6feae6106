"""Solvers for a tangent of sample 1: jaxgel's factor beside preconditioned Krylov methods.

The preconditioners are single precision and algebraic multigrid.

    python benchmarks/solvers.py [--nodes 30000] [--mu -4.9678 -2.5]  (pip install 'jaxgel[bench]')

For each mu (kT) and way: seconds of the setup (factor or hierarchy) and of one solve, its
iterations, the residual over the right-hand side, which is random, and the negative pivots of what
was factorised; the tangents are positive definite. The rounded tangent is that in single precision.
The multigrid is pyamg's smoothed aggregation with the translations and the rotation as near-null
space: of the condensed tangent, and, for MINRES on the mixed form, of the tangent with bulk
stiffnesses of at most 10 Nv, beside the pressures' diagonal. Krylov methods end at a residual of
1e-7 or after 150 iterations; the others at that of round-off.
"""  # fmt: skip

import argparse
import contextlib
import dataclasses
import math
import time

import numpy as np
import pyamg
import scipy.sparse as sp
import scipy.sparse.linalg as sla

import jaxgel
from jaxgel import Problem
from jaxgel.linalg import factor, factorise
from jaxgel.mechanics import all_volumes, linearise, tangent

SOFT = 10  # Nv: bulk stiffness at which the network's shear decides, and multigrid works


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nodes", type=float, default=3e4, help="about so many (3e4)")
    parser.add_argument(
        "--mu", type=float, nargs="+", default=[-4.9678, -2.5], help="kT, increasing (-4.9678 -2.5)"
    )
    options = parser.parse_args()
    plate = jaxgel.sample("sample-1")
    spacing = plate.width * 0.961 / (math.sqrt(36 + 1.922 * options.nodes) - 6)
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing))
    problem = Problem(model, plate.gel, contact=False).prepared
    path = jaxgel.sweep(jaxgel.Problem(model, plate.gel), options.mu)
    for mu, x, pressure in zip(path.mu, path.x, path.pressure, strict=True):
        now = linearise(problem, x, pressure, mu)
        print(
            f"mu = {mu:g}: {len(problem.free)} unknowns, stiffest group "
            f"{float(now.stiffness.max() / plate.gel.Nv):.0f} Nv"
        )
        print(
            f"{'':42} {'setup':>8} {'solve':>8} {'iterations':>10} {'residual':>9} {'negative':>8}"
        )
        for name, (setup, seconds, iterations, residual, negative) in ways(
            problem, x, pressure, now
        ):
            print(
                (
                    f"{name:42} {setup:7.2f}s {seconds:7.2f}s {iterations:10} {residual:9.1e} "
                    f"{negative:>8}"
                ),
                flush=True,
            )


def ways(problem, x, pressure, now):
    """Name, seconds of setup and solve, iterations, residual and negative pivots of each solver."""

    def blocks(stiffness):
        basis = dataclasses.replace(now, stiffness=stiffness)
        return np.asarray(tangent(problem, x, pressure, basis))

    own = now.cut(problem.model)  # in the sizes of the model
    pattern, pairs, stiffness = problem.pattern, blocks(now.stiffness), np.asarray(own.stiffness)
    K, b = (
        sp.csr_matrix(pattern.matrix(pairs)),
        np.random.default_rng(0).normal(size=len(pattern.free)),
    )
    setup, made = timed(factor, pattern, pairs)
    applied = Counted(made.fronts)
    seconds, (solution, _) = timed(dataclasses.replace(made, fronts=applied).solve, b)
    yield "factor", (setup, seconds, applied.times, residual(K, solution, b), made.negative_pivots)
    setup, fronts = timed(factorise, pattern.tree, pattern.entries(pairs).astype(np.float32))
    yield (
        "CG, factor of the rounded tangent",
        (setup, *krylov(sla.cg, K, b, fronts.solve), fronts.negative_pivots),
    )
    near_null = rigid(np.asarray(x))[pattern.free]
    setup, grids = timed(aggregation, K, near_null)
    yield "CG, multigrid", (setup, *krylov(sla.cg, K, b, grids), "-")

    G, volumes, real = volume_gradients(problem.model, own, pattern.free)
    stiffness = stiffness[real]
    network = sp.csr_matrix(pattern.matrix(blocks(0 * now.stiffness)))
    softened = (
        network + G @ sp.diags(np.minimum(stiffness, SOFT * float(problem.gel.Nv)) / volumes) @ G.T
    )
    setup, grids = timed(aggregation, sp.csr_matrix(softened), near_null)
    mixed = sp.block_array([[network, G], [G.T, -sp.diags(volumes / stiffness)]], format="csr")
    schur = volumes / stiffness + volumes / (SOFT * float(problem.gel.Nv))

    def both(v):
        return np.concatenate([grids(v[: len(b)]), v[len(b) :] / schur])

    yield (
        "MINRES on the mixed form, multigrid",
        (setup, *krylov(sla.minres, mixed, np.append(b, np.zeros(len(volumes))), both), "-"),
    )


class Counted:
    """Fronts that count how often they are applied."""

    def __init__(self, fronts):
        self.fronts, self.times = fronts, 0

    def solve(self, rhs):
        self.times += 1
        return self.fronts.solve(rhs)


def aggregation(matrix, near_null):
    """One cycle of smoothed aggregation, as a function of a vector."""
    grids = pyamg.smoothed_aggregation_solver(
        matrix,
        B=near_null,
        symmetry="symmetric",
        strength=("symmetric", {"theta": 0.08}),
        max_coarse=500,
    )
    return grids.aspreconditioner().matvec


def krylov(method, matrix, rhs, preconditioner):
    """Seconds, iterations and relative residual."""
    M, residuals = sla.LinearOperator(matrix.shape, preconditioner, dtype=float), []

    def look(solution):
        residuals.append(residual(matrix, solution, rhs))
        if residuals[-1] < 1e-7:
            raise StopIteration

    begin = time.perf_counter()
    with contextlib.suppress(StopIteration):
        method(matrix, rhs, rtol=1e-16, maxiter=150, M=M, callback=look)
    return time.perf_counter() - begin, len(residuals), residuals[-1]


def residual(matrix, solution, rhs):
    return np.linalg.norm(rhs - matrix @ solution) / np.linalg.norm(rhs)


def rigid(x):
    """Translations and rotation (2 n, 3) of the nodes ``x`` (n, 2)."""
    modes = np.zeros((len(x), 2, 3))
    modes[:, 0, 0] = modes[:, 1, 1] = 1.0
    modes[:, 0, 2], modes[:, 1, 2] = -x[:, 1], x[:, 0]
    return modes.reshape(-1, 3)


def volume_gradients(model, now, free):
    """Gradients (f, g) of the groups' volumes, sparse, and dry volumes (g,), mm^2.

    Third come the numbers of these groups in the model.
    """
    dofs, values = [], []
    for block, gradients in zip(model.blocks, now.gradients, strict=True):
        G = np.swapaxes(gradients, 2, 3)
        own = 2 * np.asarray(block.nodes)[:, None, :, None] + np.arange(2)
        dofs.append(np.broadcast_to(own, G.shape).reshape(-1, G[0, 0].size))
        values.append(G.reshape(-1, G[0, 0].size))
    groups = np.repeat(
        np.arange(sum(map(len, dofs))), np.concatenate([np.full(*some.shape) for some in dofs])
    )
    entries = (
        np.concatenate([v.ravel() for v in values]),
        (np.concatenate([d.ravel() for d in dofs]), groups),
    )
    volumes = np.asarray(all_volumes(model))
    real = volumes > 0  # the others are padding
    return (
        sp.csc_matrix(entries, shape=(2 * model.n_nodes, len(volumes)))[free][:, real],
        volumes[real],
        real,
    )


def timed(function, *args):
    begin = time.perf_counter()
    result = function(*args)
    return time.perf_counter() - begin, result


if __name__ == "__main__":
    main()
