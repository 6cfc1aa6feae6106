"""Bloch waves of a periodic cell: u(X + R) = exp(i k . R) u(X) for its translations R.

They are fields u (Bloch 1929), for all translations. Nodes on the right and top edge follow those
that stand for them on the left and bottom edge with the phases of one translation, so a matrix K of
the cell's nodal fields becomes, for waves with the wave vector k,

    K(k) = sum over R of exp(i k . R) K_R

where K_R has the entries of K between fields that are R apart. K(-k) is the complex conjugate of
K(k). Wave vectors belong to the dry cell. A complex unknown is a node with two real ones, its real
and its imaginary part, so the factors are those of all other matrices.
"""

import functools

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from .._memo import once_per_owner
from .._types import Complex, Float, Inexact
from ..discretisation import Connectivity
from ..equilibrium import State
from ..linalg import Factor, Pattern, analyse, factor, nearest_modes, network_matrix
from ..mechanics import (
    Problem,
    held_dofs,
    linearise,
    node_pairs,
    periodic_images,
    scatter,
    tangent,
    touches,
)
from .cells import check_periodic

# below zero, over the stiffness of the network: where the lowest eigenvalues are looked for first
FIRST_SHIFT = 0.05
SHIFTS = 12  # times the shift is made three times as low before the search gives up
AT_REST = 1e-12  # largest phase, rad, of waves that are the same in all cells


class BlochStates:
    """The waves about one state of a periodic cell.

    ValueError if the plate is not periodic or the sides of a hole touch. Matrices of the waves with
    one wave vector k, (2,) in rad/mm, are their entries (e,) at the places of `BlochLayout`.
    """

    def __init__(self, problem: Problem, state: State) -> None:
        check_periodic(problem.model.lists.topology.plate)
        if problem.has_contact and touches(state.x, problem.model):
            raise ValueError(
                f"state: the sides of a hole touch at mu = {state.mu:g}; waves are those of a "
                "state without contact"
            )
        self.problem, self.state, self.layout = problem, state, layout_of(problem.model.lists)

    @functools.cached_property
    def _blocks(self):
        """The tangent and the stiffness of the network, kT/v, by the model's node pairs."""
        at = self.problem, self.state.x, self.state.pressure
        network = self.problem.network[:, None, None] * np.eye(2)
        return np.asarray(tangent(*at, linearise(*at, self.state.mu))), network

    @functools.cached_property
    def _parts(self):
        return [self.layout.by_translation(blocks) for blocks in self._blocks]

    @property
    def stiffness(self) -> Float[np.ndarray, "r e"]:
        """The tangent, kT/v, by translations."""
        return self._parts[0]

    def network_energy(self, field: Float[np.ndarray, "n 2"]) -> float:
        """V . N v of a nodal field (n, 2), kT/v mm^2."""
        i, j = node_pairs(self.problem.model.lists)[0].T
        twice = np.where(i == j, 1.0, 2.0) * self.problem.network
        return float(twice @ np.sum(field[i] * field[j], axis=1))

    def _entries(self, wave_vector):
        """Layout of the waves of a wave vector, and entries of tangent and network stiffness."""
        layout = self.layout.of(wave_vector)
        parts = (
            self._parts
            if layout is self.layout
            else [layout.by_translation(blocks) for blocks in self._blocks]
        )
        phases = layout.phases(wave_vector)
        return layout, [phases @ part for part in parts]

    @functools.cached_property
    def _own(self):
        """Factor of the cell's tangent and network stiffness, free strains among the unknowns."""
        pairs, network = self._blocks
        return factor(self.problem.pattern, pairs), network_matrix(
            self.problem.pattern, network[:, 0, 0]
        )

    def _strains(self, wave_vector):
        """Whether the waves with a wave vector are the same in all cells and may strain them."""
        return (
            self.problem.free.n_macroscopic > 0 and self.layout.of(wave_vector) is not self.layout
        )

    def negative(self, wave_vector: Float[np.ndarray, " 2"]) -> int:
        """Number of unstable waves with a ``wave_vector`` (2,), rad/mm."""
        if self._strains(wave_vector):
            return self._own[0].negative_pivots
        layout, (stiffness, _) = self._entries(wave_vector)
        return layout.factor(stiffness).negative_pivots // 2

    def lowest(
        self, wave_vector: Float[np.ndarray, " 2"], count: int = 1
    ) -> tuple[Float[np.ndarray, " m"], Complex[np.ndarray, "m n 2"]]:
        """The ``count`` lowest eigenvalues (m,) of waves, and their nodal fields (m, n, 2).

        The ``wave_vector`` (2,) is in rad/mm. They are those of ``stability``: of the tangent over
        the stiffness of the network, dimensionless, negative if unstable. Waves that are the same
        in all cells do not move the corner that stands for the cell's place; free components of the
        macroscopic deformation belong to them, and to no others.
        """
        if self._strains(wave_vector):
            made, network = self._own
            parts = [(made.negative_pivots, "SA"), (count - made.negative_pivots, "LA")]
            found = [
                nearest_modes(made, network, number, which=which)
                for number, which in parts
                if number > 0
            ]
            fields = [
                np.asarray(scatter(mode, self.problem.free))
                for _, modes in found
                for mode in modes.T
            ]
            return np.concatenate([values for values, _ in found])[:count], np.array(
                fields[:count], dtype=complex
            )
        layout, (stiffness, network) = self._entries(wave_vector)
        values, vectors = layout.lowest(stiffness, network, count, FIRST_SHIFT)
        return values, layout.fields(vectors, wave_vector)


