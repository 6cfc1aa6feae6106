"""The state of a gel at one value of a control: from Newton's method to a path."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._types import Array, Chemical, Float
from ..linalg import BlockFactor, Factor
from ..materials import gel_in_groups
from ..mechanics import (
    ContactPairs,
    Equations,
    Linearisation,
    Problem,
    axial_stretch,
    condensed_forces,
    gather,
    linearise,
    pressure_at,
    pressure_change,
    volume_ratios,
)
from .status import Change, Status


@dataclasses.dataclass(frozen=True, eq=False)
class Stability:
    """Number of negative eigenvalues of a state's tangent, and optionally the lowest m of them.

    Eigenvalues are over the network's stiffness. A double one of a symmetric state found on a
    region counts once.
    """

    negative: int
    """Number of negative eigenvalues of the tangent, a double one counted twice."""
    eigenvalues: Float[np.ndarray, " m"] | None = None
    """Ascending, dimensionless; the first is as accurate as asked for.

    None if they were not computed.
    """
    vectors: Float[np.ndarray, "f w"] | None = None
    """At least as many modes, on the free degrees of freedom, 1 / sqrt(kT/v), of either sign.

    None if they were not kept.
    """


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """A state at one value of a control, converged or not."""

    value: float | Float[np.ndarray, " g"]
    """Value of the control."""
    mu: float | Float[np.ndarray, " g"]
    """Chemical potential, kT, of all volume groups or of each.

    Of the bath in transient swelling.
    """
    x: Float[Array, "n 2"]
    """Nodal positions, mm."""
    pressure: Float[Array, " g"] | Float[Array, "c g"]
    """Pressure of the volume groups, kT/v; by cells in the scheme of ``paper``."""
    status: Status = Status.NOT_CONVERGED
    """How the iteration ended; ``CONVERGED`` for an accepted state."""
    newton_iterations: int = 0
    """Linear solves spent on it, including those of intermediate and failed attempts."""
    residual: float = float("nan")
    """Norm of the residual over that of the network's nodal forces and the loads."""
    energy: float = float("nan")
    """Total energy, kT/v mm^2; nan until the state is accepted."""
    stability: Stability | None = None
    """Negative eigenvalues of the tangent; None if they were not counted."""
    switched: Change = Change.NONE
    """Why the state does not continue the states before it."""
    pairs: ContactPairs | None = None
    """Pairs of points that touch; None without contact, and if they have not been looked for."""
    symmetry: str = ""
    """Symmetry group with which it was found, see ``symmetry.NAMES``; C1 for the whole plate.

    Empty if not known.
    """
    rate: Float[Array, "n 2"] | None = None
    """dx/dvalue, mm over the control's unit, from which a sweep's second state is predicted.

    Of its first state only.
    """
    factor: Factor | BlockFactor | None = None
    """Factor of the state's own tangent, by blocks where it was found on a region.

    None if there was no need of one, once a sweep goes on, and for a state read from a file.
    """
    linearisation: Linearisation | None = None
    """The mixed form about the state; None if it was not computed or kept."""
    potential: Float[Array, " g"] | None = None
    """Chemical potential in each volume group, kT, in transient swelling; else None.

    ``mu`` is then that of the bath; None if it is ``mu`` everywhere.
    """
    supplied: Float[Array, " b"] | None = None
    """Solvent through each wetted part since time 0, mm^3 per mm of dry thickness."""

    def __repr__(self) -> str:
        """Where the state is, and how it stands."""
        negative = {-1: "stability not computed", 0: "stable"}.get(
            self.negative_pivots, f"{self.negative_pivots} negative eigenvalues"
        )
        mu = " to ".join(f"{value:.6g}" for value in sorted({np.min(self.mu), np.max(self.mu)}))
        return f"State of {len(self.x)} nodes, mu = {mu} kT, {negative}: {self.status.text}"

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the tangent: 0 if stable; -1 if not counted."""
        return self.stability.negative if self.stability is not None else -1

    @property
    def lowest_eigenvalue(self) -> float:
        """Lowest eigenvalue of the tangent over the network's stiffness; nan if not computed."""
        eigenvalues = None if self.stability is None else self.stability.eigenvalues
        return float("nan") if eigenvalues is None else float(eigenvalues[0])

    @property
    def modes(self) -> Float[np.ndarray, "f w"] | None:
        """Lowest modes, where those of the next state are looked for.

        None if they were not kept.
        """
        return self.stability.vectors if self.stability is not None else None

    @property
    def touches(self) -> bool:
        """Whether surfaces touch."""
        return self.pairs is not None and len(self.pairs) > 0

    @property
    def light(self) -> "State":
        """The state without its factor and linearisation, which are large."""
        return dataclasses.replace(self, factor=None, linearisation=None)


