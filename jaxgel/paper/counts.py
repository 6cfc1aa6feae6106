"""Table 1 of Deng et al. (2020): nodes and Gauss points of the nine samples, and of the lattice."""

from typing import Any

import numpy as np

from ..cases import sample
from .items import COLOURS, CONDITION, CONFIRMED, CONTRADICTED, Claim, Entry, Number, Runs, pyplot
from .scheme import cells_per_side, square_cells

# printed nodes and Gauss points; the last is section 5.5
PRINTED = {
    "sample-1": (1009, 12284),
    "sample-2": (1213, 15600),
    "sample-3": (1417, 18936),
    "sample-4": (989, 12312),
    "sample-5": (1225, 15624),
    "sample-6": (1437, 18956),
    "sample-7": (941, 12114),
    "sample-8": (1165, 15196),
    "sample-9": (1441, 18876),
    "lattice": (840, 2304),
}


def table_1(runs: Runs) -> Entry:
    """Table 1: nodes and Gauss points."""
    table = []
    for name, (nodes, points) in PRINTED.items():
        plate = sample(name)
        gauss = int(np.sum(square_cells(plate, cells_per_side(plate, plate.spacing))[1] > 0))
        ours = len(runs.cloud(name).nodes)
        table.append({"case": name, "nodes_paper": nodes, "nodes": ours, "gauss_points_paper": points, "gauss_points": gauss})
    off = [r for r in table if (r["nodes"], r["gauss_points"]) != (r["nodes_paper"], r["gauss_points_paper"])]
    misprint = all(r["nodes"] == r["nodes_paper"] and r["gauss_points_paper"] % 4 and not r["gauss_points"] % 4 for r in off)
    verdict = CONFIRMED if not off else CONDITION if misprint else CONTRADICTED
    reason = f"{len(table) - len(off)} of {len(table)} pairs of counts agree to the digit"
    reason += "; these symmetries give a multiple of 4 points, which the other printed number is not." if off and misprint else "."
    numbers = [
        Number(f"{r['case']}, {text}", r[key], r[f"{key}_paper"], digits="d")
        for r in table
        for key, text in (("nodes", "nodes"), ("gauss_points", "Gauss points"))
    ]
    return Entry(
        title="Table 1: nodes and Gauss points of the samples, and of the lattice",
        paper="Counts of ten plates.",
        numbers=tuple(numbers),
        verdict=verdict + (": one printed number is a misprint." if misprint and off else "."),
        rows=table,
        claims=(Claim("The numbers of nodes and Gauss points of Table 1", verdict, reason),),
        figure=_cloud_figure({row["case"]: runs.cloud(row["case"]) for row in table}),
    )


def _cloud_figure(clouds: Any) -> Any:
    """The nodes of each cloud, with their number."""
    figure, axes = pyplot().subplots(2, -(-len(clouds) // 2), figsize=(7.5, 3.6), layout="constrained")
    for ax in axes.flat[len(clouds) :]:
        ax.remove()
    for ax, (name, cloud) in zip(axes.flat, clouds.items(), strict=False):
        ax.plot(*np.asarray(cloud.nodes).T, ".", color=COLOURS[0], markersize=0.8)
        ax.set_title(f"{name.replace('-', ' ')}, {len(cloud.nodes)} nodes", fontsize=7)
        ax.set_aspect("equal")
        ax.tick_params(labelsize=6)
    figure.supxlabel("$x$ (mm)", fontsize=8)
    figure.supylabel("$y$ (mm)", fontsize=8)
    return figure