class BlochLayout:
    """Unknowns of a cell's waves, offsets of their slaves, and their pairs.

    Offsets are those of the degrees of freedom that follow them.
    """

    def __init__(self, lists: Connectivity, *, corner: bool = True) -> None:
        topology = lists.topology
        nodes = topology.partition.vertices[topology.node_vertices]
        first, fixed = periodic_images(topology), held_dofs(topology)
        self._sides = np.array([topology.plate.width, topology.plate.height])
        self._steps, self._lists = np.round((nodes - nodes[first]) / self._sides).astype(int), lists
        held = np.zeros((len(nodes), 2), dtype=bool)
        np.logical_or.at(held, first, fixed)
        if not corner:
            held[np.argmin(nodes.sum(axis=1))] |= ~fixed.any(axis=0)
        own = ~held & (first == np.arange(len(nodes)))[:, None]
        numbers = np.where(own, np.cumsum(own.ravel()).reshape(own.shape) - 1, -1)
        self._numbers, self.size = numbers[first].ravel(), int(own.sum())
        self._points = np.repeat(nodes, 2, axis=0)[own.ravel()]
        self.translations, self._pairs, self._source, self._slot = self._places(
            node_pairs(lists)[0]
        )

    def _places(self, nodes):
        """Translations (r, 2), pairs (e, 2), and destinations of the blocks of ``nodes`` (p, 2).

        Pairs of unknowns; which entry of the blocks of all pairs of nodes goes where.
        """
        i, j = nodes.T
        row, column = np.broadcast_arrays(
            2 * i[:, None, None] + np.array([[0], [1]]), 2 * j[:, None, None] + np.array([[0, 1]])
        )
        source = np.arange(row.size)
        apart = np.repeat(i != j, 4)
        row, column, source = (
            np.concatenate([a.ravel(), b.ravel()[apart]])
            for a, b in ((row, column), (column, row), (source, source))
        )
        at, to = self._numbers[row], self._numbers[column]
        real = (at >= 0) & (to >= at)
        steps = (self._steps[column // 2] - self._steps[row // 2])[real]
        kinds, kind = np.unique(steps, axis=0, return_inverse=True)
        keys, place = np.unique(
            at[real].astype(np.int64) * self.size + to[real], return_inverse=True
        )
        pairs = np.stack([keys // self.size, keys % self.size], axis=1)
        return kinds * self._sides, pairs, source[real], kind.ravel() * len(keys) + place

    def of(self, wave_vector: Float[np.ndarray, " 2"]) -> "BlochLayout":
        """The layout itself or, without a phase, that of fields that fix the corner.

        If no translation has a phase.
        """
        return (
            layout_of(self._lists, False)
            if np.abs(self.translations @ wave_vector).max() < AT_REST
            else self
        )

    def phases(self, wave_vector: Float[np.ndarray, " 2"]) -> Complex[np.ndarray, " r"]:
        """Phases of the translations.

        Their product with a matrix by translations are its entries.
        """
        return np.exp(1j * (self.translations @ np.asarray(wave_vector)))

    def by_translation(self, blocks: Float[np.ndarray, "p 2 2"]) -> Float[np.ndarray, "r e"]:
        """Entries (r, e) by translations of a matrix by blocks (p, 2, 2) of node pairs."""
        size = len(self.translations) * len(self._pairs)
        return np.bincount(self._slot, blocks.ravel()[self._source], minlength=size).reshape(
            len(self.translations), -1
        )

    @functools.cached_property
    def _pattern(self) -> Pattern:
        return analyse(self._pairs, self._points, np.arange(2 * self.size))

    def factor(self, entries: Complex[np.ndarray, " e"]) -> Factor:
        """Factor of a Hermitian matrix, whose real form has every eigenvalue twice."""
        blocks = np.array([[entries.real, -entries.imag], [entries.imag, entries.real]])
        return factor(self._pattern, blocks.transpose(2, 0, 1))

    def matrix(self, entries: Inexact[np.ndarray, " e"]) -> sp.csr_matrix:
        """The Hermitian matrix (b, b)."""
        row, column = self._pairs.T
        upper = sp.csr_matrix((entries, (row, column)), shape=(self.size, self.size))
        return sp.csr_matrix(upper + sp.triu(upper, 1).conj().T)

    def lowest(
        self,
        matrix: Complex[np.ndarray, " e"],
        weight: Complex[np.ndarray, " e"],
        count: int,
        below: float,
    ) -> tuple[Float[np.ndarray, " m"], Complex[np.ndarray, "b m"]]:
        """Lowest eigenvalues (m,) of K v = lambda W v, ascending, and vectors with v* W v = 1.

        W is positive definite. Shift-invert Lanczos from a shift ``below`` zero under which, by the
        pivots, no eigenvalue lies; ArithmeticError without one.
        """
        for power in range(SHIFTS):
            shift = -below * 3.0**power
            moved = self.factor(matrix - shift * weight)
            if moved.negative_pivots == 0:
                break
        else:
            raise ArithmeticError(f"waves: eigenvalues lie below {shift:g}")

        def solve(v):
            return moved.apply(np.ascontiguousarray(v.ravel()).view(float)).view(complex)

        W, inverse = (
            self.matrix(weight),
            sla.LinearOperator((self.size, self.size), matvec=solve, dtype=complex),
        )
        start = np.exp(1j * np.arange(self.size) ** 1.5)
        values, vectors = sla.eigsh(
            self.matrix(matrix), count, W, shift, which="LM", OPinv=inverse, v0=start
        )
        rank = np.argsort(values.real)
        vectors = vectors[:, rank] / np.sqrt(
            np.einsum("bm,bm->m", vectors[:, rank].conj(), W @ vectors[:, rank]).real
        )
        return values.real[rank], vectors

    def fields(
        self, vectors: Complex[np.ndarray, "b m"], wave_vector: Float[np.ndarray, " 2"]
    ) -> Complex[np.ndarray, "m n 2"]:
        """Nodal fields (m, n, 2) of vectors (b, m)."""
        padded = np.append(vectors, np.zeros((1, vectors.shape[1])), axis=0)
        fields = padded[self._numbers].T.reshape(vectors.shape[1], -1, 2)
        return fields * np.exp(1j * (self._steps * self._sides) @ np.asarray(wave_vector))[:, None]


@once_per_owner
def layout_of(lists: Connectivity, corner: bool = True) -> BlochLayout:
    """The `BlochLayout` of a cell's lists.

    Without its ``corner`` that of waves which leave the corner at rest.
    """
    return BlochLayout(lists, corner=corner)
