"""A study's case and the parameters that it varies: hole parameters, one value for several holes if need be, and the gel's.

An entry ``[[parameters]]`` has ``of`` (a parameter of the holes, Nv or chi; "angle_deg" is the angle with values in degrees), and
optionally ``name``, ``holes`` (list of numbers) and ``link``, which says how a value serves several holes: "same"; "turned", each hole is
the first one turned about the plate's middle; "mirrored", each is the first one's mirror image in the plate's axes.
"""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._types import Float
from .._validation import TEXT, check, did_you_mean, listed, tabled, whole, word
from ..geometry import Plate
from ..io import read_toml
from ..materials import Gel
from .case import SECTIONS, Case, from_table, load_case

LINKS = ("same", "turned", "mirrored")
GEL = ("Nv", "chi")
OF = TEXT | {"$comment": "it says which quantity is meant"}
PARAMETER = {"of": OF, "name": TEXT, "holes": listed(whole(0), least=1), "link": word(LINKS)}  # rules of what all entries may have
VALUE = {"type": ["number", "array"]}


def study_table(file: File | str) -> tuple[dict, str]:
    """The table of a study's TOML file, and its name; ValueError for a file that cannot be read."""
    file = File(file)
    table = read_toml(file, "study")
    if isinstance(table.get("case"), str) and (file.parent / table["case"]).is_file():
        table["case"] = str(file.parent / table["case"])
    return table, file.stem


def study_case(table: dict, name: str, sections: dict) -> Case:
    """The `Case` of a study's table: its ``case``, changed by the sections of a case that the table has; ValueError for wrong entries.

    ``sections`` are the rules of the study's own sections.
    """
    required = [key for key, rule in sections.items() if "minItems" in rule]
    check(table, tabled({"case": TEXT} | {key: {} for key in SECTIONS} | sections, required), "study")
    changes = {key: value for key, value in table.items() if key in SECTIONS}
    return load_case(table["case"], changes) if "case" in table else from_table(changes, name)


def numbers(where: str, value: Any, shape: tuple = ()) -> Float[np.ndarray, "..."]:
    """``value`` as a float array of ``shape``, a single number filling it; ValueError unless it is finite."""
    try:
        array = np.broadcast_to(np.asarray(value, dtype=float), shape)
    except (TypeError, ValueError, OverflowError):
        array = np.array([np.nan])
    if not np.all(np.isfinite(array)) or isinstance(value, bool):
        raise ValueError(f"{where}: {value!r} is not a finite number" + (f", or {' x '.join(map(str, shape))} of them" if shape else ""))
    return array


def all_different(parameters: list[dict]) -> list[dict]:
    """The list of parameters; ValueError where two have one name, or vary the same quantity."""
    names = [p["name"] for p in parameters]
    if len(set(names)) < len(names):
        raise ValueError(f"parameters: the names {', '.join(names)} are not all different; give each a name of its own")
    varied = [f"{p['of']}{where}" for p in parameters for where in [f" of holes[{k}]" for k in p["holes"]] or [""]]
    twice = next((what for what in varied if varied.count(what) > 1), None)
    if twice is not None:
        raise ValueError(f"parameters: {twice} is varied twice; keep one of the two")
    return parameters


def parameter(where: str, entry: dict, case: Case, others: dict[str, float] | None = None) -> dict:
    """Dict of ``name``, ``of``, ``holes`` (numbers), ``link``, ``degrees`` and ``own``, the case's value, of what an entry varies.

    ``degrees`` says that the values of an angle, ``own`` too, are in degrees. ``others`` maps further parameters, which are not of the
    holes, to the case's values. ValueError for a wrong entry.
    """
    of, holes, others = entry["of"], case.plate.holes, {name: getattr(case.gel, name) for name in GEL} | (others or {})
    known = {name for hole in holes for name in hole.theta} | set(others)
    known = sorted(known | ({"angle_deg"} if "angle" in known else set()))
    if of not in known:
        raise ValueError(f"{where}.of: {of!r} is unknown; {did_you_mean(of, known)}")
    degrees = of == "angle_deg"
    of = "angle" if degrees else of
    if of in others:
        if callable(others[of]):
            raise ValueError(f"{where}.of: {of!r} is a picture in this case and cannot be varied as a number")
        chosen, own = [], float(others[of])
    else:
        chosen = entry.get("holes", [k for k, hole in enumerate(holes) if of in hole.theta])
        if max(chosen) >= len(holes):
            raise ValueError(f"{where}.holes: {chosen!r} is not a list of hole numbers, 0 to {len(holes) - 1}")
        if any(of not in holes[k].theta for k in chosen):
            raise ValueError(f"{where}.holes: not all of {chosen} have the parameter {of!r}")
        own = np.asarray(holes[chosen[0]].theta[of])
        own = np.rad2deg(own) if degrees else own
    link = entry.get("link", "same")
    if of == "vertices" and link != "same":
        raise ValueError(f"{where}.link: {link!r} is not accepted for vertices; give each hole its own parameter")
    return dict(name=entry.get("name", entry["of"]), of=of, holes=chosen, link=link, degrees=degrees, own=own)


def plate_of(plate: Plate, parameters: list[dict]) -> Callable[[dict], Plate]:
    """Function of a dict of parameters: the plate with its holes moved."""
    centres = [np.asarray(hole.theta.get("centre", (0.0, 0.0))) for hole in plate.holes]

    def place(values):
        theta = [dict(hole.theta) for hole in plate.holes]
        moved = [p for p in parameters if p["holes"]]
        for p in moved:
            for k in p["holes"] if p["link"] == "same" else p["holes"][:1]:
                theta[k][p["of"]] = jnp.deg2rad(values[p["name"]]) if p["degrees"] else values[p["name"]]
        for p in moved:
            for k in p["holes"][1:] if p["link"] != "same" else ():
                theta[k][p["of"]] = _image(p["of"], theta[p["holes"][0]], p["link"], centres[p["holes"][0]], centres[k])
        return plate.at(theta)

    return place


def gel_of(gel: Gel, parameters: list[dict]) -> Gel | Callable[[dict], Gel]:
    """The gel, or a function of a dict of parameters where Nv or chi is one."""
    varied = {p["of"]: p["name"] for p in parameters if p["of"] in GEL}
    return (lambda values: dataclasses.replace(gel, **{of: values[name] for of, name in varied.items()})) if varied else gel


def components(parameters: dict[str, Any]) -> dict[str, float]:
    """Name of every component -> its value, of parameters by name: ``centre`` (2,) has the components centre_0 and centre_1."""
    return {name + "".join(f"_{i}" for i in at): float(x) for name, values in parameters.items() for at, x in np.ndenumerate(values)}


def sobol(dimensions: int, number: int, seed: int) -> Float[np.ndarray, "p d"]:
    """The first points (p, d) of a scrambled Sobol sequence in [0, 1); more of them begin with the same."""
    from scipy.stats import qmc  # 0.2 s of every command otherwise

    more = math.ceil(math.log2(number))  # the sequence is balanced at powers of 2
    return qmc.Sobol(dimensions, rng=seed).random_base2(more)[:number]


def _image(of, theta, link, first, other):
    """The parameter ``of`` of a hole with ``theta`` whose centre goes from ``first`` to ``other``, turned or mirrored."""
    if link == "turned":
        turn, mirror = float(np.arctan2(other[1], other[0]) - np.arctan2(first[1], first[0])), np.ones(2)
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
