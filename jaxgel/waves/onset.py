"""Onset of instability of an infinite lattice: the first mu with a neutral Bloch wave of one cell.

lambda(k, mu) is the lowest eigenvalue of the waves with the wave vector k about the cell's own
periodic state. Its first zero is looked for on a grid of the Brillouin zone, then in k and mu in
turn: lambda(k, .) = 0, lambda(., mu) least. A long wave, |k| -> 0, is the loss of ellipticity of
the lattice as a material (Geymonat, Mueller & Triantafyllidis 1993); a short one is a pattern that
repeats after some cells.
"""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from .._deprecated import old_arguments
from .._programs import program
from .._threads import few_threads
from .._types import Array, Float, Int, Scalar
from .._validation import Inadmissible
from ..bifurcation import ends_of, located
from ..continuation import Adaptive, SweepFailed, sweep
from ..controls import check_values
from ..equilibrium import Observer, control_force
from ..linalg import Bordered, factor
from ..mechanics import Problem, curvature, gather, linearise, restrict, scatter, tangent
from ..symmetry import symmetries_of
from .bloch import BlochStates
from .cells import check_periodic
from .zone import long_wave_number, wave_vectors_of_zone

DIVISIONS = 8  # of the zone from its middle to its edge
ROUNDS = 8  # of k and mu in turn
TOLERANCE = 1e-9  # of mu, kT
# first steps of the refinement: of a long wave's direction, rad, and of a short wave's vector over
# pi / side
TURN, MOVE = 0.1, 0.04
CLOSE = 1e-7  # kT: a wave vector that lowers the critical mu by less is no better
SAME = 1e-6  # difference of two eigenvalues that are one
REPEATS = 12  # most cells along a side after which a short wave's pattern repeats


@dataclasses.dataclass(frozen=True, eq=False)
class LatticeOnset:
    """State of a cell at which the first wave has zero stiffness; of `lattice_onset`."""

    mu: Scalar
    """Critical chemical potential, kT; differentiable with respect to the model and the gel."""
    wave_vector: Float[np.ndarray, " 2"]
    """Wave vector of the wave, rad per mm of the dry cell.

    One of those that are images of each other.
    """
    kind: str
    """"long wave" or "short wave"."""
    periods: tuple[int, int] | None
    """Number of cells along x and y after which a short wave's pattern repeats.

    None for a long wave, and above ``REPEATS``.
    """
    x: Float[Array, "n 2"]
    """Nodal positions of the cell, mm."""
    pressure: Float[Array, " g"]
    """Pressures of the volume groups, kT/v."""
    modes: Float[np.ndarray, "m n 2"]
    """Real and imaginary part of the wave in the cell.

    In the cell R away it is exp(i k . R) times as large. Of waves that are the same in all cells
    the real modes, two for a double eigenvalue.
    """
    slope: float
    """d lambda / d mu along the branch."""
    group: tuple[str, ...]
    """Symmetries of the cell, see ``symmetry``."""
    periodic: tuple[bool, bool]
    """Whether the lattice goes on along x and along y."""
    zone: Float[np.ndarray, "w 2"]
    """Wave vectors examined, rad/mm; by the symmetries and k -> -k they represent all."""
    eigenvalues: Float[np.ndarray, " w"]
    """Lowest eigenvalue at each of them at the onset, over the stiffness of the network ()."""
    correction: Float[np.ndarray, "n 2"]
    """Field w of the derivative, see ``bifurcation.critical``."""

    @property
    def text(self) -> str:
        """One line that says what it is."""
        k = ", ".join(f"{component:.4g}" for component in self.wave_vector)
        if self.kind == "long wave" and not all(self.periodic):
            return f"long wave ({k}) rad/mm: a pattern of a hundred cells or more"
        if self.kind == "long wave":
            return f"long wave along ({k}): the lattice loses its ellipticity"
        if not self.wave_vector.any():
            return "the same in all cells: the cell's own pattern"
        repeats = (
            f"repeats after {self.periods[0]} x {self.periods[1]} cells"
            if self.periods
            else "does not repeat after a few cells"
        )
        return f"short wave ({k}) rad/mm: a pattern that {repeats}"


