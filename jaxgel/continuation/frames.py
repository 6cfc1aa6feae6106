"""The problem of a step: of the whole plate or, for a symmetric state, a fundamental region.

A sweep's states are those of the whole plate. A `Frame` takes from them what its problem needs and
makes whole states of what it finds; stability is that of the whole plate either way, of a region
block by block.
"""

import dataclasses
import functools

import numpy as np
import scipy.sparse as sp

from .._types import Array, Float
from .._validation import Inadmissible
from ..equilibrium import Stability, State, linearised, with_own_factor
from ..linalg import BlockFactor, Diagonal, factor, network_matrix
from ..mechanics import Problem, couplings, restrict, scatter, tangent, unknowns, with_free_values
from ..symmetry import (
    NAMES,
    Region,
    are_places_known,
    bases,
    possible_symmetries,
    region,
    symmetries_of,
    symmetries_of_field,
    symmetries_of_state,
)
from .predictor import rate_of_change
from .stability import StabilityAnalysis, stability_of_factor

GROUPS = {name: group for group, name in NAMES.items() if group}
ROUND_OFF = 1e-6  # part of a mode's size, squared, in a block to which it does not belong


class Frame(StabilityAnalysis):
    """A problem and its maps to states of the whole plate: here the whole plate itself."""

    group: tuple[str, ...] = ()
    """The symmetries that its states have."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.prepared)

    def part(self, state: State) -> State:
        """Of a whole state what the problem needs; its modes stay those of the whole plate."""
        return state

    def whole(self, state: State) -> State:
        """The whole state."""
        return dataclasses.replace(state, symmetry=NAMES[()])

    def onto(self, x: Float[Array, "n 2"], value: float) -> Float[np.ndarray, "n 2"]:
        """Symmetric nodal positions next to ``x`` (n, 2) with the conditions at a ``value``.

        It is a value of the control. Extrapolation lets the round-off that states have in common
        grow like a power of their number.
        """
        free = self.problem.free
        dry = (
            np.asarray(self.problem.dry_positions(value))
            if self.problem.moves_edges
            else self._at_rest
        )
        return np.asarray(with_free_values(restrict(np.asarray(x), free), dry, free))

    @functools.cached_property
    def _at_rest(self):
        """The dry positions that satisfy the conditions where the control moves no edges."""
        return np.asarray(self.problem.dry_positions(0.0))

    def along(self, mode: Float[np.ndarray, " f"]) -> Float[np.ndarray, " b"]:
        """A mode (f,) of the whole plate on the problem's unknowns; 0 if not symmetric."""
        return mode

    def factorised(self, state: State) -> State:
        """A state found, with a factor of its own tangent, which counts its negative eigenvalues.

        Raises `linalg.SingularTangent`.
        """
        return with_own_factor(self.problem, state)

    def rate(self, state: State) -> Float[np.ndarray, "n 2"]:
        """dx/dvalue, mm over the control's unit, at a state that was checked."""
        return rate_of_change(self.problem, state)


