"""Fig. 14 of Deng et al. (2020): area reduction of the holes of samples 1-9."""

import numpy as np

from ..cases import sample
from ..observables import area_reduction, free_stretch, min_gap
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
)

PRINTED_AREAS = {4: 60.0, 7: 77.0}  # per cent
FAMILIES = {"ellipses": (1, 2, 3), "circles": (4, 5, 6), "squares": (7, 8, 9)}


def fig_14(runs: Runs) -> Entry:
    """Fig. 14: area reduction against stretch, and against the initial area."""
    paths = {n: runs.stopping(n) for n in range(1, 10)}
    area = {n: sum(float(hole.area()) for hole in sample(f"sample-{n}").holes) / 4 for n in paths}
    shared = min(float(path.mu[-1]) for path in paths.values())
    reference = FINITE_ELEMENTS["areas"]
    figure, (left, right) = pyplot().subplots(1, 2, figsize=(7.2, 3.8), layout="constrained")
    table, numbers, of_all = [], [], {}
    for (name, family), colour, marker in zip(FAMILIES.items(), COLOURS, "osD", strict=False):
        for n, style in zip(family, ("-", "--", ":"), strict=True):
            path, stretch = paths[n], free_stretch(paths[n])
            reduction = 100 * np.asarray(area_reduction(path))
            of_all[n] = reduction[at(path, shared)], reduction[-1]
            left.plot(stretch, reduction, style, color=colour, linewidth=1.1, label=f"sample {n}")
            left.plot(stretch[-1], reduction[-1], marker, color=colour, markersize=4)
            table += _area_rows(path, n)
            known = (
                reference["area"].get(f"{area[n] / np.pi:.0f}")
                if name == "circles" and shared in reference["mu"]
                else None
            )
            known = None if known is None else 100 * np.interp(shared, reference["mu"], known)
            numbers += [
                Number(
                    f"sample {n}, mu = {shared:.4f}: area reduction, %", of_all[n][0], None, known
                ),
                Number(
                    f"sample {n}, end without contact, mu = {path.mu[-1]:.4f}: area reduction, %",
                    of_all[n][1],
                ),
            ]
        sizes = np.array([area[n] / np.pi for n in family])
        shift = 0.25 * (list(FAMILIES).index(name) - 1)  # equal areas would hide each other
        right.plot(
            sizes + shift,
            [of_all[n][0] for n in family],
            marker + "-",
            color=colour,
            markersize=5,
            label=name,
        )
        right.plot(
            sizes,
            [of_all[n][1] for n in family],
            marker + "--",
            color=colour,
            markersize=5,
            markerfacecolor="none",
        )
    for n, printed in PRINTED_AREAS.items():
        path = runs.touching(n)
        reduction = 100 * np.asarray(area_reduction(path))
        left.plot(
            free_stretch(path),
            reduction,
            color="#5c6670",
            linewidth=0.6,
            zorder=0,
            label=f"sample {n}, contact",
        )
        right.plot(
            area[n] / np.pi, printed, "*", color="black", markersize=9, label=f"printed, sample {n}"
        )
        table += _area_rows(path, n)
        numbers += [
            Number(
                f"sample {n}, with contact, mu = {path.mu[-1]:.4f}: area reduction, %",
                float(reduction[-1]),
                printed,
            ),
            Number(
                f"sample {n}, with contact: mu of the printed {printed:.0f} %",
                or_none(crossing(path.mu, reduction, printed)),
            ),
        ]
    _label(left, right, shared)
    return Entry(
        title=(
            "Fig. 14: area reduction of the holes, (a) against the free stretch, (b) against the "
            "initial area"
        ),
        paper=(
            "77 % for sample 7, 60 % for sample 4, least for sample 1; smaller holes lose more if "
            "elliptical, less if circular or square."
        ),
        numbers=numbers,
        rows=table,
        figure=figure,
    )


def _label(left, right, shared):
    """Titles, labels and legends of the two axes, whose values are at mu = ``shared``, kT."""
    left.set(
        title="(a)", xlabel=r"free-swelling stretch $\lambda_\mu$", ylabel="area reduction (%)"
    )
    title = rf"(b) full at $\mu = {shared:.4f}$, open at the ends"
    right.set_title(title, fontsize=9)
    right.set(
        xlabel=r"initial area of a hole ($\pi$ mm$^2$)",
        ylabel="area reduction (%)",
        xticks=[10, 15, 20],
    )
    for ax in (left, right):
        ax.legend(
            frameon=False, fontsize=6.5, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.2)
        )


def _area_rows(path, number):
    columns = dict(
        mu=path.mu,
        free_stretch=free_stretch(path),
        area_reduction=area_reduction(path),
        least_gap_mm=min_gap(path),
    )
    return rows(columns, sample=number, contact="on" if path.model.contact is not None else "stop")
