"""A path in a notebook: the last pattern and a small table."""

import base64
import dataclasses
import html
import io

import matplotlib.pyplot as plt
import numpy as np

from ..continuation import Path
from ..observables import QUANTITIES, history
from .patterns import plot_pattern
from .style import quantity_of

ROWS = 8  # most states in the table
SHOWN = ("area_reduction", "rotation", "core_rotation", "J_mean", "negative_pivots")


@dataclasses.dataclass(frozen=True)
class PathView:
    """A path that a notebook shows as a picture with a table."""

    path: Path
    """The path."""

    def _repr_html_(self) -> str:
        path, table = self.path, history(self.path)
        quantities = [quantity_of(path.control), *(QUANTITIES[name] for name in SHOWN)]
        states = np.unique(np.linspace(0, len(path) - 1, min(ROWS, len(path))).round().astype(int))
        head = "".join(f"<th>{quantity.plain_label(path.model.cloud.topology.plate.unit)}</th>" for quantity in quantities)
        rows = ["".join(f"<td>{quantity.shown(table[quantity.column][k])}</td>" for quantity in quantities) for k in states]
        caption = html.escape(f"{len(path)} states, {path.model.n_nodes} nodes: {path.stop_text}")
        return (
            f'<div><p>{caption}</p><img alt="pattern of the last state" src="data:image/png;base64,{_picture(path)}">'
            f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(f'<tr>{row}</tr>' for row in rows)}</tbody></table></div>"
        )


def show_path(path: Path) -> PathView:
    """What a notebook shows of a path: the pattern of the last state, and a table of at most ``ROWS`` states, evenly spaced."""
    return PathView(path)


def _picture(path: Path) -> str:
    """The pattern of the last state as PNG in base64."""
    figure = plot_pattern(path).figure
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=90)
    plt.close(figure)
    return base64.b64encode(stream.getvalue()).decode()
