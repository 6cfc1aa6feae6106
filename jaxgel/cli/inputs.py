"""What a command is given, checked against the schema at once; what needs geometry is checked by the packages later."""

import itertools
import math
from argparse import Namespace
from pathlib import Path

from .._validation import check, did_you_mean, read_toml, with_changes
from .generated import default, schema
from .starting import sample_names

OPTIONS = {
    "sweep": (
        *("control", "mu_start", "mu_end", "from", "to", "back", "values", "at_mu", "direction"),
        *("steps", "branch", "imperfection", "contact", "eigenvalues"),
    ),
    "discretisation": ("spacing", "nodes_per_hole", "across", "basis", "dmax", "solver"),
}  # sections of a case file and their entries that are options of commands
RUN, DESIGN, STARTS, MAP = "summary.json", "design.json", "starts.json", "map.json"
COUNTS = {"divisions": 64, "most": 100, "states": 1000, "workers": 1024}
"""Options that are no entries of a case -> most that is accepted."""


def check_inputs(args: Namespace) -> None:
    """Raise ValueError, one line, for a case, study or folder that is not there, and for a case that breaks the schema."""
    for name, value in ((name, getattr(args, name, None)) for name in COUNTS):
        if value is not None and not 1 <= value <= COUNTS[name]:
            raise ValueError(f"{name}: {value} is not accepted, it must be at least 1 and at most {COUNTS[name]}")
    if "case" in args:
        check_case(case_table(args.case), changes(args))
    elif "study" in args:
        _check_study(Path(args.study))
    elif "source" in args:
        _check_outline(args)
    elif "folder" in args:
        _check_folder(args)


def changes(args: Namespace) -> dict:
    """Sections and entries of a case that the options replace."""
    given = vars(args)
    changed = {section: {key: given[key] for key in keys if given.get(key) is not None} for section, keys in OPTIONS.items()}
    return changed | ({"output": {"figures": False, "animation": False}} if given.get("no_plots") else {})


def case_table(case: str) -> dict:
    """The table of a case, a built-in name or the path of a TOML file; ValueError for neither."""
    file = Path(case)
    if file.suffix == ".toml" or file.is_file():
        return read_toml(file, "case")
    if case not in sample_names():
        raise ValueError(f"case: unknown name {case!r}; {did_you_mean(case, sample_names())}")
    return {"plate": {"sample": case}}


def check_case(table: dict, changed: dict) -> None:
    """Raise ValueError for a case's table that breaks the schema with some sections changed, and for a value of mu that is repeated."""
    table = with_changes(table, changed)
    check(table, schema(), "case file")
    sweep = table.get("sweep", {})
    if sweep.get("control", "mu") != "mu":
        return  # its values are checked with the gel
    mu = sweep.get("mu") or [sweep.get(key, default("sweep", key)) for key in ("mu_start", "mu_end")]
    for first, second in itertools.pairwise(mu):
        if first == second:
            raise ValueError(f"mu: {first:g} is followed by {second:g}, the values must differ from one to the next")


def _check_study(file):
    """The sections of a case that a study or map has, and the case that it names."""
    table = read_toml(file, "study")
    case, sections = table.get("case"), schema()["properties"]
    changed = {key: value for key, value in table.items() if key in sections}
    if isinstance(case, str):
        check_case(case_table(str(file.parent / case) if (file.parent / case).is_file() else case), changed)
    elif case is None and "plate" in table:
        check_case(changed, {})


def _check_outline(args):
    if not (math.isfinite(args.height) and args.height > 0):
        raise ValueError(f"--height: {args.height:g} is not a height in mm above 0")
    if args.pixels_per_mm is not None and not (math.isfinite(args.pixels_per_mm) and args.pixels_per_mm > 0):
        raise ValueError(f"--pixels-per-mm: {args.pixels_per_mm:g} is not a number of pixels above 0")
    if args.mu is not None and not math.isfinite(args.mu):
        raise ValueError(f"--mu/--at: {args.mu:g} is not a finite number")
    if Path(args.source).is_dir():
        _has_run(args.source)
    elif args.mu is not None:
        raise ValueError(f"--mu/--at: {args.source!r} is a case; the states at some mu are in a run's folder")
    else:
        table = case_table(args.source)
        check_case(table, {})
        _check_inputs_kept(args, table)


def _check_inputs_kept(args, table):
    """Refuse an outline or mask that would take the place of a picture or drawing that the case reads."""
    source, gel = Path(args.source), table.get("gel", {})
    regions = [entry for region in table.get("regions", []) for entry in (region, *(_table(part) for part in region.values()))]
    regions += [entry for part in regions for entry in part.values()]
    entries = map(_table, (*table.get("holes", []), *regions, *gel.values()))
    read = {(source.parent / entry["file"]).resolve() for entry in entries if "file" in entry}
    file = Path(args.out or f"{source.stem}.{args.format}")
    for written in (file, *(file.with_name(f"{file.stem}-{name}.png") for name, entry in gel.items() if _table(entry))):
        if written.resolve() in read:
            raise ValueError(f"--out: {str(written)!r} is a file that the case reads; give another name")


def _table(entry):
    return entry if isinstance(entry, dict) else {}


def _check_folder(args):
    if getattr(args, "resumes", False):
        kind_of_folder(args.folder)
    else:
        _has_run(args.folder)


def kind_of_folder(folder: str) -> str:
    """The file that says which command a folder is of: ``DESIGN``, ``STARTS``, ``MAP`` or ``RUN``; ValueError for none of them."""
    known = (DESIGN, STARTS, MAP, RUN)
    for name in known:
        if (Path(folder) / name).is_file():
            return name
    raise ValueError(f"folder: {folder!r} holds none of {', '.join(known)}; expected a folder written by jaxgel run, design or map")


def _has_run(folder):
    if not (Path(folder) / RUN).is_file():
        raise ValueError(f"folder: {folder!r} holds no {RUN}; expected a folder written by jaxgel run")
