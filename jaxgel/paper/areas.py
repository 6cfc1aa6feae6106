"""Fig. 14 of Deng et al. (2020): area reduction of the holes of samples 1-9."""

from typing import Any

import numpy as np

from ..cases import SIDE, sample
from ..observables import cell_volumes, free_stretch, volume_ratio
from .items import (
    CLOSING,
    COLOURS,
    CONDITION,
    CONFIRMED,
    CONTRADICTED,
    FINITE_ELEMENTS,
    Claim,
    Entry,
    Number,
    Runs,
    area_reduction,
    at,
    crossing,
    min_gap,
    or_none,
    pyplot,
    rows,
)

PRINTED_AREAS = {4: 0.60, 7: 0.77}
FAMILIES = {"ellipses": (1, 2, 3), "circles": (4, 5, 6), "squares": (7, 8, 9)}


def fig_14(runs: Runs) -> Entry:
    """Fig. 14: area reduction against stretch, and against the initial area."""
    paths = {n: runs.stopping(n) for n in range(1, 10)}
    touching = {4: runs.touching(4), 7: runs.touching(7)}
    reduction = {n: np.asarray(area_reduction(path)) for n, path in paths.items()}
    area = {n: sum(float(hole.area()) for hole in sample(f"sample-{n}").holes) / 4 for n in paths}
    shared = min(float(path.mu[-1]) for path in paths.values())
    same = {n: float(reduction[n][at(path, shared)]) for n, path in paths.items()}
    last = {n: float(values[-1]) for n, values in reduction.items()}
    table = [
        row
        for contact, group in (("stop", paths), ("on", touching))
        for n, path in group.items()
        for row in rows(_area_columns(path, area[n]), sample=n, contact=contact)
    ]
    off = max(abs(row["area_reduction"] - row["kinematic"]) for row in table)
    reference = FINITE_ELEMENTS["areas"]
    claims = (*(_area_claim(n, touching[n], printed) for n, printed in PRINTED_AREAS.items()), _trend_claim(shared, same, last))
    radii = {n: f"{area[n] / np.pi:.0f}" for n in (4, 5, 6)}
    numbers = [
        Number(
            f"sample {n}, mu = {shared:.4f}: area reduction, %",
            100 * same[n],
            None,
            100 * np.interp(shared, reference["mu"], reference["area"][radii[n]])
            if shared in reference["mu"] and radii.get(n) in reference["area"]
            else None,
        )
        for n in paths
    ]
    numbers += [Number(f"sample {n}, end without contact, mu = {paths[n].mu[-1]:.4f}: area reduction, %", 100 * last[n]) for n in paths]
    for n, printed in PRINTED_AREAS.items():
        final = float(np.asarray(area_reduction(touching[n]))[-1])
        mu = or_none(crossing(touching[n].mu, area_reduction(touching[n]), printed))
        numbers += [
            Number(f"sample {n}, with contact, mu = {touching[n].mu[-1]:.4f}: area reduction, %", 100 * final, 100 * printed),
            Number(f"sample {n}, with contact: mu of the printed {100 * printed:.0f} %", mu),
        ]
    numbers.append(Number("outlines against volumes of the gel: largest difference of the area reduction, %", 100 * off, digits=".2g"))
    return Entry(
        title="Fig. 14: area reduction of the holes, (a) against the free stretch, (b) against the initial area",
        paper="77 % for sample 7, 60 % for sample 4, least for sample 1; smaller holes lose more if elliptical, less if circular or "
        "square.",
        numbers=tuple(numbers),
        verdict="; ".join(f"{claim.statement}: {claim.verdict}" for claim in claims) + ".",
        rows=table,
        claims=claims,
        figure=_area_figure(paths, touching, reduction, area, same, last, shared),
    )


def _area_columns(path, area):
    return {
        "mu": path.mu,
        "free_stretch": free_stretch(path),
        "area_reduction": area_reduction(path),
        "kinematic": _kinematic(path, area),
        "least_gap_mm": min_gap(path),
    }


def _kinematic(path, area):
    """Area reduction (k,) that the gel's mean volume ratio J dictates in a rigid frame: (J - 1)(1 - phi)/phi."""
    volumes = np.asarray(cell_volumes(path.model))
    J = np.asarray(volume_ratio(path)) @ volumes / volumes.sum()
    phi = 4 * area / SIDE**2
    return (J - 1) * (1 - phi) / phi


