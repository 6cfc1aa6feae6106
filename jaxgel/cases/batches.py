"""Points of a map in batches, each swept by one compiled program on the devices of JAX.

The program makes model and problem of each point on the cloud of the study's own plate, sweeps it
and, if asked, differentiates its last state. It serves points that this cloud can carry, see
`continuation.Batched`: all others are left to the host's sweep.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Float
from ..bifurcation import sweep_by_options
from ..cloud import Cloud
from ..continuation import (
    GROUPS,
    SCALARS,
    Batched,
    Device,
    Path,
    check_for_batches,
    columns_of,
    group_of_sweep,
)
from ..equilibrium import Status
from ..geometry import check_plate
from ..mechanics import Problem
from ..observables import QUANTITIES, is_flat
from .case import Case
from .parameter_map import MapStudy
from .response import RESPONSES, problem_at


@dataclasses.dataclass(frozen=True, eq=False)
class BatchPoint:
    """A point that a compiled program has swept to its end."""

    case: Case
    """The case of the point."""
    path: Path
    """Its states."""
    jacobian: Float[np.ndarray, "r d"] | None
    """Derivatives of ``RESPONSES`` at the last state; None if not asked for, or not all numbers."""


class Batches:
    """The compiled program of a study's points; ValueError for a sweep that it cannot follow."""

    def __init__(self, study: MapStudy, cloud: Cloud, devices: list[Device]) -> None:
        check_for_batches(study.case.sweep)
        self.study, self.cloud = study, cloud
        self._model = study.case.discretisation.model(cloud)
        problem = study.case.problem(self._model).prepared
        self.program = Batched(self._sheet, problem, devices)
        self._names = _known(problem) if study.gradients else []

    def swept(self, points: dict[int, dict]) -> Iterator[dict[int, BatchPoint | None]]:
        """The points, number -> values, batch after batch; None if the host has to sweep one.

        A point that cannot be, or whose plate needs a cloud of its own, is in no batch.
        """
        ready = {}
        for number, values in points.items():
            ready[number] = self._placed(values)
            if len(ready) == self.program.size:
                yield self._batch(points, ready)
                ready = {}
        if ready:
            yield self._batch(points, ready)

    def _placed(self, values):
        """Case, problem and symmetries of a point; None if the host has to look at it."""
        try:
            case = self.study.at(values)
            cloud, options = self.cloud, case.discretisation
            if case.plate.reference is not None:
                check_plate(case.plate)
                if not options.carries(cloud, case.plate):
                    return None
                cloud = cloud.at(case.plate)
            problem = case.problem(options.model(cloud))
            return case, problem, group_of_sweep(problem, case.sweep.symmetry)
        except (ValueError, ArithmeticError):
            return None  # the host says why

    def _batch(self, points, ready):
        """The results of one batch, by number."""
        found: dict[int, BatchPoint | None] = dict.fromkeys(ready)
        numbers = [number for number, one in ready.items() if one is not None]
        if not numbers:
            return found
        given = {
            name: np.stack([np.asarray(points[number][name], dtype=float) for number in numbers])
            for name in points[numbers[0]]
        }
        values = np.stack([ready[number][0].sweep.numbers for number in numbers])
        groups = [ready[number][2] for number in numbers]
        common = tuple(name for name in groups[0] if all(name in group for group in groups))
        columns, rows = self.program(common, given, values)
        for k, number in enumerate(numbers):
            if np.all(columns["status"][k] == Status.CONVERGED):
                case, problem, _ = ready[number]
                path = _path(problem, {name: column[k] for name, column in columns.items()})
                found[number] = BatchPoint(case, path, self._jacobian(path, rows[k]))
        return found

    def _sheet(self, symmetry, point, values):
        """The columns of a point's path, and the derivatives (r, d) of its last state."""
        study = self.study
        options = dataclasses.replace(study.case.sweep, symmetry=symmetry)

        def last(point):
            problem = problem_at(study, point, self._model)
            path = sweep_by_options(problem, options, values=values)
            return [QUANTITIES[name].function(path)[-1] for name in self._names], columns_of(path)

        if not self._names:
            return last(point)[1], jnp.zeros((0, 0))
        found, pullback, columns = jax.vjp(last, point, has_aux=True)
        (slopes,) = jax.vmap(pullback)(list(jnp.eye(len(found))))
        # of the study's order, which a dict loses in a program
        rows = [slopes[p["name"]].reshape(len(found), -1) for p in study.parameters]
        return columns, jnp.concatenate(rows, axis=1)

    def _jacobian(self, path, rows):
        """Derivatives (r, d), nan of a quantity without values.

        None if they are not all numbers, or a midline is level.
        """
        known = self._names and np.all(np.isfinite(rows))
        if not known or is_flat(path.x[-1:], path.model)[0]:
            return None
        found = dict(zip(self._names, rows, strict=True))
        return np.array([found.get(name, np.full(rows.shape[1], np.nan)) for name in RESPONSES])


def _path(problem: Problem, columns: dict[str, Any]) -> Path:
    """The `Path` of a sheet whose sweep has reached its end."""
    count, symmetry = len(columns["x"]), tuple(GROUPS[k] for k in columns["symmetry"])
    return Path(
        problem=problem.replace(operators=None),
        derivative=np.full(count, int(Status.NOT_EXAMINED)),
        stop_text=Status.CONVERGED.text,
        **(columns | {"symmetry": symmetry}),
    )


def _known(problem: Problem) -> list[str]:
    """Those of ``RESPONSES`` that have values on the cloud of a ``problem``."""
    x = 1.1 * np.asarray(problem.model.nodes) @ np.array([[1.0, 0.1], [-0.1, 1.0]])
    columns = {name: np.zeros(1, int) for name in (*SCALARS, "symmetry")}
    path = _path(problem, columns | {"x": x[None], "pressure": np.zeros((1, problem.lengths["g"]))})
    return [name for name in RESPONSES if np.isfinite(QUANTITIES[name].of(path)[-1])]
