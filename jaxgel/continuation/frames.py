"""The problem in which a state is looked for: that of the whole plate, or where the state is symmetric that of a fundamental region.

A sweep's states are those of the whole plate. A `Frame` takes from them what its problem needs and makes whole states of what it finds;
stability is that of the whole plate either way, of a region block by block.
"""

import dataclasses
import functools
from typing import Protocol

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from .._types import Array, Float
from ..equilibrium import Stability, State, acting_problem
from ..linalg import (
    Factor,
    Pattern,
    columnwise_products,
    factor,
    inverse_iteration,
    lowest_of_factor,
    network_matrix,
    solve_near_factor,
)
from ..mechanics import Problem, linearise, precomputed_operators, scatter, start_positions, tangent, unknowns
from ..symmetry import NAMES, Basis, Region, bases, region, symmetries_of, symmetries_of_field, symmetries_of_state
from .predictor import rate_of_change
from .stability import StabilityAnalysis, lowest_by_factor

FEW = 64  # unknowns of a block up to which all of its eigenvalues are computed
OF_BLOCK = 2  # modes followed in each block
NEGLIGIBLE = 1e-15  # part of a right-hand side in a block that is round-off
OWN = 0.5  # share of a mode's size that is left in the block to which it belongs


class Frame(Protocol):
    """A problem with the way from and to states of the whole plate."""

    group: tuple[str, ...]
    """The symmetries that its states have."""
    problem: Problem
    """What its states solve."""

    @property
    def stiffness(self) -> sp.csr_matrix:
        """Stiffness (f, f) of the network on its unknowns, see `stability`."""
        ...

    def part(self, state: State) -> State:
        """Of a whole state what the problem needs; its modes stay those of the whole plate."""
        ...

    def whole(self, state: State) -> State:
        """The whole state."""
        ...

    def onto(self, x: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Nodal positions next to ``x`` (n, 2) that satisfy the conditions and have all symmetries.

        Extrapolation lets the round-off that states have in common grow like a power of their number.
        """
        ...

    def along(self, mode: Float[np.ndarray, " f"]) -> Float[np.ndarray, " b"]:
        """A mode (f,) of the whole plate on the unknowns of the problem; 0 where the mode has not its symmetries."""
        ...

    def check(self, state: State, modes: Float[np.ndarray, "f m"] | None) -> tuple[Stability, State]:
        """`Stability` of a state found, and the state with the factor that was used; ``modes`` (f, m) are those of a nearby state."""
        ...

    def rate(self, state: State) -> Float[np.ndarray, "n 2"]:
        """dx/dmu, mm/kT, at a state that was checked."""
        ...


class Frames:
    """The frames of a problem, one for each group that a state of it may have."""

    def __init__(self, problem: Problem, *, symmetry: bool) -> None:
        self.problem, self.group = problem, symmetries_of(problem) if symmetry else ()
        self._known: dict[tuple[str, ...], Frame] = {}

    def of(self, group: tuple[str, ...]) -> Frame:
        """The frame of the states with these symmetries."""
        if group not in self._known:
            self._known[group] = RegionFrame(region(self.problem, group), self.problem) if group else WholeFrame(self.problem)
        return self._known[group]

    def of_state(self, x: Float[Array, "n 2"]) -> Frame:
        """The frame of states next to the nodal positions ``x`` (n, 2)."""
        return self.of(symmetries_of_state(x, self.problem.model, self.group))

    def along_mode(self, state: State, mode: Float[np.ndarray, " f"]) -> Frame:
        """The frame of the branches that leave a whole state along a ``mode`` (f,)."""
        field = scatter(mode, state.x.shape, unknowns(self.problem.model.lists))
        return self.of(symmetries_of_field(field, self.problem.model, self.of_state(state.x).group))


class _Conditions:
    """What the frames share: the conditions that all states of a ``problem`` satisfy."""

    problem: Problem

    @functools.cached_property
    def _places(self):
        """The dry positions that satisfy the conditions, flat, the unknowns, and of all that moves with them numbers and signs."""
        model, free = self.problem.model, np.asarray(self.problem.free)
        free = free[:, None] if free.ndim == 1 else free
        dry = np.asarray(start_positions(model.lists.topology, model.cloud.nodes)).ravel()
        return np.append(dry, [0.0, 0.0]), free[:, 0], np.where(free < 0, ~free, free), np.where(free < 0, -1.0, 1.0)

    def onto(self, x: Float[Array, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """See `Frame`. The last two places are the padding of degrees of freedom that move together."""
        dry, leaders, numbers, signs = self._places
        positions = dry.copy()
        positions[numbers] += signs * (np.asarray(x).ravel()[leaders] - dry[leaders])[:, None]
        return positions[:-2].reshape(-1, 2)


class WholeFrame(_Conditions):
    """The `Frame` of states without symmetry."""

    group: tuple[str, ...] = ()

    def __init__(self, problem: Problem) -> None:
        if problem.operators is None:
            problem = dataclasses.replace(problem, operators=precomputed_operators(problem.model, problem.gel))
        self.problem, self._analysis = problem, StabilityAnalysis(problem)

    @property
    def stiffness(self) -> sp.csr_matrix:
        """See `Frame`."""
        return self._analysis.stiffness

    def part(self, state: State) -> State:
        """See `Frame`."""
        return state

    def whole(self, state: State) -> State:
        """See `Frame`."""
        return dataclasses.replace(state, symmetry=NAMES[()])

    def along(self, mode: Float[np.ndarray, " f"]) -> Float[np.ndarray, " b"]:
        """See `Frame`."""
        return mode

    def check(self, state: State, modes: Float[np.ndarray, "f m"] | None) -> tuple[Stability, State]:
        """See `Frame`."""
        return self._analysis.check(state, modes)

    def rate(self, state: State) -> Float[np.ndarray, "n 2"]:
        """See `Frame`."""
        return rate_of_change(self.problem, state)


class RegionFrame(_Conditions):
    """The `Frame` of states with a group of symmetries."""

    def __init__(self, reduced: Region, whole: Problem) -> None:
        self.group, self.problem, self._region, self._whole = reduced.group, reduced.problem, reduced, whole

    @functools.cached_property
    def stiffness(self) -> sp.csr_matrix:
        """See `Frame`."""
        return self._stiffnesses[0]

    @functools.cached_property
    def _bases(self):
        model = self._whole.model
        return bases(model.lists, self.group, model.solver, model.dmax if model.contact is not None else None)

    @functools.cached_property
    def _stiffnesses(self):
        """Stiffness (b, b) of the network in each block."""
        network = np.asarray(self.problem.operators.network)
        return [network_matrix(basis.pattern.narrower or basis.pattern, network) for basis in self._bases]

    @functools.cached_property
    def _projections(self):
        """Per block the matrix (b, f) that takes a field to its coordinates, and how many degrees of freedom move with each unknown."""
        counts = [np.asarray(basis.fields[0].power(2).sum(axis=0)).ravel() for basis in self._bases]
        return [(sp.csr_matrix(basis.fields[0].multiply(1 / size).T), size) for basis, size in zip(self._bases, counts, strict=True)]

    def _coordinates(self, number, modes):
        """Coordinates (b, m) of the modes (f, m) in a block; 0 of those that belong to another block."""
        projection, counts = self._projections[number]
        found = projection @ modes
        inside = counts @ found**2 > OWN**2 * np.sum(modes**2, axis=0)
        return np.where(inside, found, 0.0)

    def part(self, state: State) -> State:
        """See `Frame`."""
        return dataclasses.replace(state.light, pressure=np.asarray(state.pressure)[self._region.own])

    def whole(self, state: State) -> State:
        """See `Frame`."""
        pressure = self._region.spread @ np.asarray(state.pressure)
        return dataclasses.replace(state, pressure=pressure, linearisation=None, symmetry=NAMES[self.group])

    def along(self, mode: Float[np.ndarray, " f"]) -> Float[np.ndarray, " b"]:
        """See `Frame`."""
        return self._coordinates(0, mode[:, None])[:, 0]

    def check(self, state: State, modes: Float[np.ndarray, "f m"] | None) -> tuple[Stability, State]:
        """See `Frame`: every block by a factor of its own."""
        problem = acting_problem(self.problem, state)
        at = problem, state.x, state.pressure
        state = dataclasses.replace(state, factor=None)  # free it before the next factorisation
        pairs = np.asarray(tangent(*at, state.linearisation if state.linearisation is not None else linearise(*at, state.mu)))
        parts, factors = [], []
        for basis, stiffness in zip(self._bases, self._stiffnesses, strict=True):
            factors.append(factor(basis.pattern, pairs))
            parts.append(_block_stability(factors[-1], stiffness, None if modes is None else self._coordinates(len(parts), modes)))
        return _together(self._bases, parts), dataclasses.replace(state, factor=BlockFactor(acting_problem(self._whole, state), self._bases, tuple(factors)))

    def rate(self, state: State) -> Float[np.ndarray, "n 2"]:
        """See `Frame`."""
        return rate_of_change(self.problem, dataclasses.replace(state, factor=state.factor.factors[0]))


def _block_stability(made, stiffness, start):
    """`Stability` of a block by its own factor, from those of the vectors ``start`` (b, m) that are not 0."""
    if stiffness.shape[0] <= FEW:
        values, vectors = scipy.linalg.eigh(made.matrix.toarray(), stiffness.toarray())
        return Stability(values[:OF_BLOCK], vectors[:, :OF_BLOCK], made.negative_pivots)

    def product(vectors):
        return columnwise_products(made.matrix, vectors)

    known = None if start is None else start[:, np.any(start != 0, axis=0)]
    if known is not None and known.shape[1]:
        found = lowest_by_factor(made, stiffness, product, known)
        if int(np.sum(found.eigenvalues < 0)) == min(found.negative, len(found.eigenvalues)):
            return found
    followed, _ = inverse_iteration(made, stiffness, lowest_of_factor(made, stiffness)[:, : max(OF_BLOCK, made.negative_pivots)])
    return lowest_by_factor(made, stiffness, product, followed)


def _together(found: tuple[Basis, ...], parts: list[Stability]) -> Stability:
    """`Stability` of the plate from those of its blocks."""
    eigenvalues = np.concatenate([part.eigenvalues for part in parts])
    vectors = [basis.fields[0] @ part.vectors for basis, part in zip(found, parts, strict=True)]
    first = np.concatenate([modes[:, : len(part.eigenvalues)] for modes, part in zip(vectors, parts, strict=True)], axis=1)
    rest = [modes[:, len(part.eigenvalues) :] for modes, part in zip(vectors, parts, strict=True)]
    rank = np.argsort(eigenvalues, kind="stable")
    symbols = [basis.representation.name for basis, part in zip(found, parts, strict=True) for _ in part.eigenvalues]
    negative = sum(part.negative * basis.representation.copies for basis, part in zip(found, parts, strict=True))
    return Stability(eigenvalues[rank], np.concatenate([first[:, rank], *rest], axis=1), negative, symbols[rank[0]])


@dataclasses.dataclass(frozen=True, eq=False)
class BlockFactor:
    """A factorised tangent of the whole plate at a symmetric state, as the factors of its blocks; serves where a ``linalg.Factor`` does."""

    problem: Problem
    """The problem of the whole plate."""
    bases: tuple[Basis, ...]
    """The `Basis` of every block."""
    factors: tuple[Factor, ...]
    """The factor of every block."""

    @property
    def pattern(self) -> Pattern:
        """The pattern of the whole tangent."""
        return self.problem.pattern

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the whole tangent."""
        return sum(made.negative_pivots * basis.representation.copies for basis, made in zip(self.bases, self.factors, strict=True))

    @property
    def size(self) -> int:
        """Bytes it fills."""
        return sum(made.size for made in self.factors)

    def apply(self, rhs: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
        """Solution (f,) for the right-hand side, block by block; a block that it does not excite is left out."""
        solution, size = np.zeros(len(rhs)), np.linalg.norm(rhs)
        for basis, made in zip(self.bases, self.factors, strict=True):
            for fields in basis.fields:
                part = fields.T @ rhs
                if np.linalg.norm(part) > NEGLIGIBLE * size:
                    solution += fields @ made.apply(part)
        return solution

    def solve_other(self, rhs: Float[np.ndarray, " f"], product: object) -> Float[np.ndarray, " f"] | None:
        """Solution (f,) for another matrix, see ``linalg.solve_near_factor``."""
        return solve_near_factor(rhs, product, self.apply)
