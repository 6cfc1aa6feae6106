"""Critical points of a branch: where an eigenvalue of its tangent vanishes, what kind of point that is, and how it moves with the design.

At a bifurcation the state is symmetric and the mode v is not. A cloud is not as symmetric as its plate, so a small force along v holds
the state where the energy's third derivative along v vanishes: there the eigenvalue is stationary in the amplitude of the mode, and the
critical mu is free of the cloud's imperfection to first order. At a fold v . dr/dmu is not zero, and no force is needed.

Derivative: lambda = v . K v = phi(x, theta, mu) with the modes normalised. Its change with theta at fixed x, and by the state's motion
dx = -K^-1 dr across the mode, is that of phi - w . r with K w = dphi/dx across the mode; the modes' own motion drops out. With
Phi = phi - w . r at fixed x, v, w:  d mu_c = -(dPhi/dtheta) / (dPhi/dmu). For a double eigenvalue phi is the sum over both modes. At a
fold Phi = v . r.
"""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Scalar
from ..discretisation import Model
from ..equilibrium import Conditions, Stability, first_order_only, mu_force, solve, solve_bordered
from ..linalg import Bordered, nearest_modes
from ..materials import Gel
from ..mechanics import Problem, curvature, free_dofs, gather, prepare, prescribed_motion, residual, restrict, scatter
from .autodiff import is_traced
from .options import check_mu
from .path import Path
from .stability import StabilityAnalysis, oriented
from .sweeps import sweep
from .symmetry import characters, symmetries

ITERATIONS = 15
TOLERANCE = 1e-9  # of a critical mu, kT
TOGETHER = 5e-3  # crossings closer than this in mu are searched as one multiple eigenvalue
KEPT = 0.5  # a symmetry takes at most this share of a simple mode to other modes


@dataclasses.dataclass(frozen=True, eq=False)
class CriticalPoint:
    """A state of a branch with a vanishing eigenvalue of multiplicity m."""

    mu: Scalar
    """Chemical potential, kT; differentiable with respect to the model and the gel."""
    kind: str
    """"bifurcation" or "fold"."""
    x: Float[Array, "n 2"]
    """Nodal positions, mm."""
    pressure: Float[Array, " g"]
    """Pressures of the volume groups, kT/v."""
    modes: Float[np.ndarray, "m n 2"]
    """Modes, normalised and signed as in ``stability``."""
    eigenvalues: Float[np.ndarray, " m"]
    """Eigenvalues that are left at mu: round-off, or half the split of a double one on an unsymmetric cloud."""
    slope: float
    """d lambda / d mu along the branch, mean over the modes; at a fold -dr/dmu . v."""
    curvature: float
    """d^2 mu / d a^2 along the branch that leaves, a the amplitude of the mode: stable branch above mu if positive; nan if m > 1."""
    imperfection: float
    """Size of the force that holds the state on its branch, over that which would hold an amplitude of one spacing in the network."""
    symmetries: dict[str, float]
    """Name of each symmetry of the cloud -> character of the modes: 1 keeps a simple mode, -1 reverses it."""
    unstable: int
    """Negative eigenvalues of the branch just before the point."""
    correction: Float[np.ndarray, "n 2"]
    """Field w of the derivative, see the module."""

    @property
    def multiplicity(self) -> int:
        """Number of modes."""
        return len(self.modes)

    @property
    def text(self) -> str:
        """One line that says what it is."""
        if self.kind == "fold":
            return "fold: the branch turns back"
        side = "" if np.isnan(self.curvature) else ", supercritical" if self.curvature > 0 else ", subcritical"
        kept = [name for name, character in self.symmetries.items() if self.multiplicity == 1 and character > KEPT]
        broken = [name for name, character in self.symmetries.items() if self.multiplicity == 1 and character < -KEPT]
        said = "; ".join(f"{word} {', '.join(names)}" for word, names in (("keeps", kept), ("breaks", broken)) if names)
        return f"{('', 'simple', 'double')[min(self.multiplicity, 2)]} bifurcation{side}" + (f"; the mode {said}" if said else "")


