"""Parameters of a study: those of its holes, also shared by several holes, and of the gel.

An entry ``[[parameters]]`` has ``of`` (a parameter of the holes, Nv or chi; "angle_deg" is the
angle with values in degrees), and optionally ``name``, ``holes`` (list of numbers) and ``link``,
which says how a value serves several holes: "same"; "turned", each hole is the first one turned
about the plate's middle; "mirrored", each is the first one's mirror image in the plate's axes.

In a study ``of`` may be a field of the gel, Nv_field or chi_field, see `design.DesignField`. Such
an entry has ``pixels`` = [rows, columns] that cover the plate, or ``modes`` = [m, n], cosines along
y and x; and optionally ``name``, ``start`` (a number; for pixels also rows of numbers or a grey
picture {file, low, high}, for modes also their coefficients), ``filter`` (mm) and ``with_holes``.
"""

import math
import reprlib
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._types import Float
from .._validation import (
    FLAG,
    NUMBER,
    TEXT,
    check,
    did_you_mean,
    exactly_one,
    listed,
    tabled,
    whole,
    word,
)
from ..design import PIXELS, REACH, DesignField
from ..geometry import Plate
from ..io import MASK, mask_table, mask_values, read_toml
from ..materials import ACCEPTED, AnyGel, Gel, check_gel, matrix_of, with_matrix
from .case import SECTIONS, Case, from_table, load_case

LINKS = ("same", "turned", "mirrored")
GEL = tuple(name for name in ACCEPTED if name != "bulk")  # parameters of gels
FIELDS = {f"{name}_field": name for name in ("Nv", "chi")}
OF = TEXT | {"$comment": "it says which quantity is meant"}
# rules of what all entries may have
PARAMETER = {"of": OF, "name": TEXT, "holes": listed(whole(0), least=1), "link": word(LINKS)}
VALUE = {"type": ["number", "array"]}
COUNTS = listed(whole(1, 1000), 2, 2)
START = {"type": ["number", "array", "object"], "if": {"type": "object"}, "then": MASK}
LENGTH = NUMBER | {"minimum": 0.0}
FIELD = tabled(
    {
        "of": word(FIELDS),
        "name": TEXT,
        "pixels": COUNTS,
        "modes": COUNTS,
        "start": START,
        "lower": VALUE,
        "upper": VALUE,
        "filter": LENGTH,
        "with_holes": FLAG,
    },
    ["of", "lower", "upper"],
) | exactly_one(("pixels", "modes"))  # rule of an entry that varies a field
MOST_COLUMNS = 100  # components of a parameter in a table
SOBOL_DIMENSIONS = 21_201  # of SciPy's Sobol sequences


def study_table(file: File | str) -> tuple[dict, str]:
    """The table of a study's TOML file, and its name; ValueError for a file that cannot be read."""
    file = File(file)
    table = read_toml(file, "study")
    if isinstance(table.get("case"), str) and (file.parent / table["case"]).is_file():
        table["case"] = str(file.parent / table["case"])
    if isinstance(table.get("map"), dict) and isinstance(table["map"].get("points"), str):
        table["map"] = table["map"] | {"points": str(file.parent / table["map"]["points"])}
    entries = [
        entry
        for key in ("parameters", "objective")
        if isinstance(table.get(key), list)
        for entry in table[key]
    ]
    for entry in (entry for entry in entries if isinstance(entry, dict)):
        if isinstance(entry.get("start"), dict) and isinstance(entry["start"].get("file"), str):
            entry["start"]["file"] = str(file.parent / entry["start"]["file"])
        if isinstance(entry.get("outline"), str):
            entry["outline"] = str(file.parent / entry["outline"])
    return table, file.stem


