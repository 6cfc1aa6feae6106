"""The state of a gel at one chemical potential: from Newton's method to a path."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Scalar
from ..linalg import Factor, Kept
from ..materials import gel_in_groups, value
from ..mechanics import (
    Linearisation,
    Problem,
    axial_stretch,
    carries_volume,
    energy_at,
    pressure_at,
    start_positions,
    volume_ratios,
)
from .status import Status


@dataclasses.dataclass(frozen=True, eq=False)
class Stability:
    """The lowest eigenvalues of the tangent of a state, m of them, over the network's stiffness; of a symmetric state found on a region a
    double one counts once.
    """

    eigenvalues: Float[np.ndarray, " m"]
    """Ascending, dimensionless; the first is as accurate as asked for."""
    vectors: Float[np.ndarray, "f w"] | None
    """At least as many modes, on the free degrees of freedom, 1 / sqrt(kT/v), of either sign; None where they were not kept."""
    negative: int
    """Number of negative eigenvalues of the tangent, tracked or not, a double one counted twice."""


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """A state at one chemical potential, converged or not."""

    mu: float
    """Chemical potential, kT."""
    x: Float[Array, "n 2"]
    """Nodal positions, mm."""
    pressure: Float[Array, " g"]
    """Pressure of the volume groups, kT/v."""
    status: Status = Status.NOT_CONVERGED
    """How the iteration ended; ``CONVERGED`` for an accepted state."""
    newton_iterations: int = 0
    """Linear solves spent on it, including those of intermediate and failed attempts."""
    residual: float = float("nan")
    """Norm of the residual over that of the network's nodal forces and the loads."""
    energy: float = float("nan")
    """Total energy, kT/v mm^2; nan until the state is accepted."""
    stability: Stability | None = None
    """Lowest eigenvalues and modes; None where they were not computed."""
    switched: bool = False
    """Whether the state left an unstable branch: it does not continue the states before it."""
    contact_active: bool | None = None
    """Whether an outline is so near itself that contact acts; None where that was not looked at."""
    stride: float = float("nan")
    """Step in mu that an adaptive sweep tries next, kT; nan for given values."""
    symmetry: str = ""
    """Name of the group of symmetries with which it was found, see ``symmetry.NAMES``, C1 for the whole plate; empty where not known."""
    rate: Float[Array, "n 2"] | None = None
    """dx/dmu, mm/kT, from which a sweep's second state is predicted; of its first state only."""
    factor: Factor | Kept | None = None
    """Factor of a tangent near the state, its own by blocks where it was found on a region; None once a sweep goes on, where a
    factorisation failed, and for a state read from a file."""
    linearisation: Linearisation | None = None
    """The mixed form about the state; None where it was not computed or kept."""

    @property
    def negative_pivots(self) -> int:
        """Negative eigenvalues of the tangent: 0 on a stable branch; -1 where they were not counted."""
        return self.stability.negative if self.stability is not None else -1

    @property
    def lowest_eigenvalue(self) -> float:
        """Lowest eigenvalue of the tangent over the network's stiffness; nan where it was not computed."""
        return float(self.stability.eigenvalues[0]) if self.stability is not None else float("nan")

    @property
    def modes(self) -> Float[np.ndarray, "f w"] | None:
        """Lowest modes, where those of the next state are looked for; None where they were not kept."""
        return self.stability.vectors if self.stability is not None else None

    @property
    def light(self) -> "State":
        """The state without its factor and linearisation, which are large."""
        return dataclasses.replace(self, factor=None, linearisation=None)


def accepted(problem: Problem, state: State, stability: Stability | None, *, switched: bool = False) -> State:
    """A converged state with its energy and stability."""
    acting = acting_problem(problem, state)
    energy = float(energy_at(state.x, acting.model, problem.gel, state.mu, problem.loads))
    return dataclasses.replace(state, energy=energy, stability=stability, switched=switched)


def acting_problem(problem: Problem, state: State) -> Problem:
    """The problem that a state solves: the one without contact where contact does not act."""
    return problem.without_contact if state.contact_active is False else problem


@jax.jit
def dry_state(problem: Problem, mu: Scalar | None = None) -> tuple[Float[Array, "n 2"], Float[Array, " g"]]:
    """Positions (n, 2), mm, and pressures (g,), kT/v, to start from without a previous state: the dry nodes, moved as the edges are,
    and p = -Nv.

    With ``mu`` (kT) the pressures are higher where the moved edges leave the gel more room than that.
    """
    model, gel = problem.model, problem.gel
    plate = model.lists.topology.plate
    x = start_positions(model.lists.topology, model.cloud.nodes)
    pressure = jnp.where(carries_volume(model), -value(gel_in_groups(gel).Nv), 0.0)
    if mu is None or not plate.moved:
        return x, pressure
    J, axial = volume_ratios(x, model), axial_stretch(x, model, gel, mu)
    roomy = carries_volume(model) & (axial * J > 1)
    return x, jnp.where(roomy, jnp.maximum(pressure_at(jnp.where(roomy, J, 2.0 / axial), model, gel, mu, axial), pressure), pressure)
