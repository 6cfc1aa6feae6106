"""Essential conditions that are imposed weakly, for shape functions that do not interpolate: a penalty, or Lagrange multipliers.

With the wall's normal displacement u_n(x) = sum_a phi_a (x_a - X_a) . n the energy is extended by

    penalty:    alpha/2 int u_n^2 ds
    lagrange:   int lambda u_n ds, lambda linear between the wall nodes of each edge (Belytschko, Lu & Gu 1994)

so every nodal value is unknown. The Newton step is that of ``mixed``, its tangents those of B-matrices (which take complex shape
functions, where F depends on both components of a node through each of its own), its matrix dense: enough for comparisons, up to a few
thousand nodes. Self-contact is left out.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from ..discretisation import make_probe
from ..geometry import edge_lines
from ..materials import bulk_stiffness, volume_ratio_at
from ..mechanics import ROTATION, ROUND_OFF, all_volumes, by_block, deformation_gradients, energy_at, volume_ratios
from .newton import CONSTRAINT_TOLERANCE, MAX_ITERATIONS, TOLERANCE
from .state import Equilibrium, Status, Step

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)  # on each stretch of wall between two nodes
EPS = np.finfo(float).eps
PATIENCE = 8  # iterations without progress after which Newton's method is given up
STILL = 1e-14  # largest correction over the plate's size that is round-off


@dataclasses.dataclass(frozen=True, eq=False)
class WallProblem:
    """A model prepared for Newton's method with conditions of any kind; N = 2 n degrees of freedom, m multipliers."""

    model: object
    """The ``Model``; all that come from a cloud with one ``method`` are alike to the compiler, whatever their conditions."""
    gel: object
    """The ``Gel``."""
    loads: jax.Array
    """(n, 2) dead nodal loads, kT/v mm."""
    free: np.ndarray
    """(f,) unknown degrees of freedom: all of them where no condition is imposed at nodes."""
    stiffness: np.ndarray
    """(N, N) of the penalty, kT/v; zero without."""
    rows: np.ndarray
    """(m, N) int lambda_i u_n ds of the multipliers, mm; none without."""


def prepare_walls(model, gel, loads, free):
    """``WallProblem`` of a model; ``free`` (f,) are the degrees of freedom that conditions at the nodes would leave."""
    size = 2 * model.n_nodes
    normal, weight, hat = _traces(model)
    stiffness, rows = np.zeros((size, size)), np.zeros((0, size))
    if model.conditions == "penalty":
        stiffness = model.penalty * (normal.T * weight) @ normal
    elif model.conditions == "lagrange":
        rows = (hat.T * weight) @ normal
    free = free if model.conditions == "nodes" else np.arange(size)
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else jnp.asarray(loads, dtype=float)
    model = dataclasses.replace(model, kind="mls", conditions="nodes", penalty=0.0)  # what is left to compute does not depend on them
    return WallProblem(model, gel, loads, free, stiffness, rows)


def wall_step(problem, mu, x, pressure):
    """``Step`` at ``mu`` (whatever its status) from positions ``x`` (n, 2) and pressures (g,); stability is that within the walls."""
    state, matrix = _newton(problem, mu, x, pressure)
    model = problem.model
    return Step(
        mu=float(mu),
        x=np.asarray(state.x),
        pressure=np.asarray(state.pressure),
        status=state.status,
        newton_iterations=state.iterations,
        residual=state.residual,
        energy=float(energy_at(state.x, model, problem.gel, mu, problem.loads)),
        negative_pivots=negative_eigenvalues(matrix) - len(problem.rows) if state.status.ok else -1,
    )