def study_case(table: dict, name: str, sections: dict) -> Case:
    """The `Case` of a study's table: its ``case`` with the table's own sections.

    ValueError for wrong entries. ``sections`` are the rules of the study's own sections.
    """
    required = [key for key, rule in sections.items() if "minItems" in rule]
    check(
        table, tabled({"case": TEXT} | {key: {} for key in SECTIONS} | sections, required), "study"
    )
    changes = {key: value for key, value in table.items() if key in SECTIONS}
    case = load_case(table["case"], changes) if "case" in table else from_table(changes, name)
    if "map" in sections:
        case.check_equilibrium("map")
    return case


def numbers(where: str, value: Any, shape: tuple = ()) -> Float[np.ndarray, "..."]:
    """``value`` as a float array of ``shape``, a single number filling it.

    ValueError, one short line, unless it is finite.
    """
    wanted = "a finite number" + (f", or {' x '.join(map(str, shape))} of them" if shape else "")
    try:
        array = np.broadcast_to(np.array(value, dtype=float), shape)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if not np.all(np.isfinite(array)) or isinstance(value, bool):
        raise ValueError(f"{where}: {reprlib.repr(value)} is not {wanted}")
    return array


def all_different(parameters: list[dict]) -> list[dict]:
    """The list of parameters; ValueError if two have one name, or vary the same quantity."""
    names = [p["name"] for p in parameters]
    if len(set(names)) < len(names):
        raise ValueError(
            f"parameters: the names {', '.join(names)} are not all different; give each a name of "
            "its own"
        )
    varied = [
        f"{p['of']}{where}"
        for p in parameters
        for where in [f" of holes[{k}]" for k in p["holes"]] or [""]
    ]
    twice = next((what for what in varied if varied.count(what) > 1), None)
    if twice is not None:
        raise ValueError(f"parameters: {twice} is varied twice; keep one of the two")
    return parameters


def parameter(where: str, entry: dict, case: Case, others: dict[str, float] | None = None) -> dict:
    """Dict of ``name``, ``of``, ``holes``, ``link``, ``degrees`` and ``own`` of a varied entry.

    ``holes`` are numbers, ``own`` is the case's value. ``degrees`` says that the values of an
    angle, ``own`` too, are in degrees. ``others`` maps further parameters, which are not of the
    holes, to the case's values. ValueError for a wrong entry.
    """
    of, holes, matrix = entry["of"], case.plate.holes, matrix_of(case.gel)
    others = {
        name: getattr(matrix, name)
        for name in GEL
        if hasattr(matrix, name) and name != case.sweep.control
    } | (others or {})
    known = {name for hole in holes for name in hole.theta} | set(others)
    known = sorted(known | ({"angle_deg"} if "angle" in known else set()))
    if of not in known:
        raise ValueError(f"{where}.of: {of!r} is unknown; {did_you_mean(of, known)}")
    degrees = of == "angle_deg"
    of = "angle" if degrees else of
    if of in others:
        if callable(others[of]):
            raise ValueError(
                f"{where}.of: {of!r} is a picture in this case and cannot be varied as a number"
            )
        chosen, own = [], float(others[of])
    else:
        chosen = entry.get("holes", [k for k, hole in enumerate(holes) if of in hole.theta])
        if max(chosen) >= len(holes):
            raise ValueError(
                f"{where}.holes: {chosen!r} is not a list of hole numbers, 0 to {len(holes) - 1}"
            )
        if any(of not in holes[k].theta for k in chosen):
            raise ValueError(f"{where}.holes: not all of {chosen} have the parameter {of!r}")
        own = np.asarray(holes[chosen[0]].theta[of])
        own = np.rad2deg(own) if degrees else own
    link = entry.get("link", "same")
    if of == "vertices" and link != "same":
        raise ValueError(
            f"{where}.link: {link!r} is not accepted for vertices; give each hole its own parameter"
        )
    return dict(
        name=entry.get("name", entry["of"]),
        of=of,
        holes=chosen,
        link=link,
        degrees=degrees,
        own=own,
    )


