"""The paper's own algorithm: increments of the displacement u' from the freely swollen plate C_mu, Deng et al. (2020), Eqs. (41)-(58).

At each mu the dry plate swells freely by l_mu, x' = l_mu X, and its rollers are then brought back, u' = (1 - l_mu) X, while

    (K_L0 + K_L1 + K_NL) du' = f_1 - f_2

is solved until f_1 = f_2. Stress S and tangent D are those of Eqs. (6)-(9), J is taken at every quadrature point. In C_mu gradients are
divided by l_mu and areas multiplied by J_mu = l_mu^2. Matrices are dense: enough for comparisons. Index letters as in
``discretisation``; ``v`` counts the rows of the paper's matrices.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Inexact, Int, Scalar
from ..discretisation import Model
from ..linalg import SingularTangent
from ..materials import Gel, flory_rehner, free_swelling, neo_hookean, paper_stress, paper_tangent, voigt
from ..mechanics import energy_at, state_pressure, volume_ratios
from .newton import MAX_ITERATIONS, TOLERANCE, iterate
from .state import Stability, State
from .weak import dense, negative_eigenvalues

MARGIN = 0.2  # share of the least swelling J - 1 that an increment leaves
LEAST_SHARE = 1 / 64  # of an increment, or of the way of the rollers


@dataclasses.dataclass(frozen=True, eq=False)
class IncrementalProblem:
    """A model prepared for the paper's algorithm."""

    model: Model
    """Of method "displacement"."""
    gel: Gel
    """Material."""
    loads: Float[Array, "n 2"]
    """Dead nodal loads, kT/v mm: f_1."""
    free: Int[np.ndarray, " f"]
    """Numbers of the free degrees of freedom."""


def prepare_incremental(model: Model, gel: Gel, loads: Float[Array, "n 2"] | None, free: Int[np.ndarray, " f"]) -> IncrementalProblem:
    """``IncrementalProblem``; ValueError for a model or gel whose equations the paper does not give."""
    if model.method != "displacement" or model.conditions != "nodes":
        given = f"{model.method!r} and {model.conditions!r}"
        raise ValueError(f"formulation: 'incremental' needs method 'displacement' and conditions at the 'nodes', not {given}")
    if gel.network is not neo_hookean or gel.volumetric is not flory_rehner:
        raise ValueError("formulation: 'incremental' needs the Flory-Rehner energy; use 'total' for others")
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else jnp.asarray(loads, dtype=float)
    return IncrementalProblem(model, gel, loads, free)


def solve_incremental(problem: IncrementalProblem, mu: Scalar, start: Float[Array, "n 2"] | None) -> State:
    """`State` at ``mu`` from nodal positions ``start`` of another state, or from free swelling where that is None."""
    dry, stretch = np.asarray(problem.model.cloud.nodes), float(free_swelling(mu, problem.gel))
    if start is None:
        found, matrix = _pushed_back(problem, mu, stretch)
    else:
        found, matrix = _incremented(problem, mu, stretch, np.asarray(start) - stretch * dry, 1.0)
    x = stretch * dry + found.x
    model, gel = problem.model, problem.gel
    return dataclasses.replace(
        found,
        x=x,
        pressure=np.asarray(state_pressure(jnp.asarray(x), model, gel, mu)),
        energy=float(energy_at(jnp.asarray(x), model, gel, mu, problem.loads)),
        stability=Stability(np.array([np.nan]), None, negative_eigenvalues(matrix)) if found.status.ok else None,
    )


def _pushed_back(problem, mu, stretch):
    """`_incremented` with rollers that return from the freely swollen plate's edges to their place, in one go or in parts."""
    u, share, part, spent = np.zeros((problem.model.n_nodes, 2)), 0.0, 1.0, 0
    while True:
        found, matrix = _incremented(problem, mu, stretch, u, min(1.0, share + part))
        spent += found.newton_iterations
        if found.status.ok:
            u, share = found.x, min(1.0, share + part)
        else:
            part /= 2
        if share == 1.0 or part < LEAST_SHARE:
            return dataclasses.replace(found, newton_iterations=spent), matrix


def _incremented(problem, mu, stretch, u, share):
    """`State` whose ``x`` is u' (n, 2), with u' = share (1 - l) X on the rollers, and the last free-free matrix (f, f)."""
    dry = np.asarray(problem.model.cloud.nodes)
    held = np.setdiff1d(np.arange(dry.size), problem.free)
    target = share * (1 - stretch) * dry.ravel()[held]
    correction = _Increment(stretch, held, target, _least_swelling(u, stretch, problem.model))
    found = iterate(problem, State(float(mu), np.array(u, dtype=float), np.zeros(0)), correction)
    return found, correction.matrix


