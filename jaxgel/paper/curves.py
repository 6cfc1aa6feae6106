"""Figs. 12-14 of Deng et al. (2020), rotation, lattice and areas, and the paper's algorithm against the total energy."""

import numpy as np

from ..cases import GRID, SIDE, sample
from ..materials import free_swelling
from ..observables import CREASE_RATIO, aspect_ratio, cell_volumes, free_stretch, volume_ratio
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
    area_reduction,
    at,
    core_rotation,
    crossing,
    min_gap,
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
PRINTED_AREAS = {4: 0.60, 7: 0.77}
SAME = 1e-8  # mm, largest difference of positions that are the same
FAMILIES = {"ellipses": (1, 2, 3), "circles": (4, 5, 6), "squares": (7, 8, 9)}


def fig_12(runs):
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
        where = f"sample {n}, {path.model.n_nodes} nodes"
        numbers += [
            Number(f"{where}: rotation, degrees, mu = -1.9678", float(angle[n, m][at(path, -1.9678)])),
            Number(
                f"{where}: mu of the printed {PRINTED_ANGLES[n]:g} degrees", _or_none(crossing(path.mu, angle[n, m], PRINTED_ANGLES[n]))
            ),
            Number(f"{where}: mu of the crease limit", _or_none(crease[n, m]), None, reference["crease_mu"] if n == 1 else None),
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


def _or_none(value: float) -> float | str:
    """The value, or "none" where it is not finite."""
    return value if np.isfinite(value) else "none"


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


def fig_13(runs):
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


def _lattice_figure(stable, symmetric, core):
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


def fig_14(runs):
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
        mu = _or_none(crossing(touching[n].mu, area_reduction(touching[n]), printed))
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


def _area_figure(paths, touching, reduction, area, same, last, shared):
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


def algorithm(runs):
    """Section 4: increments from the freely swollen state against the total energy."""
    from ..continuation import sweep

    options = dict(method="displacement", quadrature="paper", kind="iicvmls", basis="linear")
    mu = [-3.9678, -2.9678, -1.9678, -1.4678]
    model = runs.model("sample-1", 1.1, **options)
    gel = model.cloud.plate.gel
    paths = {}
    for name in ("total", "incremental"):
        runs.on_state(f"sample-1, {name}")
        paths[name] = sweep(model, gel, mu=mu, contact="off", branch="symmetric", formulation=name)
    count = min(map(len, paths.values()))
    table = []
    for k in range(count):
        difference = np.abs(np.asarray(paths["total"].x[k]) - np.asarray(paths["incremental"].x[k])).max()
        iterations = {f"newton_{name}": int(path.newton_iterations[k]) for name, path in paths.items()}
        table.append({"nodes": model.n_nodes, "mu": mu[k], "largest_difference_mm": float(difference)} | iterations)
    worst = max(row["largest_difference_mm"] for row in table)
    done = count == len(mu) and worst < SAME
    return Entry(
        title="Section 4: the paper's incremental algorithm against the total energy",
        paper="Increments of u' from the free-swelling state, u' = (1 - l) X on the rollers, K = K_L0 + K_L1 + K_NL.",
        numbers=tuple(
            Number(
                f"largest difference of positions, mm, mu = {row['mu']}, {row['nodes']} nodes", row["largest_difference_mm"], digits=".1e"
            )
            for row in table
        ),
        reference="total energy",
        verdict=f"{CONFIRMED if done else CONTRADICTED}: {'both have' if done else 'they do not have'} the same equilibria to {SAME:g} mm.",
        rows=table,
        figure=_difference_figure(table),
    )


def _difference_figure(table):
    """Largest difference of the two formulations' positions at each mu."""
    figure, ax = pyplot().subplots(figsize=(4.2, 2.8), layout="constrained")
    ax.semilogy([r["mu"] for r in table], [max(r["largest_difference_mm"], 1e-16) for r in table], "o-", color=COLOURS[0], markersize=4)
    ax.axhline(SAME, color="#5c6670", linewidth=0.7, linestyle="--")
    ax.set(xlabel=r"chemical potential $\mu$ ($kT$)", ylabel="largest difference (mm)", ylim=(1e-16, 1e-7))
    return figure
