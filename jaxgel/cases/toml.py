"""Case files as text: every number of a case, with a comment for each."""

import dataclasses
import json

import numpy as np

from .._validation import entry_of
from ..geometry import OBSTACLES, Plate
from .baths import WETTING
from .case import Case, from_table
from .schema import (
    MATERIAL,
    OPTIONS,
    PARAMETERS,
    PLATE,
    WETTED_EDGES,
    WETTED_HOLE,
    field_texts,
    hole_texts,
)

COLUMN = 43  # where comments start
EXAMPLE = {
    "plate": {"width": 22.0, "height": 22.0, "edges": "roller"},
    "holes": [
        {
            "kind": "ellipse",
            "centre": [5.0 * x, 5.0 * y],
            "semi_axes": [5.0, 4.0],
            "angle_deg": 0.0 if x * y > 0 else 90.0,
        }
        for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ],
    "gel": {"Nv": 1e-3, "chi": 1e-4},
}


REGIONS = [
    {"kind": "circle", "centre": [0.0, 0.0], "radius": 1.2, "elastomer": {"Nv": 0.1, "bulk": 10.0}},
    {"kind": "circle", "centre": [0.0, 9.5], "radius": 1.0, "gel": {"Nv": 4e-3}},
]
IN_TIME = {"sweep": {"mu_start": -4.9678}, "time": {"end": 60.0}, "bath": {"mu": -0.9678}}


def example(*, regions: bool = False, in_time: bool = False) -> Case:
    """The `Case` that ``jaxgel init`` writes: four ellipses, as in the paper's sample 1.

    With ``regions`` it has an elastomer in the middle and a stiffer gel at the upper edge, with
    ``in_time`` a bath in which it swells in time; ValueError for both, as elastomers do not swell
    in time.
    """
    if regions and in_time:
        raise ValueError(
            "regions: an elastomer is not covered by swelling in time; leave one of the two out"
        )
    return from_table(
        EXAMPLE | ({"regions": REGIONS} if regions else {}) | (IN_TIME if in_time else {}),
        "example",
    )


def explicit(case: Case) -> Case:
    """The `Case` with its plate and holes written out in its ``source``.

    Its table needs no sample and no moved hole.
    """
    own = {key: getattr(case.plate, key) for key in PLATE}
    defaults = {field.name: field.default for field in dataclasses.fields(case.plate)}
    own["core"] = own["core"] if own["core"] == defaults["core"] else list(own["core"])
    own["axial_stretch"] = None if own["axial_stretch"] is None else float(own["axial_stretch"])
    own["displacement"] = {
        edge: value for edge, value in case.plate.displacement.items() if any(value)
    }
    plate = {key: value for key, value in own.items() if value not in ({}, defaults[key])} | {
        "edges": dict(case.plate.edges)
    }
    plate |= _entries_of(case.source["plate"], WETTING)
    tables = case.source.get("holes", [{}] * len(case.plate.holes))
    holes = [
        _hole(hole) | _entries_of(table, WETTING)
        for hole, table in zip(case.plate.holes, tables, strict=True)
    ]
    tables = case.source.get("regions", [])
    regions = [
        _hole(region) | _entries_of(table, MATERIAL)
        for region, table in zip(case.plate.regions, tables, strict=True)
    ]
    source = {"plate": plate} | {
        key: own for key, own in (("holes", holes), ("regions", regions)) if own
    }
    source |= {key: case.source[key] for key in ("obstacles", "gel") if key in case.source}
    return dataclasses.replace(case, source=source)


def _entries_of(table, names):
    return {name: table[name] for name in names if name in table}


def _hole(hole):
    """The table of a hole, with its angle in degrees if these are short and exact."""
    table = {"kind": type(hole).__name__.lower()} | {
        key: np.asarray(value).tolist() for key, value in hole.theta.items()
    }
    degrees = round(float(np.rad2deg(table.get("angle", np.nan))), 6)
    if np.deg2rad(degrees) != table.get("angle"):
        return table
    return {
        "angle_deg" if key == "angle" else key: degrees if key == "angle" else value
        for key, value in table.items()
    }


def case_text(case: Case) -> str:
    """TOML text of a `Case` with comments on its entries and, as comments, its default options."""
    table = case.table()
    lines = [
        f"# {case.name}: lengths in mm, mu in kT. jaxgel schema lists all that is accepted.",
        "",
    ]
    for section, entries in table.items():
        if section == "obstacles":
            for obstacle in entries:
                lines += [
                    "[[obstacles]]",
                    *_lines(obstacle, field_texts(OBSTACLES[obstacle["kind"]])),
                    "",
                ]
            continue
        if section not in ("holes", "regions"):
            left_out = (
                [] if section == "sweep" and case.time is not None else _left_out(section, entries)
            )
            lines += [f"[{section}]", *_lines(entries, _texts(section)), *left_out, ""]
            continue
        others = {key: rule["description"] for key, rule in (MATERIAL | WETTED_HOLE).items()}
        for outline in entries:
            lines += [f"[[{section}]]", *_lines(outline, hole_texts(outline["kind"]) | others)]
            if section == "holes" and case.time is not None and not _entries_of(outline, WETTING):
                lines += [_commented(f"# {key} =", others[key]) for key in WETTING]
            lines += [""]
    return "\n".join(lines)


def _texts(section):
    """Entry of a section -> what it means, with the words that it may be."""
    if section == "gel":
        return {key: rule["description"] for key, rule in PARAMETERS.items()}
    texts = field_texts(Plate if section == "plate" else OPTIONS[section])
    texts |= {key: rule["description"] for key, rule in WETTED_EDGES.items() if section == "plate"}
    fields = dataclasses.fields(OPTIONS[section]) if section in OPTIONS else ()
    texts |= {entry_of(f): texts[f.name] for f in fields}
    rules = {entry_of(f): f.metadata["schema"] for f in fields}
    return {
        key: f"{text}: {', '.join(rules[key]['enum'])}" if "enum" in rules.get(key, ()) else text
        for key, text in texts.items()
    }


def _lines(entries, texts):
    return [
        _commented(f"{key} = {_value(value)}", texts.get(key, "")) for key, value in entries.items()
    ]


def _left_out(section, entries):
    fields = dataclasses.fields(OPTIONS[section]) if section in OPTIONS else ()
    return [
        _commented(f"# {entry_of(f)} =", _texts(section).get(entry_of(f), ""))
        for f in fields
        if entry_of(f) not in entries
    ]


def _commented(line, text):
    return f"{line:<{COLUMN}} # {text}" if text else line


def _value(value):
    """A TOML value; its strings, numbers and lists are those of JSON."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_value(item)}' for key, item in value.items())} }}"
    return json.dumps(list(value) if isinstance(value, tuple) else value)
