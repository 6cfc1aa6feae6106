"""A design study: a case file with the sections that say what is varied, what it is judged by, how it is searched and how verified.

Besides the sections of a case (see `cases`), or ``case`` = a built-in name or the path of a case file, a study has

    [[parameters]]   of (a parameter of the holes, Nv or chi), lower, upper; optional: name, holes (list of numbers), link, start
    [[objective]]    of (a quantity, see `objectives.CURVES`) and one of goal = "maximise" or "minimise" with at = mu, target with at,
                     curve = [one value per mu], line = {slope, mu0}; optional: weight; from, to, the window of mu of curve or line
    [[constraints]]  of (a quantity, see `objectives.CURVES` and `objectives.DRY`) and one of above, below, within (magnitude); optional: at
    [search]         method, evaluations, step, tolerance; see `inverse.optimise`
    [verification]   spacing (mm), and mu = [list] where it is not that of the sweep with a value between every two

``link`` says how a value serves several holes, see `parameters`. ``start`` defaults to the first hole's own value.
"""

import dataclasses
import json
from pathlib import Path as File

import jax.numpy as jnp
import numpy as np

from . import cases
from .case_file import case_text, explicit
from .files import write_atomically
from .inverse import DesignProblem, Outcome, optimise, verify
from .loads import Loads
from .messages import did_you_mean
from .objectives import CURVES, DRY, limit, misfit, reading, weighted_sum
from .optimisers import METHODS
from .parameters import all_different, check_keys, entries, gel_of, numbers, parameter, plate_of, study_case, study_table
from .search import read_log

KEYS = {
    "parameters": ("of", "name", "holes", "link", "start", "lower", "upper"),
    "objective": ("of", "goal", "at", "target", "curve", "line", "weight", "from", "to"),
    "constraints": ("of", "above", "below", "within", "at"),
    "search": ("method", "evaluations", "step", "tolerance"),
    "verification": ("spacing", "mu"),
}
VERIFIED = "verified.json"


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """A design problem with its search and verification."""

    name: str
    """The file's name without its ending."""
    case: cases.Case
    """The case that the design starts from."""
    problem: DesignProblem
    """What is varied and judged."""
    search: dict
    """Options of `inverse.optimise`: method, evaluations, step, tolerance."""
    verification: dict
    """Options of `inverse.verify`: spacing, mu."""
    aim: dict
    """First entry of the objective, with ``values`` (k,), its target at every mu (nan where there is none), for the figure."""
    table: dict
    """The study as a table that `study_from_table` reads; JSON can hold it."""

    def run(self, folder=None, *, resume=False, quiet=True):
        """`inverse.Design` of the search, logged in ``folder`` if given; see `inverse.optimise`."""
        record = {"study": self.table, "name": self.name}
        return optimise(self.problem, folder=folder, resume=resume, record=record, quiet=quiet, **self.search)

    def verify(self, parameters):
        """`inverse.verify` of a dict of parameters with the study's spacing: its dict, and the path."""
        return verify(self.problem, parameters, **self.verification)


def load_study(file):
    """The `Study` of a TOML file; ValueError, one line, for a file that cannot be read and for every wrong entry."""
    return study_from_table(*study_table(file))


def resumed_study(folder):
    """The `Study` whose log lies in a folder; ValueError where there is none."""
    record = read_log(folder)["record"]
    if "study" not in record:
        raise ValueError(f"folder: {str(folder)!r} was not written by jaxgel design; resume it where its problem was made")
    return study_from_table(record["study"], str(record.get("name", "design")))


def study_from_table(table, name):
    """The `Study` of a table as described at the top of this module; ValueError names the section and key of a wrong entry."""
    check_keys("study", table, ("case", *cases.SECTIONS, *KEYS))
    case = study_case(table, name)
    if case.loads != Loads():
        raise ValueError("loads: a study takes none; leave the section out")
    if case.sweep.steps == "auto" and case.sweep.mu is None:
        raise ValueError("sweep.steps: 'auto' is not accepted in a study; give a number, or mu = [list]")
    mu = list(case.sweep.values)
    parameters = all_different([_parameter(i, entry, case) for i, entry in enumerate(_entries(table, "parameters", least=1))])
    terms = [_term(i, entry, mu) for i, entry in enumerate(_entries(table, "objective", least=1))]
    alone = len(terms) == 1 and terms[0][0] < 0
    problem = DesignProblem(
        start={p["name"]: p["start"] for p in parameters},
        bounds={p["name"]: (p["lower"], p["upper"]) for p in parameters},
        plate=plate_of(case.plate, parameters),
        gel=gel_of(case.gel, parameters),
        mu=mu,
        objective=weighted_sum([abs(w) for w, _ in terms] if alone else [w for w, _ in terms], [f for _, f in terms]),
        maximise=alone,
        constraints=tuple(_constraint(i, entry, mu) for i, entry in enumerate(_entries(table, "constraints"))),
        options=case.discretisation,
        branch=case.sweep.branch,
    )
    table = {key: table[key] for key in KEYS if key in table} | case.table()
    return Study(name, case, problem, _search(table), _verification(table, case), _aim(table["objective"][0], mu), table)


