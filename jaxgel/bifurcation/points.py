"""Critical points: a state with a vanishing eigenvalue, its modes, and the energy about it.

phi = v . K v is the energy's second derivative along the modes v, the sum over both for a double
eigenvalue; lambda is its value for normalised modes.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from .._deprecated import OldAttribute
from .._programs import program
from .._types import Array, Float, Scalar
from ..equilibrium import State, control_force, touching
from ..linalg import Bordered
from ..mechanics import Problem, curvature, gather, scatter
from ..symmetry import representation_of

KEPT = 0.5  # a symmetry takes at most this share of a simple mode to other modes


@dataclasses.dataclass(frozen=True, eq=False)
class CriticalPoint:
    """A state with an m-fold vanishing eigenvalue; `critical_points` and `folds` return it."""

    value: Scalar
    """Value of the control, of mu in kT without another.

    Differentiable with respect to the problem.
    """
    mu: Scalar
    """Chemical potential, kT: the value itself if that is the control; differentiable, too."""
    kind: str
    """"bifurcation" or "fold"."""
    x: Float[Array, "n 2"]
    """Nodal positions, mm."""
    pressure: Float[Array, " g"]
    """Pressures of the volume groups, kT/v."""
    modes: Float[Array, "m n 2"]
    """Modes, dimensionless, normalised and signed as in `stability`."""
    eigenvalues: Float[Array, " m"]
    """Remaining eigenvalues at mu: round-off, or half the split of a double one of the cloud."""
    slope: Scalar
    """d lambda / d value along the branch, mean over the modes; at a fold -dr/dvalue . v."""
    curvature: Scalar
    """d^2 value / d a^2 along the branch that leaves, a the amplitude of the mode; nan if m > 1.
    If it is positive, that branch lies above the value."""
    imperfection: Scalar
    """Force that holds the state on its branch, over that of a one-spacing mode of the network."""
    symmetries: dict[str, float]
    """Symmetry of the cloud -> character of the modes: 1 keeps a simple mode, -1 reverses it."""
    unstable: int
    """Number of negative eigenvalues of the branch just before the point."""
    correction: Float[Array, "n 2"]
    """Field w of the derivative, see `critical`."""

    chemical_potential = OldAttribute("mu")

    @property
    def multiplicity(self) -> int:
        """Number of modes."""
        return len(self.modes)

    @property
    def representation(self) -> str:
        """Symbol of the irreducible representation of the modes, such as B1 or E; empty if none.

        The group is that of the cloud's symmetries.
        """
        return representation_of(self.symmetries)

    @property
    def subcritical(self) -> bool:
        """Whether the branch of a simple bifurcation lies on the more stable side of the first.

        There the one that it leaves has fewer negative eigenvalues.
        """
        return bool(self.curvature * self.slope > 0)

    @property
    def text(self) -> str:
        """One line that says what it is."""
        if self.kind == "fold":
            return "fold: the branch turns back"
        side = (
            ""
            if jnp.isnan(self.curvature)
            else ", subcritical"
            if self.subcritical
            else ", supercritical"
        )
        kept = [
            name
            for name, character in self.symmetries.items()
            if self.multiplicity == 1 and character > KEPT
        ]
        broken = [
            name
            for name, character in self.symmetries.items()
            if self.multiplicity == 1 and character < -KEPT
        ]
        said = "; ".join(
            f"{word} {', '.join(names)}"
            for word, names in (("keeps", kept), ("breaks", broken))
            if names
        )
        symbol = f" of {self.representation}" if self.representation else ""
        return (
            f"{('', 'simple', 'double')[min(self.multiplicity, 2)]} bifurcation{symbol}{side}"
            + (f"; the mode {said}" if said else "")
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Expansion:
    """Derivatives of the energy at a state along its modes, the other directions in equilibrium."""

    slope: float
    """d lambda / d value, mean over the modes."""
    cubic: float
    """Third derivative of the energy along the first mode."""
    quartic: float
    """Fourth derivative along the first mode, relaxed; nan for several modes."""
    correction: Float[Array, " f"]
    """w = K^-1 (dphi/dx) across the modes."""


def expand(
    problem: Problem, stiffness: sp.csr_matrix, state: State, modes: Float[np.ndarray, "f m"]
) -> Expansion:
    """`Expansion` at a state along modes normalised by the ``stiffness`` (f, f).

    The state has a factor of its own tangent; the stiffness is that of the network.
    """
    m = modes.shape[1]
    fields = np.stack([scatter(v, problem.free) for v in modes.T])
    slope, gradient, cubic, quartic = _derivatives(
        touching(problem, state), state.x, fields, jnp.asarray(state.value)
    )
    gradient = np.asarray(gather(gradient, problem.free))
    held = stiffness @ modes
    system = Bordered.of(state.factor, held, held, np.zeros((m, m)))
    correction, _ = system.solve(gradient, np.zeros(m))
    slope = (float(slope) - correction @ control_force(problem, state)) / m
    relaxed = float(quartic) - 3 * gradient @ correction if m == 1 else float("nan")
    return Expansion(slope, float(cubic), relaxed, correction)


@program(x="n", modes="mn", returns=(None, "n", None, None))
def _derivatives(problem, x, modes, value):
    """D phi / d value, d phi / dx (n, 2), and third and fourth derivative along the first mode.

    They are derivatives of the energy.
    """

    def along_mode(x, v, value):
        now, mu = problem.at(value)
        return curvature(problem.placed(x, value), v, now.model, now.gel, mu, now.loads)

    gradient, slope = jax.grad(
        lambda x, value: sum(along_mode(x, v, value) for v in modes), argnums=(0, 1)
    )(x, value)

    def along(t):
        return along_mode(x + t * modes[0], modes[0], value)

    def third(t):
        return jax.jvp(along, (t,), (1.0,))[1]

    cubic, quartic = jax.jvp(third, (0.0,), (1.0,))
    return slope, gradient, cubic, quartic
