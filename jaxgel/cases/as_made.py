"""What a design keeps of its value as it is made: its objective over samples of uncertain inputs."""

from typing import Any

import numpy as np

from .._validation import Inadmissible
from ..design import DesignProblem, Invalid, check_path
from ..equilibrium import StateNotFound
from .case import Case
from .uncertain import uncertain_inputs, uncertain_samples

SAMPLES = 16


def as_made(problem: DesignProblem, best: Case, entries: dict[str, Any], number: int = SAMPLES) -> dict[str, Any]:
    """Objective of a problem over samples of the ``best`` design with uncertain inputs, ``entries`` as in the section ``uncertainty``.

    A dict of ``samples``, ``mean``, ``deviation``, ``worst`` (None without two valid samples), and ``invalid``, the number of samples that
    have no value, with the ``reason`` of the last one. All samples share the cloud of the best design.
    """
    cloud, values, reason = best.cloud(), [], ""
    study = uncertain_samples(best, uncertain_inputs(best, entries), number)
    for point in study.points:
        try:
            case = study.at(point)
            path = case.path(case.discretisation.model(cloud.at(case.plate)))
            if not path.stop.ok:
                raise Invalid(path.stop_text)
            check_path(path, problem.allow_unstable)
            values.append(float(problem.objective(path)))
        except (Inadmissible, Invalid, StateNotFound) as invalid:
            reason = str(invalid)
    found = np.array(values)
    known = len(found) > 1
    worst = (np.min if problem.maximise else np.max)(found) if known else None
    return dict(
        samples=number,
        mean=float(found.mean()) if known else None,
        deviation=float(found.std(ddof=1)) if known else None,
        worst=None if worst is None else float(worst),
        invalid=number - len(found),
        reason=reason,
    )