def run_study(study, folder, *, resume=False, quiet=True):
    """Search, verify on a fresh cloud, and write the folder: design.json (log), best.toml (a case), verified.json and design.png.

    Returns the `inverse.Design` and the content of verified.json: ``start`` and ``best``, each as `inverse.verify` gives it. An
    interrupted search leaves its log alone: None in place of the content.
    """
    from .design_figures import draw_study

    folder = File(folder)
    design = study.run(folder, resume=resume, quiet=quiet)
    if design.outcome is Outcome.INTERRUPTED:
        return design, None
    plate = study.problem.plate({name: jnp.asarray(v) for name, v in design.parameters.items()})
    text = case_text(explicit(_found(study, plate, study.problem.gel_at(design.parameters))))
    write_atomically(folder / "best.toml", lambda stream: stream.write(text.encode()))
    start, start_path = study.verify(study.problem.start)
    best, best_path = study.verify(design.parameters)
    verified = dict(
        study=study.name,
        parameters={name: np.asarray(v).tolist() for name, v in design.parameters.items()},
        search=dict(value=design.value, feasible=design.feasible, outcome=str(design.outcome), evaluations=len(design.history)),
        start=start,
        best=best,
    )
    encoded = json.dumps(verified, indent=1).encode()
    write_atomically(folder / VERIFIED, lambda stream: stream.write(encoded))
    figure = draw_study(study, design, start_path, best_path)
    write_atomically(folder / "design.png", lambda stream: figure.savefig(stream, format="png"))
    return design, verified


def _found(study, plate, gel):
    """The `cases.Case` of a concrete plate and gel, on the cloud of the verification."""
    sweep = dataclasses.replace(study.case.sweep, mu=tuple(study.problem.mu))
    spacing = float(study.verification["spacing"])
    cloud = dataclasses.replace(study.case.discretisation, spacing=spacing, nodes_per_hole=None, across=None)
    return dataclasses.replace(study.case, name="best", plate=plate, gel=gel, sweep=sweep, discretisation=cloud)


# --- entries of the table ----------------------------------------------------------------------------------------------------


def _entries(table, section, least=0):
    return entries(table, section, KEYS[section], least)


def _parameter(i, entry, case):
    """The entry with every default filled in, its start and bounds as arrays."""
    where = f"parameters[{i}]"
    varied = parameter(where, entry, case)
    missing = [key for key in ("lower", "upper") if key not in entry]
    if missing:
        raise ValueError(f"{where}: {missing[0]} is missing; bounds also set a parameter's scale")
    own = varied.pop("own")
    return varied | {key: numbers(f"{where}.{key}", entry.get(key, own), np.shape(own)) for key in ("start", "lower", "upper")}


def _term(i, entry, mu):
    """(weight, function of the path) of an entry of the objective, to be minimised; a negative weight maximises."""
    where, weight = f"objective[{i}]", float(numbers(f"objective[{i}].weight", entry.get("weight", 1.0)))
    if entry["of"] not in CURVES:
        raise ValueError(f"{where}.of: {entry['of']!r} is unknown; {did_you_mean(entry['of'], CURVES)}")
    kinds = [key for key in ("goal", "target", "curve", "line") if key in entry]
    if len(kinds) != 1 or weight <= 0:
        raise ValueError(f"{where}: give one of goal, target, curve and line, and a weight above 0 (found {', '.join(kinds) or 'none'})")
    quantity = CURVES[entry["of"]]
    if kinds[0] in ("curve", "line"):
        return weight, misfit(quantity, mu, _aim(entry, mu, where)["values"])
    value = reading(quantity, _at(where, entry, mu))
    if kinds[0] == "target":
        target = float(numbers(f"{where}.target", entry["target"]))
        return weight, lambda path: (value(path) - target) ** 2
    if entry["goal"] not in ("maximise", "minimise"):
        raise ValueError(f"{where}.goal: {entry['goal']!r} is unknown; {did_you_mean(entry['goal'], ('maximise', 'minimise'))}")
    return (-weight if entry["goal"] == "maximise" else weight), value


