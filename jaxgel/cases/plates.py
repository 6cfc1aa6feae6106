"""The plate of a case's table: outlines from numbers, drawings and pictures, moved holes."""

import dataclasses
from pathlib import Path as File
from typing import Any

import numpy as np

from ..geometry import KINDS, OBSTACLES, Plate
from ..io import hole_table, hole_tables, mask_table
from .baths import WETTING
from .samples import sample
from .schema import MATERIAL


def outline_tables(
    entries: list[dict[str, Any]], folder: str | File | None, plate: dict[str, Any], section: str
) -> list[dict[str, Any]]:
    """Tables of holes or regions with numbers in place of files; a picture gives several.

    So a run's folder needs no other file.
    """
    tables = []
    for i, entry in enumerate(entries):
        where, others = f"{section}[{i}]", {key: entry[key] for key in WETTING if key in entry}
        others |= {
            key: pixel_tables(entry[key], folder, f"{where}.{key}")
            for key in MATERIAL
            if key in entry
        }
        tables += [own | others for own in _numbers_of(entry, folder, plate, where)]
    return tables


def _numbers_of(entry, folder, plate, where):
    """The tables of the holes that an entry describes."""
    if entry["kind"] not in ("outline", "image"):
        return [entry]
    if folder is None:
        raise ValueError(
            f"{where}.kind: {entry['kind']!r} belongs in a case file; name that file by case = "
            "instead of repeating its holes"
        )
    if entry["kind"] == "outline":
        return [hole_table(entry, folder, where)]
    own = sample(plate["sample"]) if "sample" in plate else None
    return hole_tables(
        entry,
        folder,
        (plate["width"], plate["height"]) if own is None else (own.width, own.height),
        where,
    )


def pixel_tables(table: dict[str, Any], folder: str | File | None, where: str) -> dict[str, Any]:
    """A table with the pixels of its pictures in place of their files."""
    return {
        key: mask_table(own, folder, f"{where}.{key}") if isinstance(own, dict) else own
        for key, own in table.items()
    }


def plate_of_tables(
    table: dict[str, Any], holes: list[dict], regions: list[dict], obstacles: list[dict], name: str
) -> Plate:
    """The `Plate` of the sections ``plate``, ``holes``, ``regions`` and ``obstacles``."""
    inside = [_outline(f"regions[{i}]", region) for i, region in enumerate(regions)]
    outside = [
        OBSTACLES[own["kind"]](**{key: value for key, value in own.items() if key != "kind"})
        for own in obstacles
    ]
    table = {key: value for key, value in table.items() if key not in WETTING} | {
        "obstacles": outside
    }
    if "sample" not in table:
        return Plate(
            **table,
            holes=[_outline(f"holes[{i}]", hole) for i, hole in enumerate(holes)],
            regions=inside,
            name=name,
        )
    return dataclasses.replace(
        sample(table["sample"]),
        regions=inside,
        **{k: value for k, value in table.items() if k != "sample"},
    )


def _outline(where, table):
    try:
        others = {"kind", *MATERIAL, *WETTING}
        return KINDS[table["kind"]](
            **{key: value for key, value in _in_radians(table).items() if key not in others}
        )
    except ValueError as problem:
        raise ValueError(f"{where}: {problem}") from None


def _in_radians(table):
    """The parameters of a hole with ``angle`` in place of ``angle_deg``."""
    if "angle_deg" not in table:
        return table
    return {key: value for key, value in table.items() if key != "angle_deg"} | {
        "angle": np.deg2rad(table["angle_deg"])
    }


def moved_plate(plate: Plate, moved: list[dict[str, Any]]) -> Plate:
    """The plate with the parameters of the section ``moved`` for its holes."""
    try:
        thetas = [
            {name: np.asarray(value, dtype=float) for name, value in _in_radians(theta).items()}
            for theta in moved
        ]
        return plate.at(thetas) if moved else plate
    except (ValueError, TypeError) as problem:
        raise ValueError(f"moved: {problem}") from None