def _area_claim(n, path, printed):
    values = np.asarray(area_reduction(path))
    mu = crossing(path.mu, values, printed)
    branch, statement = CLOSING[n][0], f"Area reduction of {100 * printed:.0f} % in sample {n}"
    if not np.isfinite(mu):
        return Claim(statement, CONTRADICTED, f"The {branch} branch with contact ends before: {path.stop_text}.")
    return Claim(statement, CONDITION, f"The {branch} branch with contact reaches it at mu = {mu:.4f} and goes on beyond.")


def _trend_claim(shared, same, last):
    """Whether the percentage rises with smaller holes for ellipses and falls for circles and squares."""
    trend = {name: [v[n] for n in numbers] for name, numbers in FAMILIES.items() for v in (same,)}
    ends = {name: [last[n] for n in numbers] for name, numbers in FAMILIES.items()}
    rises = {name: bool(np.all(np.diff(values) > 0)) for name, values in trend.items()}
    end_rises = {name: bool(np.all(np.diff(values) > 0)) for name, values in ends.items()}
    end_falls = {name: bool(np.all(np.diff(values) < 0)) for name, values in ends.items()}
    printed = end_rises["ellipses"] and end_falls["circles"] and end_falls["squares"]
    opposite = not all(rises.values())
    verdict = CONFIRMED if opposite and printed else CONDITION if printed else CONTRADICTED
    text = f"At the same mu = {shared:.4f} smaller holes lose the larger share in {sum(rises.values())} of 3 families; "
    text += f"the ends of the curves, at different mu, {'show' if printed else 'do not show'} the printed trends."
    return Claim("With smaller holes the area reduction rises for ellipses and falls for circles and squares", verdict, text)


def _area_figure(paths: Any, touching: Any, reduction: Any, area: Any, same: Any, last: Any, shared: Any) -> Any:
    figure, (left, right) = pyplot().subplots(1, 2, figsize=(7.2, 3.8), layout="constrained")
    styles = {0: "-", 1: "--", 2: ":"}
    for f, (name, numbers) in enumerate(FAMILIES.items()):
        for i, n in enumerate(numbers):
            path = paths[n]
            left.plot(free_stretch(path), 100 * reduction[n], styles[i], color=COLOURS[f], linewidth=1.1, label=f"sample {n}")
            left.plot(free_stretch(path)[-1], 100 * reduction[n][-1], "osD"[f], color=COLOURS[f], markersize=4)
        sizes = [area[n] / np.pi for n in numbers]
        shift = 0.25 * (f - 1)  # equal areas would hide each other
        right.plot(np.add(sizes, shift), [100 * same[n] for n in numbers], "osD"[f] + "-", color=COLOURS[f], markersize=5, label=name)
        right.plot(sizes, [100 * last[n] for n in numbers], "osD"[f] + "--", color=COLOURS[f], markersize=5, markerfacecolor="none")
    for path in touching.values():
        left.plot(free_stretch(path), 100 * np.asarray(area_reduction(path)), color="#5c6670", linewidth=0.6, zorder=0)
    left.plot([], [], color="#5c6670", linewidth=0.6, label="4, 7 with contact")
    left.set(xlabel=r"free-swelling stretch $\lambda_\mu$", ylabel="area reduction (%)")
    left.legend(frameon=False, fontsize=6.5, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    for n, printed in PRINTED_AREAS.items():
        right.plot(
            area[n] / np.pi,
            100 * printed,
            "*",
            color=COLOURS[1 if n == 4 else 2],
            markersize=9,
            markeredgecolor="black",
            markeredgewidth=0.5,
        )
    right.plot([], [], "k-", linewidth=1, label=rf"at $\mu = {shared:.4f}$")
    right.plot([], [], "k--", linewidth=1, label="at the end of each curve")
    right.plot([], [], "*", color="white", markeredgecolor="black", markersize=8, label="printed, samples 4 and 7")
    right.set(xlabel=r"initial area of a hole ($\pi$ mm$^2$)", ylabel="area reduction (%)")
    right.set_xticks([10, 15, 20])
    right.legend(frameon=False, fontsize=6.5, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    left.set_title("(a)")
    right.set_title("(b)")
    return figure