@old_arguments
def lattice_onset(
    problem: Problem, between: tuple[float, float], *, divisions: int = DIVISIONS
) -> LatticeOnset | None:
    """`LatticeOnset` of the infinite lattice of a periodic cell; None if it remains stable.

    Arguments:

    - `problem`: the `Problem` of the periodic cell, controlled by mu; its contact is not
      considered.
    - `between`: (first, last), chemical potentials, kT, rising.
    - `divisions`: steps of the zone of wave vectors from its middle to its edge; the critical wave
      vector of this grid is then refined.

    The branch has the same state in all cells, with a macroscopic deformation of its own if that is
    free. `onset.mu` is differentiable once, forward and reverse, at fixed sides of the cell: if
    symmetry gives several waves one onset, the derivative by parameters that break it is that of
    one of them. Long waves are a hundred cells long; of a strip with free edges, which buckles as a
    beam however long it is, the onset depends on that.

    Raises `ValueError` for a plate that is not periodic, another control, and a lattice that is
    unstable from the first state on, `SweepFailed` if the branch ends, or the sides of a hole
    touch, before an onset is found.

    Example: docs/howto/waves.md.
    """
    if problem.control.name != "mu":
        raise ValueError(
            f"lattice_onset: is not available with the control {problem.control.name!r}, only "
            "with the chemical potential"
        )
    first, last = ends_of(problem, between)
    check_values((first, last), rising=True)
    if not (isinstance(divisions, int) and divisions > 0):
        raise ValueError(f"divisions: {divisions!r} is not a positive whole number")
    check_periodic(problem.model.lists.topology.plate)
    problem = problem.replace(model=dataclasses.replace(problem.model, contact=None))
    with few_threads(2 * problem.model.n_nodes):
        points = located(
            "lattice_onset", lambda of: _search(of, (first, last), divisions), problem, "mu"
        )
    return points[0] if points else None


def _search(problem, mu, divisions):
    """[`LatticeOnset`], or [] if every wave is stable."""
    steps = []
    seen = Observer(accepted=lambda state: steps.append(state.light))
    path = sweep(problem, Adaptive(*mu), branch="symmetric", until_contact=True, observer=seen)
    problem = problem.prepared
    group = symmetries_of(problem)
    zone = wave_vectors_of_zone(problem.model.lists.topology.plate, divisions, group)
    for number, state in enumerate(steps):
        waves = BlochStates(problem, state)
        unstable = [k for k in zone if waves.negative(k)]
        if unstable:
            return [_Refined(problem, steps[: number + 1], group).onset(unstable, zone)]
    if not path.stop.ok:
        raise SweepFailed(
            f"lattice_onset: no wave is unstable on the states found; {path.stop_text}"
        )
    return []


class _Refined:
    """Search in k and mu between ``states``, the last one unstable to waves of the grid.

    Only the last one.
    """

    def __init__(self, problem, states, group):
        self._problem, self._states, self._group = problem, states, group
        plate = problem.model.lists.topology.plate
        self._periodic, self._corner = (
            check_periodic(plate),
            np.pi / np.array([plate.width, plate.height]),
        )
        self._long = 1.5 * long_wave_number(plate)
        self._known = {}

    def _waves(self, mu):
        """`BlochStates` at ``mu``, found once."""
        if mu not in self._known:
            self._known[mu] = BlochStates(self._problem, self._state(mu))
        return self._known[mu]

    def _state(self, mu):
        """Periodic `State` at ``mu`` by the cell's symmetries; its own tangent may be singular."""
        before = [state for state in self._states if state.mu <= mu][-1]
        if before.mu == mu:
            return before
        path = sweep(self._problem, [mu], branch="symmetric", start=before)
        if not path.stop.ok:
            raise SweepFailed(
                f"lattice_onset: no periodic state at mu = {mu:.6g}: {path.stop_text}"
            )
        return path[-1]

    def _lowest(self, k, mu):
        return self._waves(mu).lowest(k)[0][0]

    def _zero(self, k):
        """Critical mu of waves of wave vector k; ValueError if all are unstable.

        They are unstable above, and at the last state.
        """
        for later, earlier in itertools.pairwise(state.mu for state in reversed(self._states)):
            if self._lowest(k, earlier) > 0 > self._lowest(k, later):
                return scipy.optimize.brentq(
                    lambda mu: self._lowest(k, mu), earlier, later, xtol=TOLERANCE
                )
        raise Inadmissible(
            f"mu: the lattice is unstable at the first state, mu = {self._states[0].mu:g} kT; "
            "start lower"
        )

    def onset(self, unstable, zone):
        """`LatticeOnset` of the waves, some unstable at the last state, of ``unstable`` vectors.

        Some with these wave vectors have a negative eigenvalue there.
        """
        k = min(unstable, key=lambda k: self._lowest(k, self._states[-1].mu))
        mu = self._zero(k)
        for _ in range(ROUNDS):
            better = self._refine(min([k, *unstable], key=lambda k: self._lowest(k, mu)), mu)
            lower = self._zero(better) if self._lowest(better, mu) < 0 else mu
            if lower > mu - CLOSE:
                break
            k, mu = better, lower
        return self._point(k, mu, zone)

    def _refine(self, k, mu):
        """Wave vector near ``k`` of the lowest eigenvalue at ``mu``; long waves keep length."""
        length, axes = np.linalg.norm(k), np.flatnonzero(self._periodic)
        long = length < self._long
        if not length or (len(axes) == 1 and long):
            return k
        first, step = (
            (np.array([np.arctan2(k[1], k[0])]), TURN)
            if long
            else ((k / self._corner)[axes], -MOVE)
        )

        def at(free):
            """Wave vector from the direction of a long wave, or from multiples of pi / side."""
            if long:
                return length * np.array([np.cos(free[0]), np.sin(free[0])])
            return np.bincount(axes, free, minlength=2) * self._corner

        def value(free):
            return (
                self._lowest(at(free), mu)
                if long or np.linalg.norm(at(free)) > self._long
                else np.inf
            )

        simplex = np.array([first, *(first + step * row for row in np.eye(len(first)))])
        found = scipy.optimize.minimize(
            value,
            first,
            method="Nelder-Mead",
            options=dict(initial_simplex=simplex, xatol=1e-4, fatol=1e-12),
        )
        return at(found.x)

    def _point(self, k, mu, zone):
        waves = self._waves(mu)
        modes = _modes(waves, k)
        slope, correction = _derivatives(self._problem, waves.state, modes, not k.any())
        long = bool(0 < np.linalg.norm(k) < self._long)
        return LatticeOnset(
            mu=float(mu),
            wave_vector=np.asarray(k),
            kind="long wave" if long else "short wave",
            periods=None if long else _repeats(k / self._corner),
            x=np.asarray(waves.state.x),
            pressure=np.asarray(waves.state.pressure),
            modes=modes,
            slope=slope,
            group=self._group,
            periodic=self._periodic,
            zone=zone,
            eigenvalues=np.array([waves.lowest(k)[0][0] for k in zone]),
            correction=correction,
        )