def critical_points(
    model: Model, gel: Gel, *, mu: tuple[float, float], loads: Float[Array, "n 2"] | None = None, most: int = 4
) -> list["CriticalPoint"]:
    """``CriticalPoint``s of the branch that continues the dry state, in the order of mu in ``mu = (first, last)``; at most ``most``.

    They are located to ``TOLERANCE``; a fold where the branch turns back, if it does (on other branches: see ``folds``).
    ``point.mu`` is differentiable once in everything the model and the gel depend on, forward and reverse; derivatives for designs that
    break the symmetry are those of the perfect branch, for a double eigenvalue those of the mean. ValueError inside jit or vmap and
    for second derivatives.
    """
    check_mu(mu)
    if not (isinstance(mu, tuple) and len(mu) == 2):
        raise ValueError(f"mu: {mu} is not accepted, it must be a tuple (first, last)")
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else loads
    if not is_traced((model, gel, loads)):
        return _locate_all(model, gel, mu, loads, most)
    gel = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), gel)
    search = _Search(tuple(map(float, mu)), most)
    leaves, structure = jax.tree.flatten((model, gel, loads))
    values = _located(search, structure, leaves)
    return [dataclasses.replace(point, mu=value) for point, value in zip(search.points, values, strict=True)]


def folds(path: Path, loads: Float[Array, "n 2"] | None = None) -> list["CriticalPoint"]:
    """``CriticalPoint``s of kind "fold" where mu turns along a ``Path`` of `switch` or `continue_branch`; not differentiable."""
    frame, rise = _Frame.of(prepare(path.model, path.gel, loads)), np.diff(path.mu)
    states = [path[k] for k in range(len(path))]
    turns = np.flatnonzero(rise[1:] * rise[:-1] < 0)
    return [point for k in turns for point in _fold(frame, states[k], states[k + 1])]


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    """What a traced search looks for, and the points it found: its result, but for mu, is on the host. Hashed by identity."""

    mu: tuple
    most: int
    points: list = dataclasses.field(default_factory=list)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _located(search, structure, leaves):
    """Critical mu (k,)."""
    if is_traced(leaves):
        raise ValueError("critical_points: is not available inside jit or vmap")
    model, gel, loads = jax.tree.unflatten(structure, leaves)
    search.points[:] = _locate_all(model, gel, search.mu, loads, search.most)
    return jnp.array([point.mu for point in search.points])


@_located.defjvp
def _located_jvp(search, structure, primals, tangents):
    mu = first_order_only(_located(search, structure, *primals), "critical_points")
    inputs, dots = jax.tree.unflatten(structure, primals[0]), jax.tree.unflatten(structure, tangents[0])
    found = [_onset_tangent(p.x, p.modes, p.correction, p.mu, inputs, dots, fold=p.kind == "fold") for p in search.points]
    return mu, jnp.stack(found) if found else jnp.zeros(0)


@functools.partial(jax.jit, static_argnames="fold")
def _onset_tangent(x, modes, correction, mu, inputs, dots, *, fold):
    """Tangent () of a critical mu: -(dPhi . dots) / (dPhi/dmu) at fixed x, v, w; constrained nodes move with the dry plate."""
    topology = inputs[0].lists.topology
    free = free_dofs(topology)

    def onset(model, gel, loads, mu):
        nodes = model.cloud.nodes
        at = x + prescribed_motion(nodes - jax.lax.stop_gradient(nodes), topology.plate, free)
        r = residual(at, model, gel, mu, loads)
        if fold:
            return jnp.sum(modes[0] * r)
        return sum(curvature(at, v, model, gel, mu, loads) for v in modes) - jnp.sum(correction * r)

    _, change = jax.jvp(lambda *inputs: onset(*inputs, mu), inputs, dots)
    return -change / jax.grad(onset, argnums=3)(*inputs, mu)


def _locate_all(model, gel, mu, loads, most):
    steps = []
    path = sweep(model, gel, mu=tuple(map(float, mu)), branch="symmetric", loads=loads, on_step=lambda state: steps.append(state.light))
    frame = _Frame.of(prepare(model, gel, loads))
    points = []
    for earlier, (before, after) in zip([None, *steps], itertools.pairwise(steps), strict=False):
        if len(points) == most:
            break
        if before.negative_pivots != after.negative_pivots:
            for point in _between(frame, earlier, before, after):
                again = point.multiplicity > 1 and any(abs(point.mu - other.mu) < TOGETHER for other in points)
                points += [] if again else [point]  # an unsymmetric cloud splits a double one
        elif earlier is not None and _ends_before(earlier, before, after.mu):
            points += [fold for fold in _fold(frame, earlier, before) if before.mu < fold.mu < after.mu]
    if not path.stop.ok and len(points) < most and len(steps) > 1:
        points += _fold(frame, *steps[-2:])
    return sorted(points, key=lambda point: point.mu)[:most]


def _ends_before(earlier, before, mu):
    """Whether two stable steps head for a fold below ``mu``, where the square of the lowest eigenvalue, linear in mu, vanishes."""
    far, near = earlier.lowest_eigenvalue**2, before.lowest_eigenvalue**2
    return before.negative_pivots == 0 and far > near and before.mu + (before.mu - earlier.mu) * near / (far - near) < mu