def field_parameter(where: str, entry: dict, case: Case) -> dict:
    """`parameter` of an entry that varies a field, with ``field``, its `DesignField`.

    The bounds ``start``, ``lower`` and ``upper`` are the parameters' own, as arrays. ValueError for
    a wrong entry.
    """
    of, (w, h) = FIELDS[entry["of"]], (case.plate.width, case.plate.height)
    if not hasattr(matrix_of(case.gel), of) or of == case.sweep.control:
        raise ValueError(
            f"{where}.of: {entry['of']!r} is not accepted, the gel of the case has no {of} that "
            "is not driven"
        )
    pixels = tuple(
        entry.get("pixels", (round(PIXELS * max(1.0, h / w)), round(PIXELS * max(1.0, w / h))))
    )
    modes = tuple(entry["modes"]) if "modes" in entry else None
    if "pixels" in entry:
        mask_values({"values": np.zeros(pixels)}, (w, h), f"{where}.pixels")
    elif np.any(np.array(modes) > pixels):
        raise ValueError(
            f"{where}.modes: {list(modes)} is more than the {pixels[0]} x {pixels[1]} pixels of "
            "the plate"
        )
    lower, upper = (
        numbers(f"{where}.{key}", entry[key], pixels if modes is None else ())
        for key in ("lower", "upper")
    )
    if np.any(lower >= upper):
        raise ValueError(f"{where}.upper: {_short(upper)} is not above lower = {_short(lower)}")
    for key, end in (("lower", lower.min()), ("upper", upper.max())):
        try:
            check_gel(Gel(**{of: float(end)}))
        except ValueError as problem:
            raise ValueError(f"{where}.{key}: {str(problem).partition(': ')[2]}") from None
    options = dict(
        filter=float(entry.get("filter", 0.0)),
        modes=modes,
        with_holes=entry.get("with_holes", False),
    )
    spacing = case.discretisation.spacing or case.plate.spacing or min(w, h) / 40
    # half of it for rounding
    if (
        modes is None
        and min(w / pixels[1], h / pixels[0]) < 0.49 * spacing
        and options["filter"] < spacing
    ):
        raise ValueError(
            f"{where}.filter: {options['filter']:g} leaves pixels of {w / pixels[1]:.3g} mm, "
            "finer than the quadrature points, "
            f"{spacing / 2:.3g} mm apart; give at least the spacing of nodes, {spacing:g}, or "
            "fewer pixels"
        )
    field = DesignField(pixels, (w, h), float(lower.min()), float(upper.max()), **options)
    start = _field_start(
        f"{where}.start", entry.get("start", getattr(matrix_of(case.gel), of)), field
    )
    if modes is not None:
        lower, upper = np.full(modes, -REACH), np.full(modes, REACH)
    if np.any(start < lower) or np.any(start > upper):
        raise ValueError(
            f"{where}.start: {_short(start)} is not between lower = {_short(lower)} and upper = "
            f"{_short(upper)}"
        )
    bounds = dict(start=start, lower=lower, upper=upper)
    return dict(
        name=entry.get("name", entry["of"]),
        of=of,
        holes=[],
        link="same",
        degrees=False,
        field=field,
        **bounds,
    )


def _field_start(where, start, field):
    """The parameters of a `DesignField` at the start."""
    if callable(start):
        raise ValueError(
            f"{where}: it is missing, and the gel of the case is a picture already; give a number "
            "or a picture"
        )
    if isinstance(start, dict):
        if field.modes is not None:
            raise ValueError(f"{where}: a picture is not accepted for modes; give a number")
        start = mask_values(mask_table(start, ".", where), field.size, where).tolist()
    if isinstance(start, float | int):
        if not field.lower <= start <= field.upper and field.modes is not None:
            raise ValueError(
                f"{where}: {start:g} is not between lower = {field.lower:g} and upper = "
                f"{field.upper:g}"
            )
        return field.constant(float(start))
    return numbers(where, start, field.shape)


def _short(array):
    """The numbers of an array in a few characters."""
    least, most = (f"{float(end):g}" for end in (np.min(array), np.max(array)))
    return least if least == most else f"{least} ... {most}"