def _newton(problem, mu, x, pressure):
    """``Equilibrium`` and the matrix (f + m, f + m) of its last Newton step."""
    model, free, m = problem.model, problem.free, len(problem.rows)
    dry, multipliers, iterations, moved, matrix = np.asarray(model.cloud.nodes), np.zeros(m), 0, np.inf, None
    x, pressure, stiff = jnp.asarray(x), jnp.asarray(pressure), np.abs(problem.stiffness)
    best, improved = np.inf, 0
    args = model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads
    while True:
        rhs, condensed, now = _residual(x, pressure, *args)
        u = (np.asarray(x) - dry).ravel()
        wall = problem.stiffness @ u + problem.rows.T @ multipliers
        missing = np.asarray(rhs).ravel() - wall
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            scale = float(now["network"]) + np.linalg.norm(wall)
            rounded = EPS * np.linalg.norm(stiff @ np.abs(np.asarray(x)).ravel()) / scale  # the large terms of a stiff penalty cancel
            size = max(np.linalg.norm(missing[free]) / scale, np.linalg.norm(problem.rows @ u) / np.linalg.norm(dry))
        error = float(now["error"])
        if not np.isfinite(size + error):
            return Equilibrium(x, pressure, Status.NOT_FINITE, iterations, size, None), matrix
        allowed = max(TOLERANCE, rounded)
        done = size < allowed and error < CONSTRAINT_TOLERANCE
        if (done and iterations) or moved < STILL:
            return Equilibrium(x, pressure, Status.CONVERGED, iterations, size, None), matrix
        imbalance = max(size / allowed, error / CONSTRAINT_TOLERANCE)
        best, improved = (imbalance, iterations) if imbalance < 0.5 * best else (best, improved)
        if iterations == MAX_ITERATIONS or iterations > improved + PATIENCE:
            return Equilibrium(x, pressure, Status.NOT_CONVERGED, iterations, size, None), matrix
        K = dense(model, _cells(x, pressure, now["stiffness"], model, problem.gel)) + problem.stiffness
        matrix = np.block([[K, problem.rows.T], [problem.rows, np.zeros((m, m))]])
        kept = np.append(free, 2 * model.n_nodes + np.arange(m))
        matrix = matrix[np.ix_(kept, kept)]
        right = np.concatenate([(np.asarray(condensed).ravel() - wall)[free], -problem.rows @ u])
        try:
            solution = np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            return Equilibrium(x, pressure, Status.SINGULAR, iterations, size, None), matrix
        dx = np.zeros(2 * model.n_nodes)
        dx[free] = solution[: len(free)]
        x, pressure = _advance(x, pressure, dx.reshape(-1, 2), now, model)
        multipliers = multipliers + solution[len(free) :]
        iterations, moved = iterations + 1, np.abs(dx).max() / np.abs(dry).max()


def _traces(model):
    """Normal displacement (w, N) at the wall points per nodal displacement, weights (w,), mm, and linear functions (w, m) on the edges."""
    topology, nodes = model.cloud.topology, np.asarray(model.cloud.nodes)
    points, weight, components, hats = [], [], [], []
    for edge, (axis, _) in edge_lines(topology.plate).items():
        held = {"roller": [axis], "fixed": [0, 1], "free": []}[topology.plate.edges[edge]]
        wall = nodes[topology.wall_nodes[edge]]
        start, along = wall[:-1, None], np.diff(wall, axis=0)[:, None]
        s = (1 + POINTS) / 2
        hat = np.zeros((len(start), len(s), len(wall)))
        k = np.arange(len(start))
        hat[k, :, k], hat[k, :, k + 1] = 1 - s, s
        for component in held:
            points.append((start + s[:, None] * along).reshape(-1, 2))
            weight.append((np.linalg.norm(along, axis=2) * WEIGHTS / 2).ravel())
            components.append(np.full(len(weight[-1]), component))
            hats.append(hat.reshape(-1, len(wall)))
    probe = make_probe(model, np.concatenate(points))
    phi, component = np.asarray(probe.phi), np.concatenate(components)
    normal = np.zeros((len(phi), model.n_nodes, 2))
    row, column = np.arange(len(phi))[:, None], np.asarray(probe.nodes)
    np.add.at(normal, (row, column, component[:, None]), phi.real)
    np.add.at(normal, (row, column, 1 - component[:, None]), (2 * component[:, None] - 1) * phi.imag)  # u1 + i u2 = phi (x1 + i x2)
    return normal.reshape(len(phi), -1), np.concatenate(weight), scipy.linalg.block_diag(*hats)


