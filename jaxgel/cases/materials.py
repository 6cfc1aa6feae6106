"""Materials of a case's table: its gel, those of its regions, and parameters from pictures."""

import dataclasses
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

from .._validation import did_you_mean
from ..geometry import Plate
from ..io import mask_values
from ..materials import (
    ACCEPTED,
    AnyGel,
    Elastomer,
    Gel,
    PixelField,
    WithHoles,
    check_number,
    named_parameters,
)
from .schema import GELS
from .user_energy import user_gel


def gel_of_table(table: dict[str, Any], plate: Plate, folder: str | File) -> AnyGel:
    """The gel of the section ``gel``, on a plate; its energy is looked for in ``folder``."""
    default = plate.gel or Gel()
    own = {
        key: parameter_value(f"gel.{key}", value, plate)
        for key, value in table.items()
        if key not in ("energy", "kind")
    }
    kind = GELS[table.get("kind", "gel")]
    if kind is not Gel:
        return kind(**own)
    numbers = {"Nv": default.Nv, "chi": default.chi} | own
    return user_gel(table["energy"], numbers, folder) if "energy" in table else Gel(**numbers)


def material_of_region(
    region: dict[str, Any], where: str, gel: AnyGel, plate: Plate
) -> AnyGel | Elastomer:
    """The material of a region."""
    kind = "gel" if "gel" in region else "elastomer"
    own = {
        key: parameter_value(f"{where}.{kind}.{key}", value, plate)
        for key, value in region[kind].items()
    }
    unknown = next((key for key in own if kind == "gel" and not hasattr(gel, key)), None)
    if unknown is not None:
        raise ValueError(
            f"{where}.gel: unknown gel parameter {unknown!r}; "
            f"{did_you_mean(unknown, named_parameters(gel))}"
        )
    return dataclasses.replace(gel, **own) if kind == "gel" else Elastomer(**own)


def parameter_value(where: str, value: Any, plate: Plate) -> float | Callable:
    """A number, or the field of a picture on the dry plate."""
    if not isinstance(value, dict):
        return float(value)
    w, h = plate.width, plate.height
    pixels = mask_values(value, (w, h), where)
    ends = {key: value[key] for key in ("low", "high") if key in value}
    for key, end in [*ends.items()] or [
        ("values", float(pixels.min())),
        ("values", float(pixels.max())),
    ]:
        check_number(f"{where}.{key}", end, *ACCEPTED[where.rpartition(".")[2]])
    field = PixelField(pixels, (-w / 2, w / 2, -h / 2, h / 2), smooth=value.get("smooth", False))
    return WithHoles(field) if value.get("with_holes") else field
