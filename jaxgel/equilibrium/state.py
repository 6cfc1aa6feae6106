"""The state of a gel at one chemical potential, and how its computation ended."""

import dataclasses
import enum

import jax
import numpy as np

from ..mechanics import energy_at
from .problem import acting


class Status(enum.IntEnum):
    """How a solve or a sweep ended."""

    CONVERGED = 0
    NOT_CONVERGED = 1
    SINGULAR = 2
    NOT_FINITE = 3
    STEP_TOO_SMALL = 4
    TOO_MANY_STEPS = 5
    INTERRUPTED = 6
    SELF_CONTACT = 7
    CROSSED = 8
    NEARLY_SINGULAR = 9

    @property
    def ok(self):
        """Whether the state satisfies equilibrium."""
        return self is Status.CONVERGED

    @property
    def text(self):
        """One line that says what happened and what to try."""
        return _TEXTS[self]


_TEXTS = {
    Status.CONVERGED: "converged",
    Status.NOT_CONVERGED: "Newton did not converge: the step in mu was too large, or the tangent is nearly singular; use smaller steps",
    Status.SINGULAR: "the tangent is singular: a fold or bifurcation; look at the lowest eigenvalue",
    Status.NOT_FINITE: "Newton left the numbers: the start is too far from equilibrium; use smaller steps",
    Status.STEP_TOO_SMALL: "the step in mu fell below its least value: the branch folds back or creases here (see surface_ratio), "
    "or the cloud is too coarse for the deformation",
    Status.TOO_MANY_STEPS: "the largest number of steps was reached; raise max_steps",
    Status.INTERRUPTED: "interrupted by the user; the states so far are kept",
    Status.SELF_CONTACT: "hole boundaries touch or overlap; without contact the states from here on are invalid",
    Status.CROSSED: "a hole's boundary passed through itself: use smaller steps in mu, or stiffer contact (see with_contact)",
    Status.NEARLY_SINGULAR: "converged, but a fold or bifurcation is near: derivatives grow like 1 / lowest_eigenvalue and hold for tiny "
    "changes only",
}


def advice(model, stop):
    """What to change where not even the first state of a sweep was found, after the text of its `Status`."""
    if stop is Status.SELF_CONTACT:
        return "; sweep with contact = 'on'"
    return (
        "; method = 'displacement' locks where the edges leave little room: take 'mixed'"
        if model.method == "displacement"
        else "; start at a lower mu"
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Equilibrium:
    """Result of Newton's method at one mu."""

    x: jax.Array
    """(n, 2) nodal positions, mm."""
    pressure: jax.Array
    """(g,) pressure of the volume groups, kT/v."""
    status: Status
    """How the iteration ended."""
    iterations: int
    """Number of linear solves."""
    residual: float
    """Norm of the residual over the norm of the network's nodal forces."""
    factor: object
    """The last ``linear_solve.Factor``, of a tangent near the state; None where the start was the solution, or a factor failed."""
    apart: bool = False
    """Whether contact was left out, as no outline is near itself."""
    linearisation: object = None
    """The ``mixed.Linearisation`` about the state; None where the last one made is about another."""


@dataclasses.dataclass(frozen=True, eq=False)
class Step:
    """One accepted state of a sweep; scalars are Python numbers."""

    mu: float
    """Chemical potential, kT."""
    x: np.ndarray
    """(n, 2) nodal positions, mm."""
    pressure: np.ndarray
    """(g,) pressure of the volume groups, kT/v."""
    status: Status
    """Always ``Status.CONVERGED`` for an accepted state."""
    newton_iterations: int
    """Linear solves spent on it, including those of intermediate and failed attempts."""
    residual: float
    """Norm of the residual over that of the network's nodal forces."""
    energy: float
    """Total energy, kT/v mm^2."""
    negative_pivots: int
    """Negative eigenvalues of the tangent: 0 on a stable branch."""
    lowest_eigenvalue: float = float("nan")
    """Lowest eigenvalue of the tangent over the network's stiffness, see ``stability``; nan where it was not computed."""
    modes: object = None
    """(f, m) lowest modes, where the next state's are looked for; None for all but the last state read from a file."""
    rate: object = None
    """(n, 2) dx/dmu, mm/kT, from which a sweep's second state is predicted; of its first state only."""
    factor: object = None
    """Factor of the tangent next to the state, for ``on_step`` only; None once the sweep goes on, and for a state read from a file."""
    fixed: object = None
    """``mixed.Constants`` of the model, for ``on_step`` only, likewise."""
    switched: bool = False
    """Whether the state left an unstable branch: it does not continue the states before it."""
    apart: bool | None = None
    """Whether no outline is so near itself that contact acts; None where that was not looked at."""
    stride: float = float("nan")
    """Step in mu that a sweep with chosen steps tries next, kT; nan for given values."""

    @classmethod
    def at(cls, problem, mu, state, modes, *, switched=False):
        """Step of an ``Equilibrium`` at ``mu`` with its ``stability.Modes``; None for a state that was not reached."""
        model = acting(problem, state).model
        return cls(
            mu=float(mu),
            x=state.x,
            pressure=state.pressure,
            status=state.status,
            newton_iterations=state.iterations,
            residual=state.residual,
            energy=float(energy_at(state.x, model, problem.gel, mu, problem.loads)) if modes else float("nan"),
            negative_pivots=modes.negative if modes else -1,
            lowest_eigenvalue=float(modes.eigenvalues[0]) if modes else float("nan"),
            modes=modes.vectors if modes else None,
            factor=state.factor,
            fixed=problem.fixed,
            switched=switched,
            apart=state.apart if problem.apart is not None else None,
        )

    def told(self, on_step):
        """The step without its factor and constants, which are large, once ``on_step`` (or None) was told of it."""
        if on_step is not None:
            on_step(self)
        return dataclasses.replace(self, factor=None, fixed=None)