def _at(where, entry, mu):
    """The mu of an entry, which must be one of the sweep's."""
    if "at" not in entry:
        raise ValueError(f"{where}: at is missing; give the mu at which the quantity counts")
    at = float(numbers(f"{where}.at", entry["at"]))
    if min(abs(at - m) for m in mu) > 1e-9:
        raise ValueError(f"{where}.at: {at:g} is not one of the sweep's mu ({', '.join(f'{m:g}' for m in mu)})")
    return at


def _aim(entry, mu, where="objective[0]"):
    """The entry with its target at every mu, nan where there is none."""
    at = np.array(mu)
    values = np.full(len(mu), np.nan)
    if "line" in entry:
        if not isinstance(entry["line"], dict) or set(entry["line"]) != {"slope", "mu0"}:
            raise ValueError(f"{where}.line: {entry['line']!r} is not a table {{ slope = ..., mu0 = ... }}")
        slope, mu0 = (numbers(f"{where}.line.{key}", entry["line"][key]) for key in ("slope", "mu0"))
        values = slope * (at - mu0)
    elif "curve" in entry:
        if not isinstance(entry["curve"], list) or len(entry["curve"]) != len(mu):
            raise ValueError(f"{where}.curve: it is not a list of {len(mu)} numbers, one for each mu of the sweep")
        values = numbers(f"{where}.curve", entry["curve"], (len(mu),))
    elif "target" in entry:
        values = np.where(np.abs(at - _at(where, entry, mu)) < 1e-9, numbers(f"{where}.target", entry["target"]), np.nan)
    first, last = (numbers(f"{where}.{key}", entry.get(key, default)) for key, default in (("from", mu[0]), ("to", mu[-1])))
    values = np.where((at >= first - 1e-9) & (at <= last + 1e-9), values, np.nan)
    if ("line" in entry or "curve" in entry) and not np.any(np.isfinite(values)):
        raise ValueError(f"{where}.from, to: no mu of the sweep lies in {first:g} ... {last:g}")
    return dict(entry, values=values)


def _constraint(i, entry, mu):
    where, known = f"constraints[{i}]", (*CURVES, *DRY)
    if entry["of"] not in known:
        raise ValueError(f"{where}.of: {entry['of']!r} is unknown; {did_you_mean(entry['of'], known)}")
    limits = {key: float(numbers(f"{where}.{key}", entry[key])) for key in ("above", "below", "within") if key in entry}
    if len(limits) != 1:
        raise ValueError(f"{where}: give one of above, below and within (found {', '.join(limits) or 'none'})")
    at = _at(where, entry, mu) if "at" in entry else None
    return limit(entry["of"], at=at, **limits)


def _search(table):
    search = dict(method="slsqp", evaluations=60, step=0.2, tolerance=1e-5) | _single(table, "search")
    if search["method"] not in METHODS:
        raise ValueError(f"search.method: {search['method']!r} is unknown; {did_you_mean(search['method'], METHODS)}")
    if type(search["evaluations"]) is not int or search["evaluations"] < 1:
        raise ValueError(f"search.evaluations: {search['evaluations']!r} is not a whole number of at least 1")
    for key, meaning in (("step", "a share of the bounds' range"), ("tolerance", "a share of the objective at the start")):
        if not 0 < numbers(f"search.{key}", search[key]) <= 1:
            raise ValueError(f"search.{key}: {search[key]!r} is not in (0, 1], {meaning}")
    return search


def _verification(table, case):
    """Options of `inverse.verify`; by default half the search's spacing."""
    own = _single(table, "verification")
    plate = case.plate
    spacing = case.discretisation.spacing or plate.spacing or min(plate.width, plate.height) / 40
    given = numbers("verification.spacing", own.get("spacing", spacing / 2))
    if not given > 0:
        raise ValueError(f"verification.spacing: {own['spacing']!r} is not a length in mm")
    mu = own.get("mu")
    if mu is not None:
        mu = numbers("verification.mu", mu, np.shape(mu)).tolist()
    return dict(spacing=float(given), mu=mu)


def _single(table, name):
    section = table.get(name, {})
    if not isinstance(section, dict):
        raise ValueError(f"{name}: {section!r} is not a section; write [{name}]")
    check_keys(name, section, KEYS[name])
    return section
