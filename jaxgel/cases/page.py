"""HTML viewer of a path: one self-contained page with a slider."""

import json
from importlib import resources
from pathlib import Path as File
from typing import Any

import numpy as np

from .._types import Array
from ..cloud import Cloud, boundary_edges
from ..continuation import Path
from ..io import load_run, write_atomically
from ..materials import ACCEPTED
from ..observables import (
    FIELDS,
    QUANTITIES,
    Quantity,
    control_quantity,
    deformed_vertices,
    events,
    field_values,
    history,
    is_in_time,
    outlines,
    parameter_values,
)
from .resume import load_path

PAGE = "view.html"
TEMPLATE = "page.html"
RESOLUTION = 5000  # steps per plate width in which the page keeps positions
COLOURS = 64
DECADES = 2.0  # that times span from which on their axis is logarithmic


def write_page(folder: str | File, out: str | File | None = None) -> File:
    """Write the page of a run's ``folder``, to view.html in it or to ``out``; returns the file.

    ValueError for what is no run's folder.
    """
    run, path = load_run(folder), load_path(folder)
    file = File(out) if out else File(folder) / PAGE
    text = page(path, table=run.history, title=run.summary["case"])
    write_atomically(file, lambda stream: stream.write(text.encode()))
    return file


def page(path: Path, *, table: dict[str, Any] | None = None, title: str = "jaxgel") -> str:
    """HTML page of a path: pattern, curves and events at the state of a slider.

    It holds its data and loads nothing from the network. ``table`` saves computing `history` again.
    Transient swelling has the volume ratio as colours, and curves against the logarithm of time if
    its states span more than ``DECADES``.
    """
    data = json.dumps(
        _data(path, history(path) if table is None else table, title),
        separators=(",", ":"),
        allow_nan=False,
    )
    template = resources.files("jaxgel.cases").joinpath(TEMPLATE).read_text(encoding="utf-8")
    return template.replace("@DATA@", data.replace("<", "\\u003c"))


def _data(path: Path, table: dict[str, Any], title: str) -> dict[str, Any]:
    """Data of the page for JSON.

    Positions are whole steps of the plate's width over ``RESOLUTION``.
    """
    from ..plotting import colour_scale  # Matplotlib starts slowly

    cloud = path.model.cloud
    deformed = np.asarray(deformed_vertices(path))
    field = "J" if is_in_time(path) else "stretch"
    values = field_values(path, field)
    low, high = values.min(), values.max()
    shades = np.minimum((values - low) / max(high - low, 1e-12) * COLOURS, COLOURS - 1).astype(int)
    used = deformed[:, np.unique(cloud.triangles)] * (RESOLUTION / cloud.plate.width)
    driven = control_quantity(path.control.name, path.control.unit)
    return {
        "title": title,
        "about": f"{len(cloud.nodes)} nodes, {_parameters(path)}; open dots are unstable states",
        "control": {
            "label": driven.plain_label(),
            "unit": "" if driven.unit == "1" else driven.unit,
        },
        "time": is_in_time(path),
        "logarithmic": is_in_time(path) and _decades(path.value) > DECADES,
        "value": np.asarray(path.value).tolist(),
        "columns": {name: _column(QUANTITIES[name], table, cloud) for name in _viewed(table)},
        "unstable": (np.asarray(table["negative_pivots"]) > 0).tolist(),
        "events": [{"text": event["text"], "state": event["state"]} for event in events(table)],
        "box": [*used.min(axis=(0, 1)).tolist(), *used.max(axis=(0, 1)).tolist()],
        "triangles": np.asarray(cloud.triangles).tolist(),
        "boundary": boundary_edges(np.asarray(cloud.triangles)).tolist(),
        "holes": [_steps(loops, cloud) for loops in outlines(path)],
        "vertices": _steps(deformed, cloud),
        "field": {
            "label": FIELDS[field].replace("$", ""),
            "low": float(low),
            "high": float(high),
            "colours": colour_scale(COLOURS),
            "states": shades.tolist(),
        },
    }


def _decades(times: Array) -> float:
    """Decades between the first time above 0 and the last one."""
    times = np.asarray(times)[np.asarray(times) > 0]
    return float(np.log10(times.max() / times.min())) if len(times) else 0.0


def _viewed(table):
    """Names of the quantities whose curves are shown: those that have a value."""
    own = (
        name
        for name, quantity in QUANTITIES.items()
        if quantity.viewed and quantity.column in table
    )
    return [
        name
        for name in own
        if np.isfinite(np.asarray(table[QUANTITIES[name].column], dtype=float)).any()
    ]


def _column(quantity: Quantity, table: dict[str, Any], cloud: Cloud) -> dict[str, Any]:
    """Label and values of a quantity; a value that is not finite is None."""
    values = quantity.scale * np.asarray(table[quantity.column], dtype=float)
    label = quantity.plain_label(cloud.topology.plate.unit)
    return {
        "label": label,
        "values": [float(value) if np.isfinite(value) else None for value in values],
    }


def _steps(positions: Array, cloud: Cloud) -> list[list[int]]:
    """Positions (k, m, 2) in mm as k flat lists of whole steps."""
    # vertices in holes are nan
    steps = np.nan_to_num(np.asarray(positions)) * (RESOLUTION / cloud.plate.width)
    return np.round(steps).astype(int).reshape(len(positions), -1).tolist()


def _parameters(path):
    """Parameters of the gel in words, without one that is driven, with ranges of fields."""
    ranges = {
        name: (float(values.min()), float(values.max()))
        for name, values in parameter_values(path).items()
    }
    names = [name for name in ACCEPTED if hasattr(path.gel, name) and name != path.control.name]
    texts = {name: f"{low:.3g} to {high:.3g}" for name, (low, high) in ranges.items()}
    return ", ".join(
        f"{name} = {texts.get(name) or format(float(getattr(path.gel, name)), 'g')}"
        for name in names
    )
