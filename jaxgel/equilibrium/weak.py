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

from .._types import Array, Float, Int, Scalar
from ..discretisation import Model, PatchBlock, make_probe
from ..geometry import edge_lines
from ..linalg import SingularTangent
from ..materials import Gel
from ..mechanics import (
    ROUND_OFF,
    all_volumes,
    by_block,
    carries_volume,
    contents,
    deformation_gradients,
    energy_at,
    linearised_about,
    network_energy,
    stiffness_at,
    volume_ratios,
)
from .newton import CONSTRAINT_TOLERANCE, MAX_ITERATIONS, TOLERANCE, iterate
from .state import Stability, State

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)  # on each stretch of wall between two nodes
EPS = np.finfo(float).eps
PATIENCE = 8  # iterations without progress after which Newton's method is given up
STILL = 1e-14  # largest correction over the plate's size that is round-off


@dataclasses.dataclass(frozen=True, eq=False)
class WeakProblem:
    """A model prepared for Newton's method with conditions of any kind; N = 2 n degrees of freedom, m multipliers."""

    model: Model
    """The model; all that come from a cloud with one ``method`` are alike to the compiler, whatever their conditions."""
    gel: Gel
    """Material."""
    loads: Float[Array, "n 2"]
    """Dead nodal loads, kT/v mm."""
    free: Int[np.ndarray, " f"]
    """Unknown degrees of freedom: all of them where no condition is imposed at nodes."""
    stiffness: Float[np.ndarray, "N N"]
    """Of the penalty, kT/v; zero without."""
    rows: Float[np.ndarray, "m N"]
    """int lambda_i u_n ds of the multipliers, mm; none without."""


def prepare_weak(model: Model, gel: Gel, loads: Float[Array, "n 2"] | None, free: Int[np.ndarray, " f"] | None) -> WeakProblem:
    """`WeakProblem` of a model; ``free`` are the degrees of freedom that conditions at the nodes leave; others need none."""
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
    return WeakProblem(model, gel, loads, free, stiffness, rows)


def solve_weak(problem: WeakProblem, mu: Scalar, x: Float[Array, "n 2"], pressure: Float[Array, " g"]) -> State:
    """`State` at ``mu`` (whatever its status) from positions ``x`` and pressures; its stability is that within the edges."""
    correction = _WeakCorrection(np.zeros(len(problem.rows)))
    found = iterate(problem, State(float(mu), jnp.asarray(x), jnp.asarray(pressure)), correction)
    energy = float(energy_at(found.x, problem.model, problem.gel, mu, problem.loads))
    found = dataclasses.replace(found, x=np.asarray(found.x), pressure=np.asarray(found.pressure), energy=energy)
    if not found.status.ok:
        return found
    negative = negative_eigenvalues(correction.matrix) - len(problem.rows)
    return dataclasses.replace(found, stability=Stability(np.array([np.nan]), None, negative))


@dataclasses.dataclass
class _WeakCorrection:
    """Newton's corrections with a dense matrix of the displacements and multipliers."""

    multipliers: np.ndarray
    matrix: np.ndarray | None = None
    """(f + m, f + m) of the last correction."""
    moved: float = np.inf
    best: float = np.inf
    improved: int = 0
    terms: tuple = ()
    """Condensed right-hand side (n, 2), reactions of the edges (N,), displacements (N,) and `_residual`'s last value at the iterate."""

    def assess(self, problem, state):
        rhs, condensed, parts = _residual(state.x, state.pressure, problem.model, problem.gel, jnp.asarray(state.mu), problem.loads)
        dry, x = np.asarray(problem.model.cloud.nodes), np.asarray(state.x)
        u = (x - dry).ravel()
        reaction = problem.stiffness @ u + problem.rows.T @ self.multipliers
        missing = np.asarray(rhs).ravel() - reaction
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            scale = float(parts["network"]) + np.linalg.norm(reaction)
            rounded = EPS * np.linalg.norm(np.abs(problem.stiffness) @ np.abs(x).ravel()) / scale  # large terms of a stiff penalty cancel
            size = max(np.linalg.norm(missing[problem.free]) / scale, np.linalg.norm(problem.rows @ u) / np.linalg.norm(dry))
        self.terms = condensed, reaction, u, parts
        error, allowed = float(parts["error"]), max(TOLERANCE, rounded)
        total = max(size / allowed, error / CONSTRAINT_TOLERANCE)
        if total < 0.5 * self.best:
            self.best, self.improved = total, state.newton_iterations
        solved = size < allowed and error < CONSTRAINT_TOLERANCE and state.newton_iterations > 0
        return size if np.isfinite(error) else np.nan, solved or self.moved < STILL

    def exhausted(self, state):
        return state.newton_iterations >= MAX_ITERATIONS or state.newton_iterations > self.improved + PATIENCE

    def __call__(self, problem, state):
        model, free, m = problem.model, problem.free, len(problem.rows)
        condensed, reaction, u, parts = self.terms
        K = dense(model, _patches(state.x, state.pressure, parts["stiffness"], model, problem.gel)) + problem.stiffness
        matrix = np.block([[K, problem.rows.T], [problem.rows, np.zeros((m, m))]])
        kept = np.append(free, 2 * model.n_nodes + np.arange(m))
        self.matrix = matrix[np.ix_(kept, kept)]
        right = np.concatenate([(np.asarray(condensed).ravel() - reaction)[free], -problem.rows @ u])
        try:
            solution = np.linalg.solve(self.matrix, right)
        except np.linalg.LinAlgError as error:
            raise SingularTangent(str(error)) from error
        dx = np.zeros(2 * model.n_nodes)
        dx[free] = solution[: len(free)]
        x, pressure = _advance(state.x, state.pressure, dx.reshape(-1, 2), parts, model)
        self.multipliers = self.multipliers + solution[len(free) :]
        self.moved = np.abs(dx).max() / np.abs(np.asarray(model.cloud.nodes)).max()
        return State(state.mu, x, pressure, newton_iterations=state.newton_iterations + 1)

    def finish(self, problem, state):  # noqa: ARG002
        return state


