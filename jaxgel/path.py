"""What a sweep leaves: its accepted states, one ``Step`` each, together a ``Path``."""

import dataclasses

import numpy as np
from jax.core import Tracer

from .equilibrium import Status, acting, energy_at


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


@dataclasses.dataclass(frozen=True, eq=False)
class Path:
    """Accepted states of a sweep in the order of mu; k of them."""

    model: object
    """The ``Model``."""
    gel: object
    """The ``Gel``."""
    mu: np.ndarray
    """(k,) chemical potentials, kT."""
    x: np.ndarray
    """(k, n, 2) nodal positions, mm."""
    pressure: np.ndarray
    """(k, g) pressure of the volume groups, kT/v."""
    status: list
    """(k,) ``Status`` of each state."""
    newton_iterations: np.ndarray
    """(k,) linear solves spent on each state."""
    residual: np.ndarray
    """(k,) relative residuals."""
    energy: np.ndarray
    """(k,) total energies, kT/v mm^2."""
    negative_pivots: np.ndarray
    """(k,) negative eigenvalues of the tangent."""
    lowest_eigenvalue: np.ndarray
    """(k,) lowest eigenvalue of the tangent over the network's stiffness, see ``stability``; nan where not computed."""
    switched: np.ndarray
    """(k,) whether the state left an unstable branch for a stable one."""
    stop: Status
    """``CONVERGED`` where the sweep reached its end, otherwise why it stopped."""
    stop_text: str
    """The reason in one line, with mu."""

    @classmethod
    def from_steps(cls, model, gel, steps, *, stop=Status.CONVERGED, stop_text=""):
        """Path of the given steps (at least one)."""
        columns = {name: [getattr(step, name) for step in steps] for name in _COLUMNS}
        return cls(
            model=model,
            gel=gel,
            x=np.stack([step.x for step in steps]),
            pressure=np.stack([step.pressure for step in steps]),
            status=columns.pop("status"),
            stop=stop,
            stop_text=stop_text or stop.text,
            **{name: np.array(column) for name, column in columns.items()},
        )

    def __len__(self):
        return len(self.mu)

    def _repr_html_(self):
        """How a notebook shows the path: its last pattern and a small table; None, for the plain text, inside JAX's transformations."""
        from .view import notebook_html  # a figure is drawn only where one is looked at

        return None if isinstance(self.x, Tracer) else notebook_html(self)


_COLUMNS = ("mu", "status", "newton_iterations", "residual", "energy", "negative_pivots", "lowest_eigenvalue", "switched")
