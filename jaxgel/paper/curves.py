"""Figs. 12 and 13 of Deng et al. (2020): rotation of samples 1-3, and the lattice."""

from typing import Any

import numpy as np

from ..cases import GRID, sample
from ..materials import free_swelling
from ..observables import CREASE_RATIO, aspect_ratio
from .items import (
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
    core_rotation,
    crossing,
    min_gap,
    or_none,
    percent,
    pyplot,
    rotation_angle,
    rows,
    surface_ratio,
    unstable_from,
)

INTERVALS = (30, 40, 50)  # background intervals per side of the plate
FINEST = INTERVALS[-1]
PRINTED_ANGLES = {1: 30.0, 2: 20.0, 3: 18.0}
NO_ROTATION = -3.9678
VISIBLE = 1.0  # degrees: about the width of a printed line over the plate
LATTICE_MU = [-4.9678, -3.9678, -3.4678, -3.2, -3.15, -2.9678, -2.4678, -1.9678, -1.4678, -0.9678, -0.6678, -0.4678, -0.3678]
LATTICE_MU += [-0.34, -0.3178, -0.3, -0.285, -0.2688, -0.25, -0.24, -0.23, -0.22, -0.21, -0.20, -0.195, -0.19, -0.18, -0.1688]
CENTRE = 12  # the lattice's hole at the origin


def fig_12(runs: Runs) -> Entry:
    """Fig. 12: rotation of samples 1-3 over mu, with refinement."""
    paths = {(n, m): runs.stopping(n, m) for n in PRINTED_ANGLES for m in INTERVALS}
    beyond = {m: runs.touching(3, m, last) for m, last in ((INTERVALS[0], -1.1), (GRID, 0.0))}
    angle = {key: np.asarray(rotation_angle(path)) for key, path in paths.items()}
    crease = {key: crossing(path.mu, surface_ratio(path), CREASE_RATIO) for key, path in paths.items()}
    figure, ax = pyplot().subplots(figsize=(6.4, 4.0), layout="constrained")
    for (n, m), path in paths.items():
        style = (":", "--", "-")[INTERVALS.index(m)]
        label = f"sample {n}, {path.model.n_nodes} nodes, to mu = {path.mu[-1]:.2f}"
        ax.plot(path.mu, angle[n, m], style, color=COLOURS[n - 1], linewidth=1.1, label=label)
        if np.isfinite(crease[n, m]):
            ax.plot(crease[n, m], np.interp(crease[n, m], path.mu, angle[n, m]), "o", color=COLOURS[n - 1], markersize=4)
    for path, style in zip(beyond.values(), (":", "-."), strict=True):
        late = np.asarray(path.mu) > -1.5
        label = f"sample 3, {path.model.n_nodes} nodes, contact"
        ax.plot(path.mu[late], rotation_angle(path)[late], style, color="#5c6670", linewidth=1.1, label=label)
    reference = FINITE_ELEMENTS["sample-1"]
    ax.plot(reference["mu"], reference["rotation"], "k+", markersize=7, label="finite elements, sample 1", zorder=3)
    for n, printed in PRINTED_ANGLES.items():
        ax.axhline(printed, color=COLOURS[n - 1], linewidth=0.5, alpha=0.6)
    ax.plot([], [], "o", color="#5c6670", markersize=4, label="crease limit; thin lines: printed angles")
    ax.set(xlabel=r"chemical potential $\mu$ ($kT$)", ylabel="midline rotation (°)", xlim=(-5.1, -0.7), ylim=(-1, 36))
    ax.legend(fontsize=7, framealpha=0.95, edgecolor="none")  # over the thin lines
    common = [m for m in reference["mu"] if m in paths[1, FINEST].mu]
    known = dict(zip(reference["mu"], reference["rotation"], strict=True))
    errors = [abs(angle[1, FINEST][at(paths[1, FINEST], m)] / reference["rotation"][reference["mu"].index(m)] - 1) for m in common]
    numbers = [
        Number(f"sample 1, mu = {m}: midline rotation, degrees", float(angle[1, FINEST][at(paths[1, FINEST], m)]), None, known[m])
        for m in common
    ]
    for (n, m), path in paths.items():
        where = f"sample {n} with {path.model.n_nodes} nodes"
        numbers += [
            Number(f"{where}: rotation, degrees, mu = -1.9678", float(angle[n, m][at(path, -1.9678)])),
            Number(f"{where}: mu of the printed {PRINTED_ANGLES[n]:g} degrees", or_none(crossing(path.mu, angle[n, m], PRINTED_ANGLES[n]))),
            Number(f"{where}: mu of the crease limit", or_none(crease[n, m]), None, reference["crease_mu"] if n == 1 else None),
        ]
    claims = tuple(_angle_claim(n, paths, angle, crease, beyond if n == 3 else None) for n in PRINTED_ANGLES)
    every = [*((n, "stop", path) for (n, _), path in paths.items()), *((3, "on", path) for path in beyond.values())]
    table = [
        row
        for n, contact, path in every
        for row in rows(
            {"mu": path.mu, "rotation_deg": rotation_angle(path), "surface_ratio": surface_ratio(path)},
            sample=n,
            contact=contact,
            nodes=path.model.n_nodes,
        )
    ]
    return Entry(
        title="Fig. 12: rotation of samples 1, 2 and 3 over the chemical potential, each on three clouds, and the crease limit",
        paper="Rotation reaches about 30, 20 and 18 degrees in samples 1, 2, 3; none is visible before mu = -3.9678.",
        numbers=tuple(numbers),
        verdict="; ".join(f"sample {n} {claim.verdict}" for n, claim in zip(PRINTED_ANGLES, claims, strict=True))
        + f"; within {percent(max(errors, default=0.0))} of finite elements.",
        rows=table,
        claims=(*claims, _onset_claim(paths, angle)),
        figure=figure,
    )


