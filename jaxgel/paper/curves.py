"""Table 1 and Figs. 12 and 13 of Deng et al. (2020): nodes, rotation, lattice.

Counts of nodes, and the rotation of samples 1-3.
"""

from typing import Any

import numpy as np

from ..cases import GRID, sample
from ..materials import free_swelling
from ..observables import (
    CREASE_RATIO,
    area_reduction,
    aspect_ratio,
    core_rotation,
    min_gap,
    rotation_angle,
    surface_ratio,
)
from ..verification import error_bars
from .items import (
    COLOURS,
    FINITE_ELEMENTS,
    Entry,
    Number,
    Runs,
    at,
    crossing,
    or_none,
    pyplot,
    rows,
    unstable_from,
)
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
INTERVALS = (30, 40, 50)  # background intervals per side of the plate
PRINTED_ANGLES = {1: 30.0, 2: 20.0, 3: 18.0}
LATTICE_MU = [
    -4.9678, -3.9678, -3.4678, -3.2, -3.15, -2.9678, -2.4678, -1.9678, -1.4678, -0.9678, -0.6678,
    -0.4678, -0.3678,
]  # fmt: skip
LATTICE_MU += [
    -0.34, -0.3178, -0.3, -0.285, -0.2688, -0.25, -0.24, -0.23, -0.22, -0.21, -0.20, -0.195, -0.19,
    -0.18, -0.1688,
]  # fmt: skip
CENTRE = 12  # the lattice's hole at the origin