@dataclasses.dataclass
class _Increment:
    """The paper's increments du', Eq. (57), shortened so that every volume ratio stays above 1."""

    stretch: float
    held: np.ndarray
    target: np.ndarray
    """u' of the held degrees of freedom."""
    least: float
    """Smallest J - 1 of the iterate."""
    matrix: np.ndarray | None = None
    terms: tuple = ()
    """Matrices of the cells, residual (N,) and what the held degrees of freedom miss of their target."""

    def assess(self, problem, state):
        matrices, force, network = _matrices(jnp.asarray(state.x), self.stretch, state.mu, problem.model, problem.gel)
        residual = (np.asarray(problem.loads) - np.asarray(force)).ravel()
        missing = self.target - state.x.ravel()[self.held]
        self.terms = matrices, residual, missing
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            size = float(np.linalg.norm(residual[problem.free]) / float(network))
        met = np.abs(missing).max(initial=0.0) < 1e-14 * np.abs(np.asarray(problem.model.cloud.nodes)).max()
        return size if self.least > 0 else np.nan, size < TOLERANCE and bool(met) and self.matrix is not None

    def exhausted(self, state):
        return state.newton_iterations >= MAX_ITERATIONS

    def __call__(self, problem, state):
        free, held, u = problem.free, self.held, state.x
        matrices, residual, missing = self.terms
        K = dense(problem.model, matrices)
        self.matrix = K[np.ix_(free, free)]
        du = np.zeros(u.size)
        du[held] = missing
        try:
            du[free] = np.linalg.solve(self.matrix, residual[free] - K[np.ix_(free, held)] @ missing)
        except np.linalg.LinAlgError as error:
            raise SingularTangent(str(error)) from error
        du, part, before = du.reshape(u.shape), 1.0, self.least
        while True:
            self.least = _least_swelling(u + part * du, self.stretch, problem.model)
            if self.least > MARGIN * before or part <= LEAST_SHARE:
                break
            part /= 2
        return dataclasses.replace(state, x=u + part * du, newton_iterations=state.newton_iterations + 1)

    def finish(self, problem, state):  # noqa: ARG002
        return state


def _least_swelling(u, stretch, model):
    """Smallest J - 1 of all quadrature points."""
    return float(jnp.min(_volume_ratios(stretch * model.cloud.nodes + u, model))) - 1


_volume_ratios = jax.jit(volume_ratios)


@jax.jit
def _matrices(u, stretch, mu, model, gel):
    """Matrices K_L0 + K_L1 + K_NL (c, 2 a, 2 a) of all cells, block by block, f_2 (n, 2), and the norm of the network's part of it."""
    force, network, matrices = jnp.zeros_like(u), jnp.zeros_like(u), []
    for block in model.blocks:
        phi, weight = block.dphi / stretch, block.weight * stretch**2  # in C_mu
        values = u[block.nodes]
        z = values[..., 0] + 1j * values[..., 1]
        slope = jnp.einsum("ca,cqaj->cqj", z, phi)
        L = jnp.stack([slope.real, slope.imag], axis=2)  # L_ij = du'_i / dX_j
        parts = jax.vmap(jax.vmap(lambda phi, L: _point(phi, L, mu, gel)))(phi, L)
        K, f_2, stretched = (jnp.einsum("cq,cq...->c...", weight, part) for part in parts)
        matrices.append(K)
        force = force.at[block.nodes].add(f_2.reshape(*block.nodes.shape, 2))
        network = network.at[block.nodes].add(stretched.reshape(*block.nodes.shape, 2))
    return matrices, force, jnp.linalg.norm(network)


def _point(phi, L, mu, gel):
    """Integrands at one point: of K (2 a, 2 a), Eqs. (47)-(49), of f_2 (2 a,), Eq. (51), and its network part."""
    F = jnp.eye(2) + L
    G = F.T @ F
    stretch = free_swelling(mu, gel)
    S, D = paper_stress(G, mu, gel, stretch), voigt(paper_tangent(G, mu, gel, stretch))
    B_L0, B_L1, B = strain_matrices(phi, L)
    S_hat = jnp.kron(jnp.eye(2), S)  # Eq. (55)
    K_NL = B.T @ S_hat @ B
    K_L = (B_L0 + B_L1).T @ D @ (B_L0 + B_L1)  # K_L0 + K_L1, the three products of Eq. (48) included
    S_vector = jnp.stack([S[0, 0], S[1, 1], S[0, 1]])  # Eq. (56)
    return K_L + K_NL, (B_L0 + B_L1).T @ S_vector, (B_L0 + B_L1).T @ (gel.Nv * jnp.array([1.0, 1.0, 0.0]))


def strain_matrices(phi: Inexact[Array, "a 2"], L: Float[Array, "2 2"]) -> tuple[jax.Array, jax.Array, jax.Array]:
    """B_L0 (3, 2 a), B_L1 (3, 2 a) and B (4, 2 a), Eqs. (52)-(54), of shape function gradients (a, 2), real or complex, and L (2, 2)."""
    r1, r2, i1, i2 = phi[:, 0].real, phi[:, 1].real, phi[:, 0].imag, phi[:, 1].imag

    def rows(first, second):
        return jnp.stack([jnp.stack(first), jnp.stack(second)], axis=-1).reshape(len(first), -1)

    (L11, L12), (L21, L22) = L
    B_L0 = rows([r1, i2, r2 + i1], [-i1, r2, -i2 + r1])
    B_L1 = rows(
        [L11 * r1 + L21 * i1, L12 * r2 + L22 * i2, L11 * r2 + L12 * r1 + L21 * i2 + L22 * i1],
        [-L11 * i1 + L21 * r1, -L12 * i2 + L22 * r2, -L11 * i2 - L12 * i1 + L21 * r2 + L22 * r1],
    )
    return B_L0, B_L1, rows([r1, r2, i1, i2], [-i1, -i2, r1, r2])