def _angle_claim(n, paths, angle, crease, beyond=None):
    """Whether and where sample n turns by the printed angle, on smooth states or ``beyond`` them, on a path with contact."""
    printed = PRINTED_ANGLES[n]
    where = {m: crossing(paths[n, m].mu, angle[n, m], printed) for m in INTERVALS}
    reached = {m: mu for m, mu in where.items() if np.isfinite(mu)}
    missed = [paths[n, m].model.n_nodes for m in INTERVALS if m not in reached]
    creased = {m: mu for m, mu in crease.items() if m[0] == n and np.isfinite(mu)}
    past = [m for m in reached if (n, m) in creased and creased[n, m] < reached[m]]
    folded = float("nan")
    for path in (beyond or {}).values():
        folded = crossing(path.mu, rotation_angle(path), printed)
    nowhere = not reached and not np.isfinite(folded)
    verdict = CONTRADICTED if nowhere else CONFIRMED if reached and not past and not missed else CONDITION
    if nowhere:
        text = "No cloud reaches the angle."
    elif not reached:
        text = f"Smooth states do not reach the angle; with contact it is reached at mu = {folded:.3f}."
    else:
        text = f"{len(reached)} of {len(INTERVALS)} clouds reach the angle"
        text += ", with a creased surface, where the digits depend on the cloud." if past else " on smooth states."
    return Claim(f"Sample {n} rotates by about {printed:g} degrees", verdict, text)


def _onset_claim(paths, angle):
    values = {n: abs(angle[n, FINEST][at(paths[n, FINEST], NO_ROTATION)]) for n in PRINTED_ANGLES}
    before = {n: abs(angle[n, FINEST][0]) for n in PRINTED_ANGLES}
    text = (
        f"At mu = {NO_ROTATION} the midlines are turned by {max(values.values()):.2f} degrees at most, too little to see in a picture, but "
    )
    text += "rotation has no threshold: it grows smoothly from the dry state on."
    verdict = CONTRADICTED if max(values.values()) > VISIBLE else CONDITION if min(before.values()) > 1e-3 else CONFIRMED
    return Claim("No rotation before mu = -3.9678", verdict, text)


