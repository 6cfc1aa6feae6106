"""Status of a solve or a sweep, with its diagnosis: every `Status` is decided here."""

import enum

import numpy as np

from .._types import Array, Float
from ..discretisation import Model
from ..mechanics import overlaps

# eigenvalue, over the network's stiffness, below which a state's derivatives are flagged
NEARLY_SINGULAR = 1e-3


class StateNotFound(ArithmeticError):
    """No state was found where one is needed; the text says why."""


class Status(enum.IntEnum):
    """How a solve or a sweep ended; in `Path.status` and `Path.stop`. `text` is the diagnosis."""

    CONVERGED = 0
    """The state satisfies equilibrium, or the sweep reached its end."""
    NOT_CONVERGED = 1
    """Newton's method reached its largest number of increments."""
    SINGULAR = 2
    """The tangent is singular."""
    NOT_FINITE = 3
    """An iterate of Newton's method is not finite."""
    STEP_TOO_SMALL = 4
    """The step of the control fell below its least value."""
    TOO_MANY_STEPS = 5
    """The largest number of states was reached."""
    INTERRUPTED = 6
    """The user interrupted the sweep."""
    SELF_CONTACT = 7
    """Sides of a hole touch or overlap, without contact in the problem."""
    CROSSED = 8
    """A surface passed through itself or through a line, with contact in the problem."""
    NEARLY_SINGULAR = 9
    """The state is near a fold or bifurcation: its derivatives are ill-conditioned."""
    LEAPT = 10
    """Much of the gel changed its phase in one step."""
    UNSTABLE = 11
    """The stable branch ended, and relaxation found no stable state."""
    NOT_EXAMINED = 12
    """The derivatives of the state were not examined."""
    LOST_STABILITY = 13
    """The state, or one before it, is unstable at its chemical potentials."""
    BEYOND_CONTACT = 14
    """A node moved farther in one step than the range of contact."""
    AGAINST_PREDICTION = 15
    """The step opposes the prediction along the softest mode: another branch."""
    ASYMMETRIC = 16
    """The sheet lacks the symmetries that its compiled sweep was told to use."""

    @property
    def ok(self) -> bool:
        """Whether a state satisfies equilibrium, or its derivatives are well posed."""
        return self is Status.CONVERGED

    @property
    def text(self) -> str:
        """One line that says what happened and what to try."""
        return _TEXTS[self]


class Change(enum.IntEnum):
    """Why a state does not continue those before it; in `Path.switched`. False if it does."""

    NONE = 0
    """It continues them."""
    BIFURCATION = 1
    """It lies on the stable branch that leaves an unstable one there."""
    RELAXATION = 2
    """The stable branch ended, and the gel relaxed to another state: it snapped through."""
    PHASE = 3
    """Much of the gel collapsed or swelled at once."""

    @property
    def text(self) -> str:
        """The reason in words."""
        return ("none", "bifurcation", "relaxation", "phase jump")[self]


_TEXTS = {
    Status.CONVERGED: "converged",
    Status.NOT_CONVERGED: (
        "Newton did not converge: the step was too large, or the tangent is nearly singular; use "
        "smaller steps"
    ),
    Status.SINGULAR: (
        "the tangent is singular: a fold or bifurcation; look at the lowest eigenvalue"
    ),
    Status.NOT_FINITE: (
        "Newton produced a non-finite iterate: the start is too far from equilibrium; use smaller "
        "steps"
    ),
    Status.STEP_TOO_SMALL: (
        "the step fell below its least value: the branch folds back or creases here (see "
        "surface_ratio), or the cloud is too coarse for the deformation"
    ),
    Status.TOO_MANY_STEPS: "the largest number of steps was reached; raise max_steps",
    Status.INTERRUPTED: "interrupted by the user; the states so far are kept",
    Status.SELF_CONTACT: (
        "hole boundaries touch or overlap; without contact the states from here on are invalid"
    ),
    Status.CROSSED: (
        "a surface passed through itself or a line: use smaller steps, or stiffer contact (see "
        "with_contact)"
    ),
    Status.LEAPT: (
        "the gel changes its phase here, collapsed or swollen, by a leap; use smaller steps, "
        "which cross it"
    ),
    Status.NEARLY_SINGULAR: (
        "converged, but a fold or bifurcation is near: derivatives grow like 1 / "
        "lowest_eigenvalue and hold for tiny changes only"
    ),
    Status.LOST_STABILITY: (
        "the state is unstable at its chemical potentials, or one before it was: a perturbation "
        "grows from there"
    ),
    Status.NOT_EXAMINED: "whether derivatives are well posed was not asked",
    Status.BEYOND_CONTACT: (
        "a node moved farther in one step than contact acts: sides may have passed each other; "
        "use smaller steps"
    ),
    Status.AGAINST_PREDICTION: (
        "the step goes along the softest mode against the prediction, to another branch; use "
        "smaller steps"
    ),
    Status.ASYMMETRIC: (
        "the sheet lacks the symmetry that the sweep was told to use; give symmetry='off', or "
        "holes, loads and fields that have it"
    ),
    Status.UNSTABLE: (
        "the stable branch ends, and no stable state was found by relaxation from there"
    ),
}


def remedy(status: Status, control: str) -> str:
    """Advice after no first state along a ``control``, to follow the text of its `Status`."""
    return (
        "; sweep with contact"
        if status is Status.SELF_CONTACT
        else "; start at a lower mu"
        if control == "mu"
        else ""
    )


def of_iterate(residual: float, solved: bool | np.bool_, exhausted: bool) -> Status | None:
    """Status of an iterate with this residual norm; None if the iteration goes on."""
    if not np.isfinite(residual):
        return Status.NOT_FINITE
    if solved:
        return Status.CONVERGED
    return Status.NOT_CONVERGED if exhausted else None


def of_outlines(x: Float[Array, "n 2"], model: Model, *, contact: bool) -> Status:
    """Status of an equilibrium by its outlines: ``CROSSED`` or ``SELF_CONTACT`` if they cross.

    One that crosses itself passed through the contact, or there is none.
    """
    if not overlaps(x, model):
        return Status.CONVERGED
    return Status.CROSSED if contact else Status.SELF_CONTACT


def for_derivatives(eigenvalue: float, *, crossing: bool, contact: bool) -> Status:
    """Whether the derivatives of a state are well posed, a `Status`.

    `NOT_EXAMINED` for an ``eigenvalue`` that is nan. The ``eigenvalue`` is the lowest, over the
    network's stiffness; ``crossing`` says whether an outline crosses itself.
    """
    if crossing:
        return Status.CROSSED if contact else Status.SELF_CONTACT
    if np.isnan(eigenvalue):
        return Status.NOT_EXAMINED
    return Status.NEARLY_SINGULAR if abs(eigenvalue) < NEARLY_SINGULAR else Status.CONVERGED