def accepted(
    problem: Problem, state: State, stability: Stability | None, *, switched: Change = Change.NONE
) -> State:
    """A converged state with its energy and stability."""
    _, now = linearised(problem, state)
    return dataclasses.replace(
        state, energy=float(now.energy), stability=stability, switched=switched
    )


def acting_problem(problem: Problem, state: State) -> Problem:
    """The problem of a state: at its value of the control, with the points that touch there."""
    return touching(problem, state).at(state.value)[0]


def touching(problem: Problem, state: State) -> Problem:
    """The problem with the pairs of points that touch in a state."""
    return problem.with_pairs(
        problem.at(state.value)[0].touching(state.x).pairs if state.pairs is None else state.pairs
    )


def linearised(problem: Problem, state: State) -> tuple[Problem, Linearisation]:
    """The `acting_problem` of a state, and the mixed form about it, its own if it was kept."""
    acting = acting_problem(problem, state)
    if state.linearisation is not None:
        return acting, state.linearisation
    return acting, linearise(
        acting,
        state.x,
        state.pressure,
        np.asarray(state.mu if state.potential is None else state.potential, dtype=float),
    )


def as_number(mu: Chemical) -> float | Float[np.ndarray, " g"]:
    """A chemical potential as a number, or as numbers of the volume groups."""
    return float(mu) if np.ndim(mu) == 0 else np.asarray(mu)


def control_force(problem: Problem, state: State) -> Float[np.ndarray, " f"]:
    """Derivative (f,) of a state's residual by the control, with the edges that it moves.

    kT/v mm over the control's unit.
    """
    return control_rates(touching(problem, state).prepared, state.x, state.value)[0]


def control_pressure(problem: Problem, state: State) -> Float[np.ndarray, " g"]:
    """Derivative (g,) of Newton's pressures by the control with the unknowns at rest.

    kT/v over the control's unit.
    """
    return control_rates(touching(problem, state).prepared, state.x, state.value)[1]


def pressure_rate(
    problem: Problem, state: State, rate: Float[Array, "n 2"]
) -> Float[np.ndarray, " g"]:
    """Derivative (g,) of a state's pressures by the control, for unknowns moving at a ``rate``.

    kT/v and mm over the control's unit.
    """
    acting, now = linearised(problem, state)
    return np.asarray(control_pressure(problem, state)) + _pressure_change(acting, rate, now)


@program(x="n", returns=("f", "g"), inside=True)
def control_rates(
    problem: Equations, x: Float[Array, "n 2"], value: Chemical
) -> tuple[Float[Array, " f"], Float[Array, " g"]]:
    """Derivatives by the control at fixed unknowns: residual (f,) and pressures (g,)."""
    (forces, pressure) = jax.jvp(
        lambda value: condensed_forces(problem, x, value), (value,), (1.0,)
    )[1]
    return gather(forces, problem.free), pressure


@program(rate="n", returns="g", inside=True)
def _pressure_change(problem, rate, linearisation):
    return pressure_change(rate, linearisation, problem.model)


@program(returns=("n", "g"), inside=True)
def dry_state(
    problem: Equations, value: Chemical | None = None
) -> tuple[Float[Array, "n 2"], Float[Array, " g"]]:
    """Initial positions (n, 2), mm, and pressures (g,), kT/v, without a previous state.

    The dry nodes, moved as the edges are, and p = -Nv. With a ``value`` of the control the edges
    are where they are there, and the pressures higher if that leaves the gel more room.
    """
    model, edges = problem.model, problem.constraints.edges
    pressure = jnp.where(model.carries, -gel_in_groups(problem.gel).Nv, 0.0)
    if value is None or (edges.at_rest and not problem.moves_edges):
        return edges.positions(model.nodes), pressure
    x = problem.dry_positions(value)
    problem, mu = problem.at(value)
    J, axial = volume_ratios(x, model), axial_stretch(model)
    roomy = model.carries & (axial * J > 1)
    there = pressure_at(jnp.where(roomy, J, 2.0 / axial), model, problem.gel, mu)
    return x, jnp.where(roomy, jnp.maximum(there, pressure), pressure)