def fig_13(runs: Runs) -> Entry:
    """Fig. 13: the lattice."""
    stable = runs.path("lattice", LATTICE_MU, branch="stable", contact="on")
    symmetric = runs.path("lattice", LATTICE_MU, branch="symmetric", contact="stop")
    core, reference = np.abs(np.asarray(core_rotation(stable))), FINITE_ELEMENTS["lattice"]
    k, end, flat = at(stable, -1.9678), at(stable, -0.1688), at(symmetric, -0.2688)
    gap, contact = np.asarray(min_gap(stable)), float(stable.model.contact.range)
    touch = float(stable.mu[np.argmax(gap < contact)]) if np.any(gap < contact) else float("nan")
    buckled = core[end] > VISIBLE and stable.mu[end] == -0.1688
    late = not np.any((core > VISIBLE) & (np.asarray(stable.mu) < -0.2688))
    verdict = CONTRADICTED if not buckled else CONFIRMED if late else CONDITION
    reason = "The lattice is buckled there" if buckled else "The lattice is not buckled there"
    reason += "." if late else ", but it buckles at a much lower mu, and unrotated holes belong to the unstable symmetric branch."
    known = dict(zip(reference["buckled"]["mu"], reference["buckled"]["core"], strict=True))
    numbers = [
        Number(f"core rotation of the stable branch, degrees, mu = {mu:.4f}", float(core[i]), None, known.get(mu))
        for i, mu in ((i, float(stable.mu[i])) for i in dict.fromkeys((k, at(stable, -0.2688), end)))
    ]
    numbers += [
        Number("symmetric branch unstable from mu", unstable_from(symmetric), None, reference["critical_mu"]),
        Number(
            f"negative eigenvalues of the symmetric branch, mu = {symmetric.mu[flat]:.4f}", int(symmetric.negative_pivots[flat]), digits="d"
        ),
        Number("first contact, mu", touch, None, reference["first_contact_mu"]),
        Number("free stretch at mu = -0.1688", float(free_swelling(-0.1688, sample("lattice").gel)), 1.4510, digits=".4f"),
    ]
    table = [row for name, path in (("stable", stable), ("symmetric", symmetric)) for row in rows(_lattice_columns(path), branch=name)]
    return Entry(
        title="Fig. 13: the lattice; patterns of the symmetric branch, then of the stable one, and its core rotation",
        paper="Circles become lozenges without rotation from mu = -4.9688 to -0.2688; buckled and rotated at -0.1688, stretch 1.4510.",
        numbers=tuple(numbers),
        verdict=f"{verdict}: " + ("it buckles there." if late else "the lattice buckles at a much lower mu than the paper says."),
        rows=table,
        claims=(Claim("The lattice has buckled at stretch 1.4510, and not before mu = -0.2688", verdict, reason),),
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
    shown = [
        (symmetric, at(symmetric, -0.2688)),
        (stable, at(stable, -1.9678)),
        (stable, at(stable, -0.2688)),
        (stable, at(stable, -0.1688)),
    ]
    for ax, (path, k) in zip(np.ravel(above.subplots(1, 4)), shown, strict=True):
        plot_pattern(path, k, ax=ax, field=None)
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
        ax.set_title(f"{'symmetric' if path is symmetric else 'stable'}, " + rf"$\mu = {path.mu[k]:.4f}$", fontsize=7.5)
    reference = FINITE_ELEMENTS["lattice"]
    left, right = np.ravel(below.subplots(1, 2))
    for part in np.split(np.arange(len(stable)), np.flatnonzero(stable.switched & (np.asarray(stable.mu) > -1.0))):
        for ax, values in ((left, core), (right, 100 * np.asarray(area_reduction(stable)))):
            ax.plot(-np.asarray(stable.mu)[part], values[part], "o-", color=COLOURS[0], markersize=2.5, linewidth=1)
    left.plot(-np.asarray(symmetric.mu), np.abs(core_rotation(symmetric)), "--", color=COLOURS[2], linewidth=1, label="symmetric branch")
    left.plot(-np.array(reference["buckled"]["mu"]), reference["buckled"]["core"], "x", color=COLOURS[1], label="finite elements")
    left.axvline(-reference["critical_mu"], color=COLOURS[1], linewidth=0.7, linestyle=":", label="their onset of buckling")
    left.legend(frameon=False, fontsize=7, loc="lower right", bbox_to_anchor=(0.92, 0.08))
    for ax, label in ((left, "core rotation (°)"), (right, "area reduction (%)")):
        ax.set(xscale="log", xlim=(5.5, 0.15), xlabel=r"chemical potential $\mu$ ($kT$)", ylabel=label)
        ax.set_xticks([5, 2, 1, 0.5, 0.2], ["−5", "−2", "−1", "−0.5", "−0.2"])
        ax.minorticks_off()
    return figure