def plate_of(plate: Plate, parameters: list[dict]) -> Callable[[dict], Plate]:
    """Function of a dict of parameters: the plate with its holes moved."""
    centres = [np.asarray(hole.theta.get("centre", (0.0, 0.0))) for hole in plate.holes]

    def place(values):
        theta = [dict(hole.theta) for hole in plate.holes]
        moved = [p for p in parameters if p["holes"]]
        for p in moved:
            for k in p["holes"] if p["link"] == "same" else p["holes"][:1]:
                theta[k][p["of"]] = (
                    jnp.deg2rad(values[p["name"]]) if p["degrees"] else values[p["name"]]
                )
        for p in moved:
            for k in p["holes"][1:] if p["link"] != "same" else ():
                theta[k][p["of"]] = _image(
                    p["of"], theta[p["holes"][0]], p["link"], centres[p["holes"][0]], centres[k]
                )
        return plate.at(theta)

    return place


def gel_of(gel: AnyGel, parameters: list[dict]) -> AnyGel | Callable[[dict], AnyGel]:
    """The gel, or a function of a dict of parameters if Nv or chi is one, a number or a field.

    That outside the regions.
    """
    varied = [p for p in parameters if p["of"] in GEL]

    def change(values):
        return {
            p["of"]: p["field"].field(values[p["name"]]) if "field" in p else values[p["name"]]
            for p in varied
        }

    return (lambda values: with_matrix(gel, **change(values))) if varied else gel


def components(parameters: dict[str, Any]) -> dict[str, float]:
    """Name of every component -> its value, of parameters by name.

    ``centre`` (2,) has the components centre_0 and centre_1. Parameters of more than
    ``MOST_COLUMNS`` components, fields, are left out.
    """
    shown = {name: values for name, values in parameters.items() if np.size(values) <= MOST_COLUMNS}
    return {
        name + "".join(f"_{i}" for i in at): float(x)
        for name, values in shown.items()
        for at, x in np.ndenumerate(values)
    }


def sobol(dimensions: int, number: int, seed: int) -> Float[np.ndarray, "p d"]:
    """The first points (p, d) of a scrambled Sobol sequence in [0, 1), extensible."""
    from scipy.stats import qmc  # 0.2 s of every command otherwise

    if dimensions > SOBOL_DIMENSIONS:
        raise ValueError(
            f"search.starts: starts are drawn of at most {SOBOL_DIMENSIONS} numbers, not "
            f"{dimensions}; leave it out"
        )
    more = math.ceil(math.log2(number))  # the sequence is balanced at powers of 2
    return qmc.Sobol(dimensions, rng=seed).random_base2(more)[:number]


def _image(of, theta, link, first, other):
    """Parameter ``of`` of a hole with ``theta``, turned or mirrored.

    Its centre goes from ``first`` to ``other``.
    """
    if link == "turned":
        turn, mirror = (
            float(np.arctan2(other[1], other[0]) - np.arctan2(first[1], first[0])),
            np.ones(2),
        )
    else:
        mirror = np.where(np.sign(first) * np.sign(other) < 0, -1.0, 1.0)
        turn, mirror = (np.pi, np.ones(2)) if np.all(mirror < 0) else (0.0, mirror)
    if of == "centre":
        c, s = np.cos(turn), np.sin(turn)
        return jnp.array([[c, -s], [s, c]]) @ (mirror * theta["centre"])
    if of == "angle":
        return (mirror[0] * mirror[1]) * theta["angle"] + turn
    if of in ("cos", "sin"):
        k = np.arange(2, len(theta["cos"]) + 2)
        flip = mirror[0] ** k
        cos, sin = flip * theta["cos"], mirror[1] * mirror[0] * flip * theta["sin"]
        c, s = np.cos(k * turn), np.sin(k * turn)
        return c * cos - s * sin if of == "cos" else s * cos + c * sin
    return theta[of]
