"""Search for a design: scaled evaluations with gradients, logged, on clouds renewed as holes move.

An evaluation is one sweep; its gradients are reverse passes on that same sweep, taken only when
asked for, one for each weighted sum of objective and constraints. A design is `Invalid` if jaxgel
refuses its plate, cloud or gel (`Inadmissible`), finds no state, or if its states are unstable or
touch themselves; every other error ends the search. An interrupted search repeats its log.
"""

import dataclasses
import functools
import json
import pathlib
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from .._types import Array, Float
from .._validation import Inadmissible
from ..continuation import Path
from ..discretisation import SPENT, cell_sizes
from ..equilibrium import StateNotFound, Status
from ..geometry import check_plate
from ..io import open_folder, read_record, write_atomically
from ..materials import check_gel
from ..mechanics import overlaps
from .lagrangian import Exhausted, Invalid
from .problem import DesignProblem, violation
from .together import Member

LOG = "design.json"
FORMAT = 3  # of the log
FEASIBLE = 1e-4  # violation of a scaled constraint that still counts as met


class Search:
    """Objective and constraints of a problem for an optimiser: limited evaluations, all logged."""

    def __init__(
        self,
        problem: DesignProblem,
        evaluations: int,
        *,
        folder: pathlib.Path | str | None = None,
        name: str = "",
        record: dict | None = None,
        quiet: bool = True,
        member: Member | None = None,
    ) -> None:
        self.member = member  # of searches whose designs are evaluated together
        self.problem, self.evaluations, self.name, self.record = (
            problem,
            evaluations,
            name,
            record or {},
        )
        self.start = problem.vector
        self.log, self.known, self.unit = [], {}, None
        # entries of an interrupted search that have not been asked for again: hidden from the
        # optimiser until then
        self.ahead = []
        self.cloud: object = None  # in use, with its number; so many were made
        self.number, self.clouds = 0, 0
        self.folder = open_folder(folder) if folder is not None else None
        self.live: tuple = (None, None)  # the latest entry of the log with its pullback
        self.bar = tqdm(
            total=evaluations, unit="sweep", disable=True if quiet else None, leave=False
        )
        dry = self._plate(self.start)
        self.dry = [c for c in problem.constraints if c.dry or c.of_gel]
        self.of_path = problem.of_path
        self._dry_parts = [(c, np.size(c.function(dry)) if c.dry else 1) for c in self.dry]

    def first(self) -> None:
        """Evaluate the start; ValueError, one line, if it is no valid design."""
        plate = self._plate(self.start)
        shared = None if self.member is None else self.member.cloud_for(plate)
        self.cloud, self.clouds = shared or self.problem.make_cloud(plate), 1
        try:
            self._sound(self.start)
        except Invalid as reason:
            raise Inadmissible(f"start: the first design is not valid: {reason}") from None

    def settle(self, vector: Float[Array, " d"]) -> "Evaluation":
        """`Evaluation` of a valid design to go on from, on a new cloud if the old one is poor.

        The old cloud stays if the new one cannot be made or the design is not valid on it.
        """
        before = self.cloud, self.number
        try:
            placed, fault = self.problem.options.refreshed(self.cloud, self._plate(vector))
            if fault:
                self.cloud = placed
                self.number, self.clouds = self.clouds, self.clouds + 1
                return self._sound(vector)
        except BaseException as problem:
            self.cloud, self.number = before
            if not isinstance(problem, Invalid | Inadmissible | StateNotFound):
                raise
        return self.at(vector)

    def _sound(self, vector):
        """`Evaluation` of a design whose objective has a gradient, the first on its cloud."""
        here = self.at(vector)
        self.gradients(here.entry, here.vector, np.eye(1 + len(self.of_path))[0])
        return here

    def at(self, vector: Float[Array, " d"]) -> "Evaluation":
        """`Evaluation` of a scaled design (n,).

        Raises `Invalid`, or `Exhausted` once the number of evaluations is used up.
        """
        vector = np.array(vector, dtype=float)
        entry = self.known.get((self.number, vector.tobytes()))
        if entry is None:
            if len(self.log) >= self.evaluations:
                raise Exhausted
            entry = self._evaluate(vector)
        elif entry in self.ahead:
            self.ahead.remove(entry)
            self.log.append(entry)
        self._show(entry)
        if entry["invalid"]:
            raise Invalid(entry["invalid"])
        return Evaluation(self, entry, vector, np.array(entry["values"]))

    def best(self, worth: Callable[[dict], Any] | None = None) -> dict:
        """The valid entry of least ``worth(entry)``, default: violation, then objective.

        Only those of the cloud in use, as values differ from cloud to cloud by the discretisation
        error.
        """
        worth = worth or (
            lambda entry: (max(violation(entry["values"][1:]), FEASIBLE), entry["values"][0])
        )
        return min(
            (entry for entry in self.log if not entry["invalid"] and entry["cloud"] == self.number),
            key=worth,
        )

    def gradients(
        self, entry: dict, vector: Float[Array, " d"], weights: Float[Array, " c"]
    ) -> Float[Array, " d"]:
        """Gradient (n,) of the sum of objective and path constraints with ``weights`` (1 + w,).

        It takes one reverse pass.
        """
        asked = list(map(float, weights))
        for known, row in entry["gradients"]:
            if known == asked:
                return np.array(row)
        if self.live[0] is not entry:
            self.live = entry, self._scaled(self._forward(vector)[1])
        (row,) = self.live[1](jnp.asarray(weights))
        if not np.all(np.isfinite(row)):
            entry.update(invalid="its gradient is not a number", values=None)
            self.write()
            raise Invalid(entry["invalid"])
        entry["gradients"].append([asked, np.asarray(row).tolist()])
        self.write()
        return np.asarray(row)

    def dry_values(self, vector: Float[Array, " d"]) -> Float[Array, " c"]:
        """Scaled values (d,) of the constraints that need no sweep; traceable."""
        parameters = self.problem.parameters(vector)
        plate, gel = self.problem.plate(parameters), self.problem.gel_at(parameters)
        cloud = self.cloud.at(plate) if any(c.of_gel for c in self.dry) else self.cloud
        return jnp.concatenate(
            [jnp.zeros(0), *(c.without_sweep(plate, cloud, gel) / c.scale for c in self.dry)]
        )

    def recall(self) -> None:
        """Take the log of the folder for granted; ValueError unless it is of this problem."""
        log = read_log(self.folder)
        if log["problem"] != self._identity():
            raise ValueError(
                f"folder: {LOG} in {str(self.folder)!r} is of another problem; give another "
                "folder, or do not resume"
            )
        self.ahead, self.unit = log["evaluations"], log["unit"]
        self.known = {
            (entry["cloud"], np.array(entry["vector"]).tobytes()): entry for entry in self.ahead
        }

    def write(self, outcome: str = "running") -> None:
        """The log to disk, whole or not at all."""
        if self.folder is None:
            return
        log = dict(
            format=FORMAT,
            problem=self._identity(),
            record=self.record,
            outcome=str(outcome),
            unit=self.unit,
        )
        log["evaluations"] = [*self.log, *self.ahead]
        encoded = json.dumps(log, allow_nan=False).encode()
        write_atomically(self.folder / LOG, lambda stream: stream.write(encoded))

    def value(self, entry: dict) -> float:
        """Objective of a valid entry in the user's sign and unit."""
        return (-1.0 if self.problem.maximise else 1.0) * self.unit * entry["values"][0]

    def constraints(self, entry: dict) -> dict[str, float]:
        """Name -> smallest value, in its own unit, of each constraint at a valid entry."""
        path_values = entry["values"][1 : 1 + len(self.of_path)]
        values = {c.name: v * c.scale for c, v in zip(self.of_path, path_values, strict=True)}
        position = 1 + len(self.of_path)
        for c, size in self._dry_parts:
            values[c.name] = min(entry["values"][position : position + size]) * c.scale
            position += size
        return values

    def _identity(self):
        bounds = {
            name: [side.tolist() for side in sides] for name, sides in self.problem.bounds.items()
        }
        names = [c.name for c in self.problem.constraints]
        identity = dict(
            method=self.name,
            start=self.start.tolist(),
            bounds=bounds,
            mu=self.problem.mu,
            constraints=names,
        )
        in_time = repr((self.problem.time, self.problem.baths))
        spread = (
            {}
            if self.problem.spread is None
            else {"spread": [self.problem.spread.weight, *self.problem.spread.errors.tolist()]}
        )
        return identity | spread | ({} if self.problem.time is None else dict(time=in_time))

    def _evaluate(self, vector):
        """A new entry of the log."""
        began = time.perf_counter()
        entry = dict(
            vector=vector.tolist(), invalid="", values=None, gradients=[], cloud=self.number
        )
        try:
            values, pullback, entry["reported"] = self._forward(vector)
            self.unit = (abs(float(values[0])) or 1.0) if self.unit is None else self.unit
            entry["values"] = [
                float(values[0]) / self.unit,
                *map(float, values[1:]),
                *map(float, self.dry_values(vector)),
            ]
            self.live = entry, self._scaled(pullback)
        except (Invalid, Inadmissible, StateNotFound) as reason:
            entry["invalid"] = " ".join(str(reason).split())
        entry["seconds"] = round(time.perf_counter() - began, 3)
        self.log.append(entry)
        self.known[self.number, vector.tobytes()] = entry
        self.write()
        return entry

    def _scaled(self, pullback):
        unit = self.unit
        return lambda weights: pullback(weights.at[0].divide(unit))

    def _forward(self, vector):
        """Objective and scaled path constraints (1 + w,), their pullback, and reported numbers.

        An invalid design raises `Invalid`.
        """
        problem = self.problem
        plate = self._plate(vector)
        check_plate(plate)
        check_gel(problem.gel_at(problem.parameters(vector)))
        if not cell_sizes(self.cloud.at(plate))[0] > SPENT:
            raise Invalid("too far from the last design for its cloud")

        if self.member is not None and self.cloud is self.member.together.cloud:
            found = self.member.values(vector)
            if found is not None:
                values, rows = found
                return values, lambda weights: (np.asarray(weights) @ rows,), {}

        def evaluate(vector):
            values, paths, reported = problem.judged(vector, self.cloud)
            return values, (paths, reported)

        values, pullback, (paths, reported) = jax.vjp(evaluate, jnp.asarray(vector), has_aux=True)
        for path in paths:
            check_path(path, problem.allow_unstable)
        reported = {name: float(reported[name]) for name in problem.reported}
        check_reported(reported)
        if not np.all(np.isfinite(values)):
            raise Invalid("its objective or a constraint is not a number")
        return values, pullback, reported

    def _plate(self, vector):
        return self.problem.plate(self.problem.parameters(vector))

    def _show(self, entry):
        self.bar.n = len(self.log)
        if not entry["invalid"]:
            best = self.best()
            self.bar.set_postfix_str(
                f"best {self.value(best):.6g}, violation {violation(best['values'][1:]):.2g}",
                refresh=True,
            )


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """A valid design for an optimiser: all numbers scaled, constraints met if not negative."""

    search: Search
    entry: dict
    vector: np.ndarray
    """(n,) scaled design."""
    values: np.ndarray
    """(1 + c,) objective, constraints on the path, constraints on the dry plate."""

    def gradient(self, weights: Float[Array, " c"]) -> Float[Array, " d"]:
        """Gradient (n,) of ``weights`` (1 + c,) times the values by one reverse pass."""
        first = 1 + len(self.search.of_path)
        slopes = self.search.gradients(self.entry, self.vector, weights[:first])
        return slopes + np.asarray(weights[first:]) @ self._dry_slopes

    def jacobian(self) -> Float[Array, "c d"]:
        """Gradients (1 + c, n) of all values, by one reverse pass for each of them.

        These are the objective and the constraints on the path.
        """
        first = 1 + len(self.search.of_path)
        rows = [self.search.gradients(self.entry, self.vector, row) for row in np.eye(first)]
        return np.concatenate([np.array(rows), self._dry_slopes])

    @functools.cached_property
    def _dry_slopes(self):
        """Gradients (c, n) of the constraints on the dry plate."""
        dry = np.asarray(jax.jacrev(self.search.dry_values)(jnp.asarray(self.vector)))
        return dry.reshape(-1, len(self.vector))