def _modes(waves, k):
    """Real and imaginary part (2, n, 2) of the wave, or real modes (m, n, 2) without phase.

    They are those of waves that are the same in all cells.
    """
    values, fields = waves.lowest(k, 1 if k.any() else 2)
    if k.any():
        return np.stack([fields[0].real, fields[0].imag])
    count = 1 + int(values[1] - values[0] < SAME)
    parts = np.concatenate([fields[:count].real, fields[:count].imag])
    _, sizes, rows = np.linalg.svd(parts.reshape(2 * count, -1), full_matrices=False)
    real = (sizes[:count, None] * rows[:count]).reshape(count, *parts.shape[1:])
    network = [waves.network_energy(field) for field in real]
    return real / np.sqrt(network)[:, None, None]


def _repeats(shares: Float[np.ndarray, " 2"]) -> tuple[int, int] | None:
    """Period in cells along x and y of a wave with k = ``shares`` pi / side; None if long.

    Above ``REPEATS``.
    """
    cells: Int[np.ndarray, " m"] = np.arange(1, REPEATS + 1)
    turns = np.abs(np.multiply.outer(shares / 2, cells))
    whole = np.abs(turns - np.round(turns)) < 1e-3
    return (
        (int(cells[whole[0].argmax()]), int(cells[whole[1].argmax()]))
        if whole.any(axis=1).all()
        else None
    )


def _derivatives(problem, state, modes, same_in_all):
    """D lambda / d mu along the branch, and w = K^-1 dphi/dx, see ``bifurcation.critical``.

    It is the field of its other derivatives.
    """
    gradient, slope = _changes(problem, jnp.asarray(state.x), jnp.asarray(state.mu), modes)
    pull = np.asarray(gather(gradient, problem.free))
    at = problem, state.x, state.pressure
    pairs = tangent(*at, linearise(*at, state.mu))
    if same_in_all:  # the tangent of the cell itself is singular, along the modes
        held = np.stack([np.asarray(restrict(mode, problem.free)) for mode in modes], axis=1)
        system = Bordered(
            problem.pattern.tree.order,
            problem.pattern.matrix(pairs),
            held,
            held,
            np.zeros((held.shape[1],) * 2),
        )
        correction, _ = system.solve(pull, np.zeros(held.shape[1]))
    else:
        correction = factor(problem.pattern, pairs).apply(pull)
    by_mu = control_force(problem, state)
    slope = (float(slope) - correction @ by_mu) / (len(modes) if same_in_all else 1)
    return slope, np.asarray(scatter(correction, problem.free))


@program(x="n", modes="mn", returns=("n", None))
def _changes(problem, x, mu, modes):
    """Dphi/dx (n, 2) and dphi/dmu of phi = v* K v."""

    def phi(x, mu):
        return sum(curvature(x, v, problem.model, problem.gel, mu, problem.loads) for v in modes)

    return jax.grad(phi, argnums=(0, 1))(x, mu)
