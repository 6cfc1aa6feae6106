"""What a sweep leaves: its accepted states, together an equilibrium path."""

import dataclasses
from collections.abc import Sequence
from typing import overload

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Bool, Float, Int
from .._validation import check_kind
from ..controls import Control, control_name, unit_of
from ..discretisation import Model
from ..equilibrium import Stability, State, Status
from ..materials import AnyGel, LocalGel
from ..mechanics import Problem, localised

_SCALARS = ("mu", "value", "status", "newton_iterations", "residual", "energy", "negative_pivots", "lowest_eigenvalue", "switched")


@dataclasses.dataclass(frozen=True, eq=False)
class Path:
    """Accepted states of a sweep in the order in which they were found; k of them.

    ``path[i]`` is the `State` number i, ``path[-3:]`` or ``path[[0, 4]]`` the path of some of them, also where it is differentiated.
    """

    model: Model
    """The discretised plate."""
    gel: LocalGel
    """Material; a control may drive its parameters, see ``problem``."""
    mu: Float[Array, " k"]
    """Chemical potentials, kT."""
    x: Float[Array, "k n 2"]
    """Nodal positions, mm."""
    pressure: Float[Array, "k g"]
    """Pressure of the volume groups, kT/v."""
    status: list[Status] | Int[Array, " k"]
    """`Status` of each state."""
    newton_iterations: Int[Array, " k"]
    """Linear solves spent on each state."""
    residual: Float[Array, " k"]
    """Relative residuals; without derivatives, see ``lowest_eigenvalue``."""
    energy: Float[Array, " k"]
    """Total energies, kT/v mm^2."""
    negative_pivots: Int[Array, " k"]
    """Negative eigenvalues of the tangent."""
    lowest_eigenvalue: Float[Array, " k"]
    """Lowest eigenvalue of the tangent over the network's stiffness, see ``stability``; nan if not computed. Without derivatives: the
    reverse pass of a function of it is a ValueError, its tangents are nan; the function `lowest_eigenvalue` of a path has them."""
    switched: Bool[Array, " k"]
    """Whether the state left an unstable branch for a stable one."""
    symmetry: tuple[str, ...] = ()
    """Group of symmetries with which each state was found, see ``symmetry.NAMES``, C1 for the whole plate; empty where not known."""
    value: Float[Array, " k"] | None = None
    """Values of the control; None where that is the chemical potential."""
    control: Control | None = None
    """What drove the sweep; None for the chemical potential."""
    stop: Status | None = None
    """``CONVERGED`` where the sweep reached its end, otherwise why it stopped; None inside JAX's transformations."""
    stop_text: str = ""
    """The reason in one line, with the value of the control."""

    @classmethod
    def from_states(
        cls,
        model: Model,
        gel: AnyGel,
        states: Sequence[State],
        *,
        control: Control | None = None,
        stop: Status = Status.CONVERGED,
        stop_text: str = "",
    ) -> "Path":
        """Path of the given states (at least one) under a ``control``."""
        columns = {name: [getattr(state, name) for state in states] for name in _SCALARS}
        return cls(
            model=model,
            gel=localised(model, gel),
            x=np.stack([state.x for state in states]),
            pressure=np.stack([state.pressure for state in states]),
            status=columns.pop("status"),
            symmetry=tuple(state.symmetry for state in states),
            control=control,
            stop=stop,
            stop_text=stop_text or stop.text,
            **{name: np.array(column) for name, column in columns.items()},
        )

    def __post_init__(self) -> None:
        if self.value is None:
            object.__setattr__(self, "value", self.mu)

    @property
    def problem(self) -> Problem:
        """The problem that the states solve, but for loads; it has no precomputed operators."""
        return Problem(self.model, self.gel, jnp.zeros((self.model.n_nodes, 2)), None, self.control)

    def __len__(self) -> int:
        return len(self.mu)

    @overload
    def __getitem__(self, i: int | np.integer) -> State: ...
    @overload
    def __getitem__(self, i: "slice | Sequence[int] | Int[Array, ' m'] | Bool[Array, ' k']") -> "Path": ...
    def __getitem__(self, i: "int | np.integer | slice | Sequence[int] | Int[Array, ' m'] | Bool[Array, ' k']") -> "State | Path":
        """State number ``i``, without modes and factor; of a slice, or an array of numbers or truth values as NumPy takes them, the path
        of these states alone. IndexError beyond the path.
        """
        if not isinstance(i, int | np.integer):
            return self._of_states(np.arange(len(self))[i if isinstance(i, slice) else np.asarray(i, dtype=None if len(i) else int)])
        if not -len(self) <= i < len(self):
            raise IndexError(f"path: has no state {i}; it has {len(self)}, counted from 0")
        stability = Stability(np.array([self.lowest_eigenvalue[i]]), None, int(self.negative_pivots[i]))
        return State(
            mu=float(self.mu[i]),
            x=self.x[i],
            pressure=self.pressure[i],
            status=Status(int(self.status[i])),
            newton_iterations=int(self.newton_iterations[i]),
            residual=float(self.residual[i]),
            energy=float(self.energy[i]),
            stability=stability,
            switched=bool(self.switched[i]),
            symmetry=self.symmetry[i] if self.symmetry else "",
            control=None if self.control is None else float(self.value[i]),
        )

    def _of_states(self, numbers):
        columns = {name: getattr(self, name)[numbers] for name in ("x", "pressure", *_SCALARS) if name != "status"}
        columns["status"] = [self.status[k] for k in numbers] if isinstance(self.status, list) else self.status[numbers]
        return dataclasses.replace(self, symmetry=tuple(self.symmetry[k] for k in numbers) if self.symmetry else (), **columns)

    def __repr__(self) -> str:
        """States, ends of the control, stability and how the sweep ended; `plotting` draws it."""
        if isinstance(self.x, jax.core.Tracer):
            return f"Path of {self.x.shape[0]} traced states of {self.model.n_nodes} nodes"
        if len(self) == 0:
            return f"Path of no states of {self.model.n_nodes} nodes"
        unstable = int(np.sum(np.asarray(self.negative_pivots) > 0))
        ended = self.stop_text or (self.stop.text if self.stop is not None else "differentiated")
        name, unit = control_name(self.control), f" {unit_of(self.control)}".rstrip()
        between = f"{name} = {float(self.value[0]):.4f} ... {float(self.value[-1]):.4f}{unit}"
        return f"Path of {len(self)} states of {self.model.n_nodes} nodes, {between}, {unstable} unstable: {ended}"


def check_is_path(path: object) -> None:
    """Raise ValueError, one line, for an argument that is no `Path`."""
    check_kind("path", path, Path, "a Path, as sweep(model, gel, mu=...) returns it")
