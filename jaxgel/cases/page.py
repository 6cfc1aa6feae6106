"""A path for people to look at: one self-contained HTML page with a slider, and how a path shows itself in a notebook."""

import base64
import html
import io
import json
from importlib import resources
from pathlib import Path as File

import numpy as np

from ..cloud import boundary_edges
from ..io import load_run, write_atomically
from ..observables import FIELDS, deformed_vertices, events, field_values, history, outlines
from .resume import load_path

PAGE = "view.html"
TEMPLATE = "page.html"
RESOLUTION = 5000  # steps per plate width in which the page keeps positions
COLOUR_MAP = "cividis"  # reads the same with every kind of colour vision
COLOURS = 64
COLUMNS = {
    "area_reduction": "area reduction",
    "rotation_deg": "rotation, midline (degrees)",
    "core_rotation_deg": "rotation, core (degrees)",
    "J_mean": "mean volume ratio J",
    "energy": "energy (kT/v mm\u00b2)",
    "lowest_eigenvalue": "lowest eigenvalue",
    "surface_ratio": "surface stretch ratio",
    "min_gap": "smallest gap (mm)",
}
ROWS = 8  # most states in a notebook's table


def write_page(folder, out=None):
    """Write the page of a run's ``folder``, to view.html in it or to ``out``; returns the file. ValueError for what is no run's folder."""
    run, path = load_run(folder), load_path(folder)
    file = File(out) if out else File(folder) / PAGE
    text = page(path, table=run.history, title=run.summary["case"])
    write_atomically(file, lambda stream: stream.write(text.encode()))
    return file


def page(path, *, table=None, title="jaxgel"):
    """The HTML page (str) of a path: pattern, curves and events at the mu of a slider; it holds its data and asks the network for nothing.

    ``table`` saves computing `results.history` again.
    """
    data = json.dumps(_data(path, history(path) if table is None else table, title), separators=(",", ":"), allow_nan=False)
    template = resources.files("jaxgel.cases").joinpath(TEMPLATE).read_text(encoding="utf-8")
    return template.replace("@DATA@", data.replace("<", "\\u003c"))


def _data(path, table, title):
    """What the page shows, as JSON can hold it; positions are whole steps of the plate's width over ``RESOLUTION``."""
    import matplotlib as mpl

    cloud = path.model.cloud
    deformed = np.asarray(deformed_vertices(path))
    values = field_values(path, "stretch")
    low, high = values.min(), values.max()
    shades = np.minimum((values - low) / max(high - low, 1e-12) * COLOURS, COLOURS - 1).astype(int)
    used = deformed[:, np.unique(cloud.triangles)] * (RESOLUTION / cloud.plate.width)
    mu, gel = np.asarray(path.mu), path.gel
    return {
        "title": title,
        "about": f"{len(cloud.nodes)} nodes, Nv = {float(gel.Nv):g}, chi = {float(gel.chi):g}; open dots are unstable states",
        "mu": mu.tolist(),
        "columns": {name: {"label": label, "values": _numbers(table[name])} for name, label in COLUMNS.items()},
        "unstable": (np.asarray(table["negative_pivots"]) > 0).tolist(),
        "events": [{"text": event["text"], "state": int(np.abs(mu - event["mu"]).argmin())} for event in events(table)],
        "box": [*used.min(axis=(0, 1)).tolist(), *used.max(axis=(0, 1)).tolist()],
        "triangles": np.asarray(cloud.triangles).tolist(),
        "boundary": boundary_edges(np.asarray(cloud.triangles)).tolist(),
        "holes": [_steps(loops, cloud) for loops in outlines(path)],
        "vertices": _steps(deformed, cloud),
        "field": {
            "label": FIELDS["stretch"],
            "low": float(low),
            "high": float(high),
            "colours": [mpl.colors.to_hex(mpl.colormaps[COLOUR_MAP](share)) for share in np.linspace(0, 1, COLOURS)],
            "states": shades.tolist(),
        },
    }


def _steps(positions, cloud):
    """Positions (k, m, 2) in mm as k flat lists of whole steps."""
    steps = np.nan_to_num(np.asarray(positions)) * (RESOLUTION / cloud.plate.width)  # vertices in holes have no place
    return np.round(steps).astype(int).reshape(len(positions), -1).tolist()


def _numbers(values):
    """A column as a list in which what is not finite is None."""
    return [float(value) if np.isfinite(value) else None for value in np.asarray(values, dtype=float)]


def notebook_html(path):
    """HTML (str) with the last pattern as a small picture and a table of at most ``ROWS`` states, evenly spread."""
    import matplotlib.pyplot as plt

    from ..plotting import plot_pattern

    figure = plot_pattern(path).figure
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=90)
    plt.close(figure)
    table = history(path)
    names = ("mu", "area_reduction", "rotation_deg", "core_rotation_deg", "J_mean", "negative_pivots")
    states = np.unique(np.linspace(0, len(path) - 1, min(ROWS, len(path))).round().astype(int))
    head = "".join(f"<th>{name}</th>" for name in names)
    rows = "".join("<tr>" + "".join(f"<td>{float(table[name][k]):.5g}</td>" for name in names) + "</tr>" for k in states)
    said = html.escape(f"{len(path)} states, {len(path.model.cloud.nodes)} nodes: {path.stop_text}")
    source = base64.b64encode(picture.getvalue()).decode()
    return (
        f'<div><p>{said}</p><img alt="pattern of the last state" src="data:image/png;base64,{source}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )
