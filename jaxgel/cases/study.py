"""Design studies: a case file with sections for parameters, objectives, search and verification.

Besides the sections of a case (see `cases`), or ``case`` = a built-in name or the path of a case
file, a study has

    [[parameters]]   of (a parameter of the holes, Nv or chi; angle_deg is the angle in degrees),
                     lower, upper; optional: name, holes (list of numbers), link, start
                     or of = "Nv_field" or "chi_field", lower, upper and one of pixels = [r, c],
                     modes = [m, n]; optional: name, start, filter (mm), with_holes, see
                     `parameters`
    [[objective]]    of (a quantity, see `CURVES`) and one of goal = "maximise" or "minimise" with
                     at = mu, target with at, curve = [one value per mu], line = {slope, mu0};
                     optional: weight; from, to, the window of mu of curve or line;
                     or of = "free_edge" with at and outline, the line that the free edges are to
                     follow, [[x, y], ...] in mm or a file, see `io.read_outlines`
                     or of = "fold_up", "fold_down", "loop_width", "onset" or "barrier" (with at)
                     and goal or target; optional: weight
    [[constraints]]  of (a quantity, see `CURVES`, `DRY` and `OF_GEL`) and one of above, below,
                     within (magnitude); optional: at
                     or one of these ``SWITCHES`` and one of above, below, within
    [search]         method, evaluations, step, tolerance, see `optimise`; starts, the number of
                     searches (1), each from other start values within the bounds, and seed (0) by
                     which those are drawn, see `starts`
    [robust]         uncertainty = {semi_axes = "1 %"}, see `uncertain`, weight (1) and samples
                     (16): the objective is the mean over samples of the design as it is made, worse
                     by so many standard deviations, see `Spread`
    [verification]   spacing (mm) of the finest cloud, tolerance (0.01), mu = [list], see `verify`;
                     uncertainty = {semi_axes = "1 %"}, see `uncertain`, and samples (16): the
                     objective of the best design as it is made

An entry with of = "area_reduction" may have ``hole``, its number, and is then that of this hole
alone. ``link`` says how a value serves several holes, see `parameters`. ``start`` defaults to the
first hole's own value. A study takes all of its case, loads and moved edges too, but
``imperfection``, whose load has no derivative; ``steps`` is a number, or mu a list. Under another
control ``at``, ``from``, ``to`` and ``mu`` are its values, which must all be different. Nodal loads
follow the cloud. If the case swells in time, entries have ``at_time`` = t in place of ``at``, or
``time_to`` = value: then the time at which ``of`` first reaches that value has the goal or target,
or is above or below a limit. A design that does not reach it is not valid. The verification is on a
fresh cloud with half the time steps. The switches are of the gel driven from the first value of the
sweep to the last and back: its folds, the width of its loop and the first critical point in the
control's unit, and the barrier (kT/v mm^2) that keeps it in its state on the way up at a value
between these ends.
"""

import dataclasses
from pathlib import Path as File
from typing import Any

import numpy as np

from .._validation import NUMBER, PAIR, POSITIVE, exactly_one, listed, tabled, whole, word
from ..continuation import Path
from ..design import (
    DRY,
    METHODS,
    MOST_DENSE,
    OF_GEL,
    SWITCHES,
    Design,
    DesignField,
    DesignProblem,
    optimise,
    verify,
    weighted_sum,
)
from ..observables import CURVES
from .as_made import ROBUST, VERIFICATION, spread_of, verification_of
from .case import Case
from .objectives import LIMITS, aim_of, constraint, term, with_points
from .parameters import (
    FIELD,
    FIELDS,
    OF,
    PARAMETER,
    VALUE,
    all_different,
    field_parameter,
    gel_of,
    numbers,
    parameter,
    plate_of,
    study_case,
    study_table,
)
from .terms import BARRIER, FREE_EDGE, check_place, switch_of, time_to_of

AIMS = ("goal", "target", "curve", "line", "outline")
BOUND = VALUE | {"$comment": "bounds also set a parameter's scale"}
TIME = NUMBER | {"minimum": 0.0}
SHARE = NUMBER | {"exclusiveMinimum": 0.0, "maximum": 1.0}
OBJECTIVE = {
    "of": word([*CURVES, FREE_EDGE, *SWITCHES]) | OF,
    "hole": whole(0),
    "goal": word(("maximise", "minimise")),
    "target": NUMBER,
    "curve": listed(NUMBER),
    "line": tabled({"slope": NUMBER, "mu0": NUMBER}, ["slope", "mu0"]),
    "outline": {"type": ["array", "string"], "if": {"type": "array"}, "then": listed(PAIR, 2)},
    "at": NUMBER,
    "at_time": TIME,
    "time_to": NUMBER,
    "weight": POSITIVE,
    "from": NUMBER,
    "to": NUMBER,
}
CONSTRAINT = {
    "of": word([*CURVES, *DRY, *OF_GEL, *SWITCHES]) | OF,
    **dict.fromkeys(LIMITS, NUMBER),
    "at": NUMBER,
}
CONSTRAINT |= {"hole": whole(0), "at_time": TIME, "time_to": NUMBER}
SEARCH = {
    "method": word(METHODS),
    "evaluations": whole(1),
    "step": SHARE,
    "tolerance": SHARE,
    "starts": whole(1, 999),
    "seed": whole(0, None),
}
VARIED = {
    "type": "object",
    "if": {"properties": {"of": {"enum": list(FIELDS)}}, "required": ["of"]},
    "then": FIELD,
    "else": tabled(
        PARAMETER | {"start": VALUE, "lower": BOUND, "upper": BOUND}, ["of", "lower", "upper"]
    ),
}
SECTIONS = {
    "parameters": listed(VARIED, least=1),
    "objective": listed(tabled(OBJECTIVE, ["of"]) | exactly_one(AIMS), least=1),
    "constraints": listed(tabled(CONSTRAINT, ["of"]) | exactly_one(LIMITS)),
    "search": tabled(SEARCH) | {"dependentRequired": {"seed": ["starts"]}},
    "robust": ROBUST,
    "verification": tabled(VERIFICATION),
}  # rules of a study's own sections


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """A design problem with its search and verification."""

    name: str
    """The file's name without its ending."""
    case: Case
    """The case that the design starts from."""
    problem: DesignProblem
    """What is varied and judged."""
    search: dict
    """Options of `optimise`: method, evaluations, step, tolerance."""
    starts: int
    """Number of searches, the first from the problem's start."""
    seed: int
    """Of the draw of the others' start values."""
    verification: dict
    """Options of `verify`: spacing, mu, tolerance."""
    aim: dict
    """First entry of the objective, for the figure.

    ``quantity`` is a function of a path or None, ``values`` (k,) its targets at ``control`` (k,),
    mu or times; ``targets`` are those of switches and times, by name; nan if there is no target.
    """
    fields: dict[str, tuple[str, DesignField]]
    """Parameters that are fields: name -> Nv or chi, and how its pixels follow."""
    table: dict
    """The study as a table that `study_from_table` reads; JSON can hold it."""

    def run(
        self, folder: File | str | None = None, *, quiet: bool = True, **options: Any
    ) -> Design:
        """`Design` of the search from the problem's start, logged in ``folder`` if given.

        With ``options`` of `optimise`, such as ``resume``.
        """
        record = {"study": self.table, "name": self.name}
        return optimise(
            self.problem, folder=folder, record=record, quiet=quiet, **self.search, **options
        )

    def verify(self, parameters: dict[str, Any], **options: Any) -> tuple[dict[str, Any], Path]:
        """`verify` of a dict of parameters with the study's options, or others, and the path."""
        return verify(self.problem, parameters, **self.verification | options)


def load_study(file: File | str) -> Study:
    """The `Study` of a TOML file.

    ValueError, one line, for a file that cannot be read and for every wrong entry.
    """
    return study_from_table(*study_table(file))


def study_from_table(table: dict[str, Any], name: str) -> Study:
    """The `Study` of a table as described at the top of this module.

    ValueError names the section and key of a wrong entry.
    """
    case = study_case(table, name, SECTIONS)
    if not case.sweep.given:
        own = "mu" if case.sweep.control == "mu" else "values"
        raise ValueError(
            f"sweep.steps: 'auto' is not accepted in a study; give a number, or {own} = [list]"
        )
    mu = list(case.sweep.values)
    parameters = all_different(
        [_parameter(i, entry, case) for i, entry in enumerate(table["parameters"])]
    )
    table = table | {
        "objective": [
            with_points(f"objective[{i}]", entry) for i, entry in enumerate(table["objective"])
        ]
    }
    judged = [
        (f"{key}[{i}]", entry)
        for key in ("objective", "constraints")
        for i, entry in enumerate(table.get(key, []))
    ]
    for where, entry in judged:
        check_place(where, entry, case)
    switches = {
        where: switch_of(where, entry, case) for where, entry in judged if entry["of"] in SWITCHES
    }
    switches |= {where: time_to_of(entry) for where, entry in judged if "time_to" in entry}
    terms = [
        term(f"objective[{i}]", entry, mu, case.sweep.control, switches)
        for i, entry in enumerate(table["objective"])
    ]
    limits = [
        constraint(f"constraints[{i}]", entry, case.sweep, switches)
        for i, entry in enumerate(table.get("constraints", []))
    ]
    problem = _problem(case, parameters, terms, limits, switches, spread_of(table, case))
    fields = {p["name"]: (p["of"], p["field"]) for p in parameters if "field" in p}
    method = "slsqp" if len(problem.vector) <= MOST_DENSE else "lbfgs"
    search = dict(
        method=method, evaluations=60, step=0.2, tolerance=1e-5, starts=1, seed=0
    ) | table.get("search", {})
    several = {key: search.pop(key) for key in ("starts", "seed")}
    pictured = {
        i: p["start"].tolist()
        for i, p in enumerate(parameters)
        if isinstance(table["parameters"][i].get("start"), dict)
    }
    entries = [
        entry | ({"start": pictured[i]} if i in pictured else {})
        for i, entry in enumerate(table["parameters"])
    ]
    table = (
        {key: table[key] for key in SECTIONS if key in table}
        | {"parameters": entries}
        | case.table()
    )
    verification, aim = (
        verification_of(table, case),
        aim_of(table["objective"][0], mu, case.sweep.control),
    )
    aims = [
        (entry, *switches[f"objective[{i}]"][:1])
        for i, entry in enumerate(table["objective"])
        if f"objective[{i}]" in switches
    ]
    aim["targets"] = {
        name: entry.get("target", np.nan)
        for entry, name in aims
        if (entry["of"] == BARRIER) == (aim["of"] == BARRIER)
    }
    return Study(
        name,
        case,
        problem,
        search,
        verification=verification,
        aim=aim,
        fields=fields,
        table=table,
        **several,
    )


def _problem(case, parameters, terms, limits, switches, spread):
    """The `DesignProblem` of a study with these parameters, terms of the objective and limits."""
    alone = len(terms) == 1 and terms[0][0] < 0
    return DesignProblem(
        start={p["name"]: p["start"] for p in parameters},
        bounds={p["name"]: (p["lower"], p["upper"]) for p in parameters},
        plate=plate_of(case.plate, parameters),
        gel=gel_of(case.gel, parameters),
        mu=list(case.sweep.values),
        objective=weighted_sum(
            [abs(w) for w, _ in terms] if alone else [w for w, _ in terms], [f for _, f in terms]
        ),
        maximise=alone,
        constraints=tuple(limits),
        reported=dict(switches.values()),
        spread=spread,
        options=case.discretisation,
        sweep=case.sweep,
        loads=case.loads,
        time=case.time,
        baths={} if case.time is None else case.baths(),
    )


def _parameter(i, entry, case):
    """The entry with every default filled in, its start and bounds as arrays."""
    where = f"parameters[{i}]"
    if entry["of"] in FIELDS:
        return field_parameter(where, entry, case)
    varied = parameter(where, entry, case)
    own = varied.pop("own")
    return varied | {
        key: numbers(f"{where}.{key}", entry.get(key, own), np.shape(own))
        for key in ("start", "lower", "upper")
    }
