"""Sections ``verification`` and ``robust`` of a study: tolerance of a design to its making."""

from typing import Any

import numpy as np

from .._validation import NUMBER, POSITIVE, Inadmissible, listed, tabled, whole
from ..design import DesignProblem, Invalid, Spread, check_path
from ..equilibrium import StateNotFound
from .case import Case
from .schema import UNCERTAINTY
from .uncertain import made_by, normal_samples, uncertain_inputs, uncertain_samples

SAMPLES = 16
VERIFICATION = {
    "spacing": POSITIVE,
    "tolerance": POSITIVE,
    "mu": listed(NUMBER, least=1),
    "uncertainty": UNCERTAINTY,
    "samples": whole(2, 10_000),
}  # rules of the section
ROBUST = tabled(
    {"uncertainty": UNCERTAINTY, "weight": NUMBER | {"minimum": 0.0}, "samples": whole(2, 1000)},
    ["uncertainty"],
)


def as_made(
    problem: DesignProblem, best: Case, entries: dict[str, Any], number: int = SAMPLES
) -> dict[str, Any]:
    """Objective of a problem over samples of the ``best`` design with uncertain inputs ``entries``.

    These are as in the section ``uncertainty``. A dict of ``samples``, ``mean``, ``deviation``,
    ``worst`` (None without two valid samples), and ``invalid``, the number of samples that have no
    value, with the ``reason`` of the last one. All samples share the cloud of the best design.
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


def verification_of(table: dict[str, Any], case: Case) -> dict[str, Any]:
    """Options of `design.verify` of a study's table.

    Clouds from the search's spacing on, by default to half of it.
    """
    own, plate = table.get("verification", {}), case.plate
    if "mu" in own and case.time is not None:
        raise ValueError(
            "verification.mu: does not go with [time]; the verification has half the time steps"
        )
    if "uncertainty" in own:
        uncertain_inputs(case, own["uncertainty"])  # ValueError for an entry that cannot be used
    spacing = case.discretisation.spacing or plate.spacing or min(plate.width, plate.height) / 40
    finest = float(own.get("spacing", spacing / 2))
    return {"spacing": (spacing, finest) if finest < spacing else finest} | {
        key: own[key] for key in ("mu", "tolerance") if key in own
    }


def spread_of(table: dict[str, Any], case: Case) -> Spread | None:
    """The `design.Spread` of the section ``robust`` of a study's table.

    None without it, ValueError for a wrong entry. Shares, as "1 %", are of the case's own values.
    """
    if "robust" not in table:
        return None
    own = table["robust"]
    inputs = uncertain_inputs(case, own["uncertainty"])
    return Spread(
        made_by(inputs),
        normal_samples(inputs, own.get("samples", SAMPLES)),
        float(own.get("weight", 1.0)),
    )