class RegionFrame(Frame):
    """The `Frame` of states with a group of symmetries."""

    def __init__(self, reduced: Region, whole: Problem) -> None:
        self.group, self.problem, self._region, self._whole = (
            reduced.group,
            reduced.problem,
            reduced,
            whole,
        )

    @functools.cached_property
    def stiffness(self) -> sp.csr_matrix:
        """That of the network on the symmetric fields."""
        return self._stiffnesses[0]

    @functools.cached_property
    def _bases(self):
        return bases(self._whole.model.lists, self.group)

    @functools.cached_property
    def _stiffnesses(self):
        """Stiffness (b, b) of the network in each block."""
        network = self.problem.network
        return [network_matrix(basis.pattern, network) for basis in self._bases]

    @functools.cached_property
    def _stiffness(self):
        """That of all blocks, (b, b)."""
        return sp.block_diag(self._stiffnesses, format="csr")

    @functools.cached_property
    def _fields(self) -> sp.csr_matrix:
        """Matrix (f, b) from the coordinates of all blocks, one copy of each, to fields."""
        return sp.hstack([basis.fields[0] for basis in self._bases], format="csr")

    @functools.cached_property
    def _projection(self) -> sp.csr_matrix:
        """Matrix (b, f) from fields to the coordinates of all blocks."""
        sizes = np.asarray(self._fields.power(2).sum(axis=0)).ravel()
        return sp.csr_matrix(self._fields.multiply(1 / sizes).T)

    @functools.cached_property
    def _cuts(self):
        """Where the coordinates of each block begin, and where the last ones end."""
        return np.cumsum([0, *(basis.fields[0].shape[1] for basis in self._bases)])

    def part(self, state: State) -> State:
        return dataclasses.replace(
            state.light, pressure=np.asarray(state.pressure)[self._region.own]
        )

    def whole(self, state: State) -> State:
        pressure = self._region.spread @ np.asarray(state.pressure)
        return dataclasses.replace(
            state, pressure=pressure, linearisation=None, symmetry=NAMES[self.group]
        )

    def along(self, mode: Float[np.ndarray, " f"]) -> Float[np.ndarray, " b"]:
        found = self._projection @ mode
        own = np.argmax(np.add.reduceat(found**2, self._cuts[:-1])) == 0
        return found[: self._cuts[1]] * own

    def factorised(self, state: State) -> State:
        """See `Frame`: every block has a factor of its own."""
        if isinstance(state.factor, BlockFactor):
            return state
        problem, now = linearised(self.problem, state)
        own_bases = bases(self._whole.model.lists, self.group, couplings(problem.model))
        pairs = tangent(problem, state.x, state.pressure, now)
        factors = tuple(factor(basis.pattern, pairs) for basis in own_bases)
        made = BlockFactor(tuple(basis.fields for basis in own_bases), factors)
        return dataclasses.replace(state, factor=made)

    def check(
        self, state: State, modes: Float[np.ndarray, "f m"] | None = None
    ) -> tuple[Stability, State]:
        """See `Frame`: all blocks together are one matrix of their coordinates."""
        state = self.factorised(state)
        blocks = Diagonal(state.factor.factors, self._cuts)
        found = stability_of_factor(
            blocks, self._stiffness, None if modes is None else self._in_all_blocks(modes)
        )
        inside = np.add.reduceat(found.vectors**2, self._cuts[:-1], axis=0)
        # what else a mode has is round-off, or of a mode of another block with the same eigenvalue
        own = np.argmax(inside, axis=0)
        vectors = np.where(
            np.repeat(np.arange(len(self._bases)), np.diff(self._cuts))[:, None] == own,
            found.vectors,
            0.0,
        )
        return Stability(
            state.factor.negative_pivots, found.eigenvalues, self._fields @ vectors
        ), state

    def _in_all_blocks(self, modes):
        """Coordinates (b, w) of the modes (f, m), and of a field in each block without any.

        That block may have the lowest one.
        """
        start = self._projection @ modes
        size = np.add.reduceat(start**2, self._cuts[:-1], axis=0)
        missing = np.flatnonzero((size < ROUND_OFF * size.sum(axis=0)).all(axis=1))
        some = np.zeros((len(start), len(missing)))
        for column, block in enumerate(missing):
            inside = np.arange(self._cuts[block], self._cuts[block + 1])
            some[inside, column] = np.sin(1.0 + np.arange(len(inside)) ** 1.5)
        return np.concatenate([start, some], axis=1)

    def rate(self, state: State) -> Float[np.ndarray, "n 2"]:
        return rate_of_change(
            self.problem, dataclasses.replace(state, factor=state.factor.factors[0])
        )


def group_of_sweep(problem: Problem, symmetry: str) -> tuple[str, ...]:
    """The symmetries that a sweep of a problem uses: those it has, or of a group by its name.

    None for "off", with obstacles, or if a control moves edges or loads. ValueError for a group
    that the problem has not. If its numbers are traced it is taken to have those of its cloud.
    """
    if symmetry == "off":
        return ()
    changes, obstacles = problem.changes, problem.model.cloud.plate.obstacles
    broken = changes.edges or changes.loads or obstacles
    if symmetry == "auto":
        return () if broken else symmetries_of(problem)
    known = symmetries_of if are_places_known(problem) else possible_symmetries
    group, has = GROUPS[symmetry], () if broken else known(problem)
    if not set(group) <= set(has):
        raise Inadmissible(
            f"symmetry: {symmetry!r} is not accepted, plate, gel, loads and control have "
            f"{NAMES.get(has, 'C1')}; give 'auto' or 'off'"
        )
    return group


class Frames:
    """The frames of a problem, one for each group that a state of it may have."""

    def __init__(self, problem: Problem, symmetry: str) -> None:
        self.problem, self.group = problem, group_of_sweep(problem, symmetry)
        self._known: dict[tuple[str, ...], Frame] = {}

    def of(self, group: tuple[str, ...]) -> Frame:
        """The frame of the states with these symmetries."""
        if group not in self._known:
            self._known[group] = (
                RegionFrame(region(self.problem, group), self.problem)
                if group
                else Frame(self.problem)
            )
        return self._known[group]

    def of_state(self, x: Float[Array, "n 2"]) -> Frame:
        """The frame of states next to the nodal positions ``x`` (n, 2)."""
        return self.of(symmetries_of_state(x, self.problem.model, self.group))

    def along_mode(self, state: State, mode: Float[np.ndarray, " f"]) -> Frame:
        """The frame of the branches that leave a whole state along a ``mode`` (f,)."""
        field = scatter(mode, unknowns(self.problem.model.lists))
        return self.of(symmetries_of_field(field, self.problem.model, self.of_state(state.x).group))