def _traces(model):
    """Normal displacement (w, N) at the wall points per nodal displacement, weights (w,), mm, and linear functions (w, m) on the edges."""
    topology, nodes = model.cloud.topology, np.asarray(model.cloud.nodes)
    points, weight, components, hats = [], [], [], []
    for edge, (axis, _) in edge_lines(topology.plate).items():
        held = {"roller": [axis], "fixed": [0, 1], "free": []}[topology.plate.edges[edge]]
        wall = nodes[topology.edge_nodes[edge]]
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


def strain_operators(block: PatchBlock) -> Float[Array, "c q 2 2 a 2"]:
    """Matrices (c, q, 2, 2, a, 2) that take the values of a patch's nodes to F_ij; complex shape functions mix the components."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    return jnp.einsum("cqaj,ik->cqijak", block.dphi.real, np.eye(2)) + jnp.einsum("cqaj,ik->cqijak", block.dphi.imag, turn)


@jax.jit
def _residual(x, p, model, gel, mu, loads):
    """Loads less internal forces (n, 2), the same condensed, and what a Newton step needs of the state."""
    J, volumes = volume_ratios(x, model), all_volumes(model)
    about, gap = linearised_about(p, J, model, gel, mu)
    stiffness, error = stiffness_at(about, model, gel, mu), jnp.where(volumes > 0, J - about, 0.0)
    network = jax.grad(network_energy)(x, model, gel)
    volumetric, corrected = (jax.grad(_work)(x, q, model) for q in (p, p + stiffness * error + gap))
    swelling = jnp.where(carries_volume(model), about - 1, 0.0)
    worst = jnp.max((jnp.abs(error) + jnp.abs(gap) / gel.Nv) / (swelling + ROUND_OFF))
    now = dict(stiffness=stiffness, error_by_group=error, gap=gap, error=worst, network=jnp.linalg.norm(network))
    return loads - network - volumetric, loads - network - corrected, now


def _work(x, p, model):
    """Sum of p V J over all volume groups."""
    return jnp.sum(p * all_volumes(model) * volume_ratios(x, model))


@jax.jit
def _patches(x, p, stiffness, model, gel):
    """Condensed tangents (c, 2 a, 2 a) of all patches, block by block."""
    matrices = []
    volumes = all_volumes(model)
    k_over_V = jnp.where(volumes > 0, stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0)
    for block, pressure, k in zip(model.blocks, by_block(p, model), by_block(k_over_V, model), strict=True):
        F, B = deformation_gradients(x, block), strain_operators(block)
        c, q, a = block.dphi.shape[:3]
        A, B = jax.vmap(jax.vmap(jax.hessian(lambda F: gel.network(F, gel))))(F).reshape(c, q, 4, 4), B.reshape(c, q, 4, 2 * a)
        weighted = jnp.einsum("cqij,cqja->cqia", block.weight[..., None, None] * A, B)
        K = jnp.einsum("cxa,cxb->cab", B.reshape(c, 4 * q, -1), weighted.reshape(c, 4 * q, -1))
        alone = jax.tree.map(lambda v: v[:, None], dataclasses.replace(block, nodes=jnp.tile(jnp.arange(a), (c, 1))))

        def volume_terms(x, p, k, one):
            def content(x):
                return contents(deformation_gradients(x, one), x, one)[0]

            G = jax.jacobian(content)(x).reshape(len(p), -1)
            return jax.hessian(lambda x: p @ content(x))(x).reshape(x.size, x.size) + (k[:, None] * G).T @ G

        matrices.append(K + jax.vmap(volume_terms)(x[block.nodes], pressure, k, alone))
    return matrices


@jax.jit
def _advance(x, p, dx, now, model):
    """Positions and pressures after the step ``dx`` (n, 2): dp = k (G dx / V + J - J0) + p(J0) - p group by group, see ``mixed``."""
    dJ = jax.jvp(lambda x: volume_ratios(x, model), (x,), (dx,))[1]
    return x + dx, p + now["stiffness"] * (dJ + now["error_by_group"]) + now["gap"]


def dense(model: Model, matrices: list, chunk: int = 256) -> Float[np.ndarray, "N N"]:
    """The sum (N, N) of the patches' matrices (c, 2 a, 2 a), block by block."""
    size = 2 * model.n_nodes
    total = np.zeros(size * size)
    for block, K in zip(model.blocks, matrices, strict=True):
        dofs = (2 * np.asarray(block.nodes)[:, :, None] + np.arange(2)).reshape(len(K), -1)
        for k in range(0, len(K), chunk):
            part = dofs[k : k + chunk]
            indices = (part[:, :, None] * size + part[:, None, :]).ravel()
            total += np.bincount(indices, np.asarray(K[k : k + chunk]).ravel(), minlength=size * size)
    return total.reshape(size, size)


def negative_eigenvalues(matrix: Float[np.ndarray, "f f"]) -> int:
    """Number of negative eigenvalues of a symmetric matrix, from the blocks of its LDL^T."""
    blocks = scipy.linalg.ldl(matrix)[1]
    return int(np.sum(scipy.linalg.eigvalsh_tridiagonal(np.diagonal(blocks), np.diagonal(blocks, 1)) < 0))