def strain_operators(block):
    """Matrices (c, q, 2, 2, a, 2) that take the values of a cell's nodes to F_ij; complex shape functions mix the components."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    return jnp.einsum("cqaj,ik->cqijak", block.dphi.real, np.eye(2)) + jnp.einsum("cqaj,ik->cqijak", block.dphi.imag, turn)


@jax.jit
def _residual(x, p, model, gel, mu, loads):
    """Loads less internal forces (n, 2), the same condensed, and what a Newton step needs of the state."""
    J, volumes = volume_ratios(x, model), all_volumes(model)
    star = volume_ratio_at(p, mu, gel)
    stiffness, error = bulk_stiffness(star, gel), jnp.where(volumes > 0, J - star, 0.0)
    network = _nodal(lambda F, _: jax.grad(gel.network)(F, gel), x, p, model)
    volumetric, corrected = (_nodal(lambda F, p: p * _cofactor(F), x, q, model) for q in (p, p + stiffness * error))
    worst = jnp.max(jnp.abs(error) / (star - 1 + ROUND_OFF))
    now = dict(stiffness=stiffness, error_by_group=error, error=worst, network=jnp.linalg.norm(network))
    return loads - network - volumetric, loads - network - corrected, now


def _nodal(stress, x, p, model):
    """Nodal forces (n, 2) of ``stress(F, p)`` (2, 2)."""
    total = jnp.zeros_like(x)
    for block, pressure in zip(model.blocks, by_block(p, model), strict=True):
        F = deformation_gradients(x, block)
        P = jax.vmap(jax.vmap(stress))(F, jnp.broadcast_to(pressure, F.shape[:2]))
        total = total.at[block.nodes].add(jnp.einsum("cq,cqij,cqijak->cak", block.weight, P, strain_operators(block)))
    return total


def _cofactor(F):
    return ROTATION @ F @ ROTATION.T


@jax.jit
def _cells(x, p, stiffness, model, gel):
    """Condensed tangents (c, 2 a, 2 a) of all cells, block by block."""
    matrices = []
    volumes = all_volumes(model)
    k_over_V = jnp.where(volumes > 0, stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0)
    for block, pressure, k in zip(model.blocks, by_block(p, model), by_block(k_over_V, model), strict=True):
        F, B = deformation_gradients(x, block), strain_operators(block)
        c, q, a = block.dphi.shape[:3]
        pressure = jnp.broadcast_to(pressure, (c, q))

        def energy(F, p):
            return gel.network(F, gel) + p * (F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0])

        A = jax.vmap(jax.vmap(jax.hessian(energy)))(F, pressure).reshape(c, q, 4, 4)
        B = B.reshape(c, q, 4, 2 * a)
        G = block.weight[..., None] * jnp.einsum("cqi,cqia->cqa", jax.vmap(jax.vmap(_cofactor))(F).reshape(c, q, 4), B)
        G = G.sum(axis=1, keepdims=True) if model.method == "mixed" else G
        weighted = jnp.einsum("cqij,cqja->cqia", block.weight[..., None, None] * A, B)
        K = jnp.einsum("cxa,cxb->cab", B.reshape(c, 4 * q, -1), weighted.reshape(c, 4 * q, -1))
        matrices.append(K + jnp.einsum("cga,cgb->cab", k[..., None] * G, G))
    return matrices


@jax.jit
def _advance(x, p, dx, now, model):
    """Positions and pressures after the step ``dx`` (n, 2): dp = k (G dx / V + J - J*) group by group."""
    change, volumes = [], all_volumes(model)
    for block in model.blocks:
        F, dF = (deformation_gradients(v, block) for v in (x, dx))
        dJ = block.weight * jnp.sum(jax.vmap(jax.vmap(_cofactor))(F) * dF, axis=(2, 3))
        change.append((jnp.sum(dJ, axis=1, keepdims=True) if model.method == "mixed" else dJ).ravel())
    dJ = jnp.concatenate(change) / jnp.where(volumes > 0, volumes, 1.0)
    return x + dx, p + now["stiffness"] * (dJ + now["error_by_group"])


def dense(model, matrices, chunk=256):
    """The sum (N, N) of cell matrices (c, 2 a, 2 a), block by block."""
    size = 2 * model.n_nodes
    total = np.zeros(size * size)
    for block, K in zip(model.blocks, matrices, strict=True):
        dofs = (2 * np.asarray(block.nodes)[:, :, None] + np.arange(2)).reshape(len(K), -1)
        for k in range(0, len(K), chunk):
            part = dofs[k : k + chunk]
            places = (part[:, :, None] * size + part[:, None, :]).ravel()
            total += np.bincount(places, np.asarray(K[k : k + chunk]).ravel(), minlength=size * size)
    return total.reshape(size, size)


def negative_eigenvalues(matrix):
    """Number of negative eigenvalues of a symmetric matrix, from the blocks of its LDL^T."""
    blocks = scipy.linalg.ldl(matrix)[1]
    return int(np.sum(scipy.linalg.eigvalsh_tridiagonal(np.diagonal(blocks), np.diagonal(blocks, 1)) < 0))
