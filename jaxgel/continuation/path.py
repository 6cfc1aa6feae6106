"""Equilibrium path: the accepted states of a sweep."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import overload

import jax
import numpy as np

from .._deprecated import OldAttribute
from .._tracing import is_traced
from .._types import Array, Bool, Float, Int
from .._validation import check_kind
from ..controls import Control
from ..discretisation import Model
from ..equilibrium import Change, Stability, State, Status, for_derivatives
from ..materials import LocalGel
from ..mechanics import Problem, overlaps

SCALARS = (
    "value",
    "mu",
    "status",
    "newton_iterations",
    "residual",
    "energy",
    "negative_pivots",
    "lowest_eigenvalue",
    "switched",
)
"""Numbers of a `State` that a path has as columns, and a run's folder as arrays."""
OF_SOLVENT = "potential", "supplied"
"""Arrays of a `State` of transient swelling."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["problem", *SCALARS, "derivative", "x", "pressure", "potential", "supplied"],
    meta_fields=["symmetry", "stop", "stop_text"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Path:
    """k accepted states in the order of their computation; `sweep` and `swell` return it. A pytree.

    `path[i]` is the `State` number i, `path[-3:]` or `path[[0, 4]]` the path of a selection, also
    if it is differentiated.
    """

    problem: Problem
    """The `Problem` that the states solve, without precomputed operators."""
    value: Float[Array, " k"]
    """Values of the control, in its unit; the times of transient swelling."""
    mu: Float[Array, " k"]
    """Chemical potentials, kT; in transient swelling the mean over the wetted boundary."""
    x: Float[Array, "k n 2"]
    """Nodal positions, mm."""
    pressure: Float[Array, "k g"]
    """Pressure of the volume groups, kT/v."""
    status: Int[Array, " k"]
    """`Status` of each state, an integer: how its solve ended."""
    newton_iterations: Int[Array, " k"]
    """Number of linear solves for each state."""
    residual: Float[Array, " k"]
    """Relative residuals, dimensionless; without derivatives, see `lowest_eigenvalue`."""
    energy: Float[Array, " k"]
    """Total energies, kT/v mm^2."""
    negative_pivots: Int[Array, " k"]
    """Number of negative eigenvalues of the tangent, 0 if stable; in time that at `potential`."""
    lowest_eigenvalue: Float[Array, " k"]
    """Lowest eigenvalue over the network's stiffness, see ``stability``; nan if not asked for.

    Without derivatives: the reverse pass of a function of it is a ValueError, its tangents are nan;
    the function `lowest_eigenvalue` of a path has them.
    """
    switched: Int[Array, " k"]
    """Why a state does not continue the states before it, a `Change`; 0 if it does."""
    derivative: Int[Array, " k"]
    """`Status` of a state's derivatives: ``CONVERGED`` if well posed, ``NOT_EXAMINED`` if unknown.

    It is not examined without its eigenvalue.
    """
    potential: Float[Array, "k g"] | None = None
    """Chemical potential of the solvent in each volume group, kT, of transient swelling.

    None if it is ``mu`` everywhere.
    """
    supplied: Float[Array, "k b"] | None = None
    """Solvent that has entered through each wetted part since time 0 of transient swelling, None
    otherwise: mm^3 over the dry thickness in mm."""
    symmetry: tuple[str, ...] = ()
    """Symmetry group with which each state was found, see ``symmetry.NAMES``; C1 for all of it.

    It is empty if not known; C1 stands for the whole plate.
    """
    stop: Status = Status.CONVERGED
    """``CONVERGED`` if the sweep reached its end, otherwise why it stopped."""
    stop_text: str = ""
    """The reason in one line, with the value of the control."""

    chosen = OldAttribute("__getitem__", written="path[states]")

    @classmethod
    def from_states(
        cls,
        problem: Problem,
        states: Sequence[State],
        *,
        stop: Status = Status.CONVERGED,
        stop_text: str = "",
    ) -> "Path":
        """Path of the given states (at least one) of a ``problem``."""
        columns = {name: np.array([getattr(state, name) for state in states]) for name in SCALARS}
        x = np.stack([state.x for state in states])
        derivative = np.full(len(x), int(Status.NOT_EXAMINED))
        for k in np.flatnonzero(np.isfinite(columns["lowest_eigenvalue"])):
            crossing = not problem.has_contact and overlaps(x[k], problem.model)
            derivative[k] = for_derivatives(
                columns["lowest_eigenvalue"][k], crossing=crossing, contact=problem.has_contact
            )
        return cls(
            problem=problem.replace(operators=None),
            x=x,
            pressure=np.stack([state.pressure for state in states]),
            derivative=derivative,
            symmetry=tuple(state.symmetry for state in states),
            **{
                name: np.stack([getattr(state, name) for state in states])
                for name in OF_SOLVENT
                if getattr(states[0], name) is not None
            },
            stop=stop,
            stop_text=stop_text or stop.text,
            **columns,
        )

    @property
    def model(self) -> Model:
        """The discretised plate, with its contact."""
        return self.problem.model

    @property
    def gel(self) -> LocalGel:
        """Material; a control may drive its parameters, see ``problem``."""
        return self.problem.gel

    @property
    def control(self) -> Control:
        """What drove the sweep."""
        return self.problem.control

    @property
    def t(self) -> Float[Array, " k"] | None:
        """Times of the states of transient swelling; None for states of equilibrium."""
        return None if self.potential is None else self.value

    @property
    def ok(self) -> Bool[Array, " k"]:
        """Whether each state satisfies equilibrium."""
        return self.status == Status.CONVERGED

    def __len__(self) -> int:
        return len(self.mu)

    @overload
    def __getitem__(self, i: int | np.integer) -> State: ...
    @overload
    def __getitem__(
        self, i: "slice | Sequence[int] | Int[Array, ' m'] | Bool[Array, ' k']"
    ) -> "Path": ...
    def __getitem__(
        self, i: "int | np.integer | slice | Sequence[int] | Int[Array, ' m'] | Bool[Array, ' k']"
    ) -> "State | Path":
        """State number ``i``, without modes and factor.

        Of a slice, or an array of numbers or truth values as NumPy takes them, the path of these
        states alone. IndexError beyond the path.
        """
        if not isinstance(i, int | np.integer):
            return self._of_states(
                np.arange(len(self))[
                    i if isinstance(i, slice) else np.asarray(i, dtype=None if len(i) else int)
                ]
            )
        if not -len(self) <= i < len(self):
            raise IndexError(f"path: has no state {i}; it has {len(self)}, counted from 0")
        lowest = float(self.lowest_eigenvalue[i])
        numbers = {name: getattr(self, name)[i] for name in ("value", "mu", "residual", "energy")}
        return State(
            **{
                name: number if is_traced(number) else float(number)
                for name, number in numbers.items()
            },
            x=self.x[i],
            pressure=self.pressure[i],
            status=Status(int(self.status[i])),
            newton_iterations=int(self.newton_iterations[i]),
            stability=Stability(
                int(self.negative_pivots[i]), None if np.isnan(lowest) else np.array([lowest])
            ),
            switched=Change(int(self.switched[i])),
            symmetry=self.symmetry[i] if self.symmetry else "",
            potential=None if self.potential is None else self.potential[i],
            supplied=None if self.supplied is None else self.supplied[i],
        )

    def _of_states(self, numbers):
        columns = {
            name: getattr(self, name)[numbers] for name in ("x", "pressure", "derivative", *SCALARS)
        }
        columns |= {
            name: getattr(self, name)[numbers]
            for name in OF_SOLVENT
            if getattr(self, name) is not None
        }
        return dataclasses.replace(
            self,
            symmetry=tuple(self.symmetry[k] for k in numbers) if self.symmetry else (),
            **columns,
        )

    def __repr__(self) -> str:
        """States, ends of the control, stability and how the sweep ended; `plotting` draws it."""
        if is_traced(self.x):
            return f"Path of {self.x.shape[0]} traced states of {self.model.n_nodes} nodes"
        if len(self) == 0:
            return f"Path of no states of {self.model.n_nodes} nodes"
        unstable = int(np.sum(np.asarray(self.negative_pivots) > 0))
        ended, unit = self.stop_text or self.stop.text, f" {self.control.unit}".rstrip()
        digits = ".4f" if self.t is None else ".4g"
        between = (
            f"{self.control.name} = {float(self.value[0]):{digits}} ... "
            f"{float(self.value[-1]):{digits}}{unit}"
        )
        return (
            f"Path of {len(self)} states of {self.model.n_nodes} nodes, {between}, {unstable} "
            f"unstable: {ended}"
        )


def check_is_path(path: object) -> None:
    """Raise ValueError, one line, for an argument that is no `Path`."""
    check_kind("path", path, Path, "a Path, as sweep(problem, values) returns it")
