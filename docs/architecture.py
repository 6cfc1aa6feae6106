"""Figure of docs/architecture.md: packages, imports, and mu and theta in one step.

    python docs/architecture.py

The grey arrows are read from the source: a package points to those that import from it, without the
arrows that follow from others.
"""  # fmt: skip

import ast
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.patches import FancyBboxPatch

HERE = Path(__file__).parent
PLACES = {  # column and row of each box
    "materials": (0, 2),
    "geometry": (0, 1),
    "linalg": (0, 0),
    "controls": (1, 2),
    "cloud": (1, 1),
    "discretisation": (2, 1),
    "mechanics": (3, 1),
    "symmetry": (4, 0),
    "equilibrium": (4, 1),
    "continuation": (5, 1),
    "transient": (5, 2),
    "bifurcation": (6, 0),
    "waves": (6, 2),
    "observables": (6, 1),
    "verification": (7, 2),
    "io": (8, 0),
    "design": (8, 1),
    "plotting": (8, 2),
    "cases": (9, 1),
    "paper": (10, 1),
    "cli": (10, 0),
}
WIDTH, HEIGHT = 1.16, 0.62
HOLDS = {
    "materials": "what a gel is",
    "geometry": "what a plate is",
    "linalg": "sparse matrices",
    "controls": "what drives\na sweep",
    "cloud": "nodes, cells",
    "discretisation": "shape functions,\nModel",
    "mechanics": "energy, residual,\ntangent, contact",
    "symmetry": "groups, regions,\nblocks",
    "equilibrium": "one state\nat one mu",
    "continuation": "many states,\nstability",
    "transient": "swelling\nin time",
    "bifurcation": "critical points,\nbranches",
    "waves": "waves of a\nperiodic cell",
    "observables": "what is read\noff a path",
    "verification": "error bars,\nresolution",
    "io": "files of a run",
    "design": "inverse design",
    "plotting": "figures",
    "cases": "TOML files",
    "paper": "the paper again",
    "cli": "the command line",
}
WAYS = {  # colour and packages visited, in order
    "mu through one step of a sweep": (
        "#0072b2",
        "continuation equilibrium mechanics linalg equilibrium continuation",
    ),
    "theta from a hole to a number": (
        "#d55e00",
        "geometry cloud discretisation continuation equilibrium observables",
    ),
}


def imports():
    """Package -> set of the packages that it imports from."""
    found = {name: set() for name in PLACES}
    for name in PLACES:
        for file in (HERE.parent / "jaxgel" / name).glob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.level == 2 and node.module:
                    found[name].add(node.module.split(".")[0])
    return {name: (others & set(PLACES)) - {name} for name, others in found.items()}


def reduced(graph):
    """The graph without the edges that follow from others, and without those against the order."""
    order = list(PLACES)
    graph = {
        name: {other for other in others if order.index(other) < order.index(name)}
        for name, others in graph.items()
    }

    def reached(name, seen):
        for other in graph[name] - seen:
            seen.add(other)
            reached(other, seen)
        return seen

    beyond = {
        name: set().union(*(reached(other, set()) for other in others))
        for name, others in graph.items()
    }
    return {name: graph[name] - beyond[name] for name in graph}


def draw(file):
    """Write the figure."""
    mpl.rcParams.update(
        {"svg.hashsalt": "jaxgel", "svg.fonttype": "none", "font.family": "sans-serif"}
    )
    figure, ax = plt.subplots(figsize=(14, 3.8), layout="constrained")
    centre = {name: (1.42 * column, row) for name, (column, row) in PLACES.items()}
    for name, others in reduced(imports()).items():
        for other in others:
            (x0, y0), (x1, y1) = centre[other], centre[name]
            start, end = (x0 + WIDTH / 2, y0), (x1 - WIDTH / 2, y1)
            if x0 == x1:
                half = HEIGHT / 2 if y1 > y0 else -HEIGHT / 2
                start, end = (x0, y0 + half), (x1, y1 - half)
            ax.annotate(
                "",
                end,
                start,
                arrowprops=dict(arrowstyle="-|>", color="0.6", lw=1, shrinkA=0, shrinkB=0),
            )
    for name, (x, y) in centre.items():
        ax.add_patch(
            FancyBboxPatch(
                (x - WIDTH / 2, y - HEIGHT / 2),
                WIDTH,
                HEIGHT,
                boxstyle="round,pad=0,rounding_size=0.06",
                fc="white",
                ec="0.35",
            )
        )
        ax.text(x, y + 0.13, name, ha="center", va="center", fontsize=9.5, weight="bold")
        ax.text(
            x,
            y - 0.12,
            HOLDS[name],
            ha="center",
            va="center",
            fontsize=8,
            color="0.3",
            linespacing=0.95,
        )
    for row, (label, (colour, stops)) in enumerate(WAYS.items()):
        dot = dict(
            ha="center",
            va="center",
            fontsize=7,
            color="white",
            bbox=dict(boxstyle="circle,pad=0.2", fc=colour, ec="none"),
            zorder=4,
        )
        seen = {}
        for number, stop in enumerate(stops.split(), start=1):
            x, y = centre[stop]
            shift = 0.22 * seen.setdefault(stop, 0)
            seen[stop] += 1
            ax.text(
                x - WIDTH / 2 + 0.12 + shift, y + (0.5 - row) * (HEIGHT + 0.02), str(number), **dot
            )
        ax.text(2.6, 2.25 - 0.3 * row, "1", **dot)
        ax.text(2.8, 2.25 - 0.3 * row, label, va="center", fontsize=9)
    ax.set(xlim=(-0.7, 14.9), ylim=(-0.45, 2.45))
    ax.axis("off")
    figure.savefig(file, metadata={"Date": None} if Path(file).suffix == ".svg" else None)
    plt.close(figure)


if __name__ == "__main__":
    mpl.use("Agg")
    draw(HERE / "architecture.svg")