def check_path(path: Path, allow_unstable: bool = False) -> None:
    """Raise `Invalid`, one line, for a path with an invalid state.

    It was not reached, has no derivative, is unstable, or touches itself.
    """
    name = path.control.name
    examined = np.asarray(path.ok) & ~np.isin(
        path.derivative, (Status.NOT_EXAMINED, Status.LOST_STABILITY)
    )
    status = np.where(examined, path.derivative, path.status)
    if np.any(status != Status.CONVERGED):
        k = int(np.argmax(status != Status.CONVERGED))
        lacking = "derivative" if path.ok[k] else "state"
        raise Invalid(
            f"no {lacking} at {name} = {float(path.value[k]):.4f}: {Status(int(status[k])).text}"
        )
    if np.any(np.asarray(path.negative_pivots) > 0) and not allow_unstable:
        k = int(np.argmax(np.asarray(path.negative_pivots) > 0))
        raise Invalid(f"unstable at {name} = {float(path.value[k]):.4f}")
    for value, x in zip(path.value, np.asarray(path.x), strict=True):
        if overlaps(x, path.model):
            raise Invalid(f"self-contact at {name} = {float(value):.4f}")


def check_reported(reported: dict[str, float]) -> None:
    """Raise `Invalid`, in one line, for the first number that a design does not have."""
    missing = next((name for name, value in reported.items() if not np.isfinite(value)), None)
    if missing is not None:
        raise Invalid(f"it has no {missing}")


def read_log(folder: pathlib.Path | str) -> dict[str, Any]:
    """The log of a design's folder as a dict.

    ValueError for a folder without one, or a damaged one.
    """
    file = open_folder(folder) / LOG
    log = read_record(file, FORMAT) or {}
    if not (isinstance(log.get("evaluations"), list) and isinstance(log.get("record"), dict)):
        raise ValueError(
            f"folder: {str(file)!r} is missing, damaged or not written by this version of jaxgel"
        )
    return log
