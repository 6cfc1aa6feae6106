"""Dispersion of small oscillations of a swollen periodic cell: its frequencies by wave vector, and the gaps between them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from .._threads import few_threads
from .._types import Float
from ..continuation import Path
from ..discretisation import Model, make_probe
from ..mechanics import mean_stiffness, node_pairs, prepare
from ..symmetry import symmetries_of, symmetries_of_state
from .bloch import BlochStates
from .zone import brillouin_path

POINTS = 12  # wave vectors from one corner of the zone to the next
BELOW = 1e-3  # of the network's stiffness over the mass of half a wave in the cell: where the lowest squares are looked for first


@dataclasses.dataclass(frozen=True, eq=False)
class Dispersion:
    """Frequencies of small oscillations about a state; NumPy arrays.

    They are in units of sqrt(kT / (v density)) / mm, see `dispersion`.
    """

    mu: float
    """Chemical potential of the state, kT."""
    wave_vectors: Float[np.ndarray, "w 2"]
    """Wave vectors of the dry cell, rad/mm."""
    along: Float[np.ndarray, " w"]
    """Distance along the way through the zone, rad/mm."""
    corners: list[tuple[str, float]]
    """(label, distance along it) of the corners of the way, see `zone.brillouin_path`."""
    squares: Float[np.ndarray, "w m"]
    """Squares of the lowest angular frequencies, ascending; negative where the state is unstable."""

    @property
    def frequencies(self) -> Float[np.ndarray, "w m"]:
        """Angular frequencies; nan where a square is negative by more than round-off."""
        floor = -1e-9 * np.abs(self.squares).max()
        return np.sqrt(np.where(self.squares < floor, np.nan, np.maximum(self.squares, 0.0)))

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Intervals of frequencies between two bands in which none of these waves lies; [] where the state is unstable."""
        bands = self.frequencies
        if np.isnan(bands).any():
            return []
        below, above = bands.max(axis=0)[:-1], bands.min(axis=0)[1:]
        return [(float(low), float(high)) for low, high in zip(below, above, strict=True) if high > low]


def dispersion(
    path: Path, state: int = -1, *, bands: int = 6, points: int = POINTS, wave_vectors: Float[np.ndarray, "w 2"] | None = None
) -> Dispersion:
    """`Dispersion` of the lowest ``bands`` about one ``state`` of a periodic cell's path, along the edge of the Brillouin zone.

    ``points`` lie from one corner of the zone to the next; ``wave_vectors`` (w, 2), rad/mm, replace them. The stiffness is the tangent at
    fixed mu, of oscillations so slow that solvent flows in and out. Network and solvent have the same density in the swollen gel, so that
    the mass of a dry area is its J; angular frequencies are in sqrt(kT / (v density)) / mm: 2e5 rad/s for kT / v = 40 MPa and 1000 kg/m^3.
    Raises ValueError for a plate that is not periodic, a film, a state in contact, and more bands than the cell has waves.
    """
    problem = prepare(path.model, path.gel)
    plate = path.model.lists.topology.plate
    if plate.kinematics != "plane strain":
        raise ValueError(f"kinematics: {plate.kinematics!r} has no dispersion; the thickness would follow the waves")
    at = path[range(len(path))[state]]
    waves = BlochStates(problem, at)
    layout = waves.layout
    most = layout.size - 2
    if not 0 < bands <= most:
        raise ValueError(f"bands: {bands} is not between 1 and {most}, the waves that this cell has")
    if wave_vectors is None:
        group = symmetries_of_state(at.x, path.model, symmetries_of(problem.without_contact))
        if not (isinstance(points, int) and points > 0):
            raise ValueError(f"points: {points!r} is not a positive whole number")
        wave_vectors, along, corners = brillouin_path(plate, points, group)
    else:
        wave_vectors = np.asarray(wave_vectors, dtype=float).reshape(-1, 2)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(wave_vectors, axis=0), axis=1))])
        corners = []
    mass = layout.by_translation(mass_blocks(path.model, at.x))
    below = BELOW * float(mean_stiffness(problem.gel, path.model)) * (np.pi / max(plate.width, plate.height)) ** 2
    phases = [layout.phases(k) for k in wave_vectors]
    with few_threads(2 * layout.size):
        squares = np.array([layout.lowest(phase @ waves.stiffness, phase @ mass, bands, below)[0] for phase in phases])
    return Dispersion(at.mu, wave_vectors, along, corners, squares)


def mass_blocks(model: Model, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "p 2 2"]:
    """Mass, mm^2, by the model's node pairs at positions ``x`` (n, 2), mm: the integral of J phi_i phi_j over the dry plate."""
    topology = model.lists.topology
    quadrature, (i, j) = topology.quadrature, node_pairs(model.lists)[0].T
    probe = make_probe(model, quadrature.points(model.cloud.vertices), np.asarray(quadrature.points(topology.partition.vertices)))
    weight = np.asarray(quadrature.weights(model.cloud.vertices) * jnp.linalg.det(probe.deformation_gradient(jnp.asarray(x))))
    values, nodes = np.asarray(probe.phi), np.asarray(probe.nodes)
    if np.iscomplexobj(values):
        raise ValueError(f"kind: {model.kind!r} has complex shape functions, for which there is no mass")
    points = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    shapes = sp.csr_matrix((values.ravel(), (points, nodes.ravel())), shape=(len(nodes), model.n_nodes))
    mass = sp.csr_matrix(shapes.T @ shapes.multiply(weight[:, None]))
    return np.asarray(mass[i, j]).reshape(-1, 1, 1) * np.eye(2)