def table_1(runs: Runs) -> Entry:
    """Table 1: nodes and Gauss points."""
    figure, axes = pyplot().subplots(
        2, -(-len(PRINTED) // 2), figsize=(7.5, 3.6), layout="constrained", squeeze=False
    )
    table, numbers = [], []
    for ax, (name, printed) in zip(axes.flat, PRINTED.items(), strict=False):
        cloud, plate = runs.cloud(name), sample(name)
        counts = (
            len(cloud.nodes),
            int(np.sum(square_cells(plate, cells_per_side(plate, plate.spacing))[1] > 0)),
        )
        table.append(
            dict(
                case=name,
                nodes_paper=printed[0],
                nodes=counts[0],
                gauss_points_paper=printed[1],
                gauss_points=counts[1],
            )
        )
        numbers += [
            Number(f"{name}, {what}", *pair, digits="d")
            for what, *pair in zip(("nodes", "Gauss points"), counts, printed, strict=True)
        ]
        ax.plot(*np.asarray(cloud.nodes).T, ".", color=COLOURS[0], markersize=0.8)
        ax.set_title(f"{name.replace('-', ' ')}, {counts[0]} nodes", fontsize=7)
        ax.set_aspect("equal")
        ax.tick_params(labelsize=6)
    figure.supxlabel("$x$ (mm)", fontsize=8)
    figure.supylabel("$y$ (mm)", fontsize=8)
    return Entry(
        title="Table 1: nodes and Gauss points of the samples, and of the lattice",
        paper=(
            "Counts of ten plates. (Those of the Gauss points are multiples of 4 by symmetry; the "
            "12114 of sample 7 is a misprint.)"
        ),
        numbers=numbers,
        rows=table,
        figure=figure,
    )


def fig_12(runs: Runs) -> Entry:
    """Fig. 12: rotation of samples 1-3 over mu, with refinement."""
    clouds = {n: [runs.stopping(n, m) for m in INTERVALS] for n in PRINTED_ANGLES}
    paths = [
        (n, path, style)
        for n, of_sample in clouds.items()
        for path, style in zip(of_sample, (":", "--", "-"), strict=True)
    ]
    bars = {
        id(path): error
        for of_sample in clouds.values()
        for path, error in zip(of_sample, _errors(of_sample), strict=True)
    }
    paths += [
        (3, runs.touching(3, m, last), "-.") for m, last in ((INTERVALS[0], -1.1), (GRID, 0.0))
    ]
    reference = FINITE_ELEMENTS["sample-1"]
    known = dict(zip(reference["mu"], reference["rotation"], strict=True))
    figure, ax = pyplot().subplots(figsize=(6.4, 4.0), layout="constrained")
    table, numbers = [], []
    for n, path, style in paths:
        mu, colour = path.mu, COLOURS[n - 1]
        angle, surface = np.asarray(rotation_angle(path)), np.asarray(surface_ratio(path))
        crease = crossing(mu, surface, CREASE_RATIO)
        contact = path.model.contact is not None
        name = f"sample {n}, {path.model.n_nodes} nodes{', contact' * contact}"
        ax.plot(
            mu,
            angle,
            style,
            color="#5c6670" if contact else colour,
            linewidth=1.1,
            label=f"{name}, to mu = {mu[-1]:.2f}",
        )
        ax.plot(crease, np.interp(crease, mu, angle), "o", color=colour, markersize=4)
        table += rows(
            dict(mu=mu, rotation_deg=angle, surface_ratio=surface),
            sample=n,
            contact="on" if contact else "stop",
            nodes=path.model.n_nodes,
        )
        numbers += [
            Number(
                f"{name}: rotation, degrees, mu = -1.9678",
                float(angle[at(path, -1.9678)]),
                reference=known[-1.9678] if n == 1 else None,
                error=bars.get(id(path)),
            ),
            Number(
                f"{name}: mu of the printed {PRINTED_ANGLES[n]:g} degrees",
                or_none(crossing(mu, angle, PRINTED_ANGLES[n])),
            ),
            Number(
                f"{name}: mu of the crease limit",
                or_none(crease),
                None,
                reference["crease_mu"] if n == 1 else None,
            ),
        ]
    marks = dict(markersize=7, label="finite elements, sample 1", zorder=3)
    ax.plot(*zip(*known.items(), strict=True), "k+", **marks)
    for n, printed in PRINTED_ANGLES.items():
        ax.axhline(printed, color=COLOURS[n - 1], linewidth=0.5, alpha=0.6)
    ax.plot(
        [], [], "o", color="#5c6670", markersize=4, label="crease limit; thin lines: printed angles"
    )
    ax.set(
        xlabel=r"chemical potential $\mu$ ($kT$)",
        ylabel="midline rotation (°)",
        xlim=(-5.1, -0.7),
        ylim=(-1, 36),
    )
    ax.legend(fontsize=7, framealpha=0.95, edgecolor="none")  # over the thin lines
    return Entry(
        title=(
            "Fig. 12: rotation of samples 1, 2 and 3 over the chemical potential, each on three "
            "clouds, and the crease limit"
        ),
        paper=(
            "Rotation reaches about 30, 20 and 18 degrees in samples 1, 2, 3; none is visible "
            "before mu = -3.9678."
        ),
        numbers=numbers,
        rows=table,
        figure=figure,
    )


def _errors(paths):
    """Error bars of the rotation at mu = -1.9678 on several clouds, coarsest first, degrees."""
    sizes = np.array([path.model.n_nodes for path in paths]) ** -0.5
    values = np.array([[float(rotation_angle(path)[at(path, -1.9678)])] for path in paths])
    return [float(error_bars(sizes, values, own).error[0]) for own in range(len(paths))]


def fig_13(runs: Runs) -> Entry:
    """Fig. 13: the lattice."""
    stable = runs.path("lattice", LATTICE_MU, branch="stable", contact=True)
    symmetric = runs.path("lattice", LATTICE_MU, contact=False)
    core, reference = np.abs(np.asarray(core_rotation(stable))), FINITE_ELEMENTS["lattice"]
    touches = np.flatnonzero(np.asarray(min_gap(stable)) < float(stable.model.contact.range))
    known = dict(zip(reference["buckled"]["mu"], reference["buckled"]["core"], strict=True))
    flat = at(symmetric, -0.2688)
    numbers = [
        Number(
            f"core rotation of the stable branch, degrees, mu = {stable.mu[k]:.4f}",
            float(core[k]),
            None,
            known.get(float(stable.mu[k])),
        )
        for k in dict.fromkeys(at(stable, mu) for mu in (-1.9678, -0.2688, -0.1688))
    ]
    numbers += [
        Number(
            "symmetric branch unstable from mu",
            unstable_from(symmetric),
            None,
            reference["critical_mu"],
        ),
        Number(
            f"negative eigenvalues of the symmetric branch, mu = {symmetric.mu[flat]:.4f}",
            int(symmetric.negative_pivots[flat]),
            digits="d",
        ),
        Number(
            "first contact, mu",
            float(stable.mu[touches[0]]) if len(touches) else "none",
            None,
            reference["first_contact_mu"],
        ),
        Number(
            "free stretch at mu = -0.1688",
            float(free_swelling(-0.1688, sample("lattice").gel)),
            1.4510,
            digits=".4f",
        ),
    ]
    table = [
        row
        for name, path in (("stable", stable), ("symmetric", symmetric))
        for row in rows(_lattice_columns(path), branch=name)
    ]
    return Entry(
        title=(
            "Fig. 13: the lattice; patterns of the symmetric branch, then of the stable one, and "
            "its core rotation"
        ),
        paper=(
            "Circles become lozenges without rotation from mu = -4.9688 to -0.2688; buckled and "
            "rotated at -0.1688, stretch 1.4510."
        ),
        numbers=numbers,
        rows=table,
        figure=_lattice_figure(stable, symmetric, core),
    )


def _lattice_columns(path):
    return {
        "mu": path.mu,
        "core_rotation_deg": core_rotation(path),
        "aspect_ratio": aspect_ratio(path)[:, CENTRE],
        "area_reduction": area_reduction(path),
        "least_gap": min_gap(path),
        "negative_pivots": path.negative_pivots,
    }


def _lattice_figure(stable: Any, symmetric: Any, core: Any) -> Any:
    from ..plotting import plot_pattern

    figure = pyplot().figure(figsize=(7.2, 4.7), layout="constrained")
    above, below = np.ravel(figure.subfigures(2, 1, height_ratios=(1, 1.1)))
    shown = [(symmetric, -0.2688), (stable, -1.9678), (stable, -0.2688), (stable, -0.1688)]
    for ax, (path, mu) in zip(np.ravel(above.subplots(1, 4)), shown, strict=True):
        k = at(path, mu)
        plot_pattern(path, k, ax=ax, field=None)
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
        ax.set_title(
            f"{'symmetric' if path is symmetric else 'stable'}, " + rf"$\mu = {path.mu[k]:.4f}$",
            fontsize=7.5,
        )
    reference = FINITE_ELEMENTS["lattice"]
    left, right = np.ravel(below.subplots(1, 2))
    area = 100 * np.asarray(area_reduction(stable))
    for part in np.split(
        np.arange(len(stable)), np.flatnonzero(stable.switched & (np.asarray(stable.mu) > -1.0))
    ):
        for ax, values in ((left, core), (right, area)):
            ax.plot(
                -np.asarray(stable.mu)[part],
                values[part],
                "o-",
                color=COLOURS[0],
                markersize=2.5,
                linewidth=1,
            )
    left.plot(
        -np.asarray(symmetric.mu),
        np.abs(core_rotation(symmetric)),
        "--",
        color=COLOURS[2],
        linewidth=1,
        label="symmetric branch",
    )
    left.plot(
        -np.array(reference["buckled"]["mu"]),
        reference["buckled"]["core"],
        "x",
        color=COLOURS[1],
        label="finite elements",
    )
    left.axvline(
        -reference["critical_mu"],
        color=COLOURS[1],
        linewidth=0.7,
        linestyle=":",
        label="their onset of buckling",
    )
    left.legend(frameon=False, fontsize=7, loc="lower right", bbox_to_anchor=(0.92, 0.08))
    for ax, label in ((left, "core rotation (°)"), (right, "area reduction (%)")):
        ax.set(
            xscale="log", xlim=(5.5, 0.15), xlabel=r"chemical potential $\mu$ ($kT$)", ylabel=label
        )
        ax.set_xticks([5, 2, 1, 0.5, 0.2], ["−5", "−2", "−1", "−0.5", "−0.2"])
        ax.minorticks_off()
    return figure