@dataclasses.dataclass(frozen=True, eq=False)
class _Frame:
    """What the search of all points shares."""

    problem: Problem
    analysis: StabilityAnalysis
    permutations: dict

    @classmethod
    def of(cls, problem):
        return cls(problem, StabilityAnalysis(problem), symmetries(problem.model))

    @property
    def stiffness(self):
        return self.analysis.stiffness


def _between(frame, before, low, high):
    """Critical points between two states with different numbers of negative eigenvalues; halves the interval until they are apart.

    Where Newton's method leapt from one side of a fold to the other there is no bifurcation: then the branch is followed from ``low``,
    in the direction from the state ``before`` it (None without one).
    """
    crossings, close = high.negative_pivots - low.negative_pivots, high.mu - low.mu < TOGETHER
    if crossings == 0:
        return []
    point = _bifurcation(frame, low, high, abs(crossings)) if abs(crossings) == 1 or close else None
    if point is not None:
        return [point]
    mu = 0.5 * (low.mu + high.mu)
    middle = None if close else solve(frame.problem, mu, 0.5 * (low.x + high.x), 0.5 * (low.pressure + high.pressure), own_factor=True)
    if middle is None or not middle.status.ok:
        found = _fold(frame, before, low) if before is not None else []
        return [fold for fold in found if low.mu - TOGETHER < fold.mu < high.mu + TOGETHER]
    count = Stability(np.array([np.nan]), None, middle.factor.negative_pivots)
    middle = dataclasses.replace(middle.light, stability=count)
    return _between(frame, before, low, middle) + _between(frame, low, middle, high)


def _bifurcation(frame, low, high, multiplicity):
    """``CriticalPoint`` between two states by Newton's method on the mean eigenvalue and a simple mode's amplitude; None if it fails."""
    problem = frame.problem

    def between(mu):
        t = (mu - low.mu) / (high.mu - low.mu)
        return (1 - t) * low.x + t * high.x, (1 - t) * low.pressure + t * high.pressure

    mu, modes, amplitude, limit = 0.5 * (low.mu + high.mu), None, np.zeros(multiplicity), 0.1 * problem.model.cloud.spacing
    for _ in range(ITERATIONS):
        x, pressure = between(mu)
        if modes is None:
            state = solve(problem, mu, x, pressure, own_factor=True)
            if not state.status.ok:
                return None
            _, modes = nearest_modes(state.factor, frame.stiffness, multiplicity)
            if multiplicity == 1 and not _alone(frame, modes, x):
                multiplicity, amplitude = 2, np.zeros(2)
                _, modes = nearest_modes(state.factor, frame.stiffness, 2)
        held = frame.stiffness @ modes
        pins = Conditions(held, np.zeros(multiplicity), x, mu, amplitude)
        state, forces = solve_bordered(problem, mu, x, pressure, held, pins)
        if not state.status.ok:
            return None
        eigenvalues, modes = nearest_modes(state.factor, frame.stiffness, multiplicity, modes)
        local = _expand(frame, state, modes)
        step = -np.mean(eigenvalues) / local.slope
        if multiplicity == 1:  # to where the third derivative vanishes
            most = limit / np.abs(modes).max()
            amplitude = amplitude - np.clip(local.cubic / local.quartic, -most, most)
        if abs(step) < TOLERANCE:
            return _point(frame, state, mu + step, modes, eigenvalues, local, forces, low.negative_pivots)
        mu += step
        if not low.mu - TOGETHER <= mu <= high.mu + TOGETHER:
            return None
    return None


def _alone(frame, modes, x):
    """Whether the symmetries of the cloud keep or reverse the first mode (f, m); where one turns it into another there are two."""
    field = np.asarray(scatter(modes[:, 0], x.shape, frame.problem.free))
    return all(abs(character) > KEPT for character in characters(field[None], frame.permutations).values())


@dataclasses.dataclass(frozen=True, eq=False)
class _Expansion:
    """Derivatives of the energy at a state along its modes, the other directions in equilibrium."""

    slope: float
    """d lambda / d mu, mean over the modes."""
    cubic: float
    """Third derivative of the energy along the first mode."""
    quartic: float
    """Fourth derivative along the first mode, relaxed; nan for several modes."""
    correction: np.ndarray
    """(f,) w = K^-1 (dphi/dx) across the modes."""


