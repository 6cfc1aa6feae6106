"""What a sweep leaves: its accepted states, one ``Step`` each, together a ``Path``."""

import dataclasses

import numpy as np
from jax.core import Tracer

from ..equilibrium import Status


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
        from ..cases import notebook_html  # a figure is drawn only where one is looked at

        return None if isinstance(self.x, Tracer) else notebook_html(self)


_COLUMNS = ("mu", "status", "newton_iterations", "residual", "energy", "negative_pivots", "lowest_eigenvalue", "switched")