def _expand(frame, state, modes):
    """``_Expansion`` at a state with a factor of its own tangent; ``modes`` (f, m)."""
    problem, m = frame.problem, modes.shape[1]
    fields = jnp.stack([scatter(v, state.x.shape, problem.free) for v in modes.T])
    slope, gradient, cubic, quartic = _derivatives(problem, state.x, fields, jnp.asarray(state.mu))
    gradient = np.asarray(gather(gradient, problem.free))
    held = frame.stiffness @ modes
    system = Bordered(state.factor.pattern.tree.order, state.factor.matrix, held, held, np.zeros((m, m)))
    correction, _ = system.solve(gradient, np.zeros(m))
    slope = (float(slope) - correction @ mu_force(problem, state.x, state.mu)) / m
    relaxed = float(quartic) - 3 * gradient @ correction if m == 1 else float("nan")
    return _Expansion(slope, float(cubic), relaxed, correction)


@jax.jit
def _derivatives(problem, x, modes, mu):
    """D phi / d mu, d phi / dx (n, 2), and the third and fourth derivative of the energy along the first mode."""
    model, gel, loads = problem.model, problem.gel, problem.loads

    def phi(x, mu):
        return sum(curvature(x, v, model, gel, mu, loads) for v in modes)

    gradient, slope = jax.grad(phi, argnums=(0, 1))(x, mu)

    def along(t):
        return curvature(x + t * modes[0], modes[0], model, gel, mu, loads)

    def third(t):
        return jax.jvp(along, (t,), (1.0,))[1]

    cubic, quartic = jax.jvp(third, (0.0,), (1.0,))
    return slope, gradient, cubic, quartic


def _point(frame, state, mu, modes, eigenvalues, local, forces, unstable, kind="bifurcation"):
    problem, shape = frame.problem, state.x.shape
    signed = oriented(modes, problem)
    fields = np.stack([np.asarray(scatter(v, shape, problem.free)) for v in signed.T])
    spacing = problem.model.cloud.spacing
    return CriticalPoint(
        mu=float(mu),
        kind=kind,
        x=np.asarray(state.x),
        pressure=np.asarray(state.pressure),
        modes=fields,
        eigenvalues=np.asarray(eigenvalues),
        slope=float(local.slope),
        curvature=-local.quartic / (3 * local.slope) if kind == "bifurcation" else float("nan"),
        imperfection=float(np.linalg.norm(forces) * np.abs(fields).max() / spacing),
        symmetries=characters(fields, frame.permutations),
        unstable=int(unstable),
        correction=np.asarray(scatter(local.correction, shape, problem.free)),
    )


def _fold(frame, before, last):
    """The fold next to two states of a branch: where mu is stationary along it, by the secant method; [] where there is none."""
    problem, free = frame.problem, frame.problem.free
    along = restrict(np.asarray(last.x) - np.asarray(before.x), free)
    between = np.sqrt(along @ (frame.stiffness @ along))
    row, nothing = frame.stiffness @ along[:, None] / between, np.zeros((len(free), 0))

    def rise(state):
        """Tangent (f,) of the branch per unit of the row, and that of mu."""
        column = mu_force(problem, state.x, state.mu)[:, None]
        system = Bordered(state.factor.pattern.tree.order, state.factor.matrix, column, row, np.zeros((1, 1)))
        dx, dmu = system.solve(np.zeros(len(free)), np.ones(1))
        return dx, float(dmu[0])

    ends = [solve(problem, end.mu, end.x, end.pressure, own_factor=True) for end in (before, last)]
    state, at, earlier = ends[1], 0.0, -between
    slope_before, (dx, slope) = rise(ends[0])[1], rise(ends[1])
    for _ in range(ITERATIONS):
        if slope == slope_before:
            return []
        step = np.clip(-slope * (at - earlier) / (slope - slope_before), -5 * between, 5 * between)
        earlier, slope_before, at = at, slope, at + step
        start = state.x + step * scatter(dx, state.x.shape, free)
        there = Conditions(row, np.zeros(1), np.asarray(last.x), state.mu, np.array([at]))
        state, _ = solve_bordered(problem, state.mu, start, state.pressure, nothing, there)
        if not state.status.ok:
            return []
        dx, slope = rise(state)
        if abs(slope * step) < TOLERANCE:
            mode = dx[:, None] / np.sqrt(dx @ (frame.stiffness @ dx))
            local = _Expansion(-float(mode[:, 0] @ mu_force(problem, state.x, state.mu)), 0.0, float("nan"), np.zeros(len(free)))
            eigenvalue = [float(mode[:, 0] @ frame.analysis.product(state)(mode)[:, 0])]
            return [_point(frame, state, state.mu, mode, eigenvalue, local, np.zeros(1), last.negative_pivots, kind="fold")]
    return []
