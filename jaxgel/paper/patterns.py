"""Figs. 6-11 of Deng et al. (2020): patterns of the nine samples."""

import itertools

import numpy as np

from .._memo import once_per_owner
from ..continuation import Path
from ..observables import outlines
from .items import (
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
    bow,
    core_rotation,
    percent,
    pyplot,
    rotation_angle,
    rows,
    unstable_from,
)
from .newton import SchemePath

BENT = 0.05  # mm, from which a pillar's centre line counts as bent


def fig_6(runs: Runs) -> Entry:
    """Fig. 6: sample 1 while it swells."""
    path, reference = runs.stopping(1), FINITE_ELEMENTS["sample-1"]
    states = [at(path, mu) for mu in (-4.9678, -1.9678, -1.4678, -0.9178)]
    angle = np.asarray(rotation_angle(path))
    known = dict(zip(reference["mu"], reference["rotation"], strict=True))
    mus = sorted({*(float(path.mu[k]) for k in states), *(mu for mu in known if mu in path.mu)})
    numbers = [Number(f"midline rotation, degrees, mu = {mu:.4f}", float(angle[at(path, mu)]), None, known.get(mu)) for mu in mus]
    error = max(abs(angle[at(path, mu)] / r - 1) for mu, r in known.items() if mu in path.mu)
    return _entry(
        [(path, k) for k in states],
        title="Fig. 6: sample 1 at growing chemical potential",
        paper="No visible deformation at mu = -4.9678; then the ellipses change and the plate rotates anticlockwise.",
        numbers=tuple(numbers),
        verdict=f"{CONFIRMED if angle[states[-1]] > 0 else CONTRADICTED}; within {percent(error)} of finite elements at common mu.",
    )


def fig_8(runs: Runs) -> Entry:
    """Fig. 8: sample 4 while it swells, on both branches."""
    symmetric, stiff, stable = runs.stopping(4), runs.stiff(4), runs.touching(4)
    wanted = (-4.9678, -0.9178, -0.6678, -0.2678)
    paths = [*[symmetric] * 3, stiff, *[stable] * 4]
    shown = [(path, at(path, mu)) for path, mu in zip(paths, 2 * wanted, strict=True)]
    shape = [axes_over_diagonals(path)[k] for path, k in shown]
    core = abs(float(np.asarray(core_rotation(stable))[at(stable, wanted[1])]))
    reference = FINITE_ELEMENTS["sample-4"]
    lozenge, square = shape[2] > 1.05, shape[3] < 0.85
    verdict = CONDITION if lozenge else CONTRADICTED
    why = "lozenges, on the symmetric branch, which is unstable; where that goes on, because it locks, "
    why += "squares" if square else "corners move to the diagonals but no squares form"
    numbers = [
        Number(f"width along the axes over that along the diagonals, {name}, mu = {path.mu[k]:.4f}", float(shape[i]))
        for i, (name, (path, k)) in enumerate(zip(["symmetric"] * 3 + ["paper's own discretisation"], shown, strict=False))
    ]
    numbers += [
        Number("symmetric branch unstable from mu", unstable_from(symmetric), None, reference["critical_mu"]),
        Number("end of the symmetric branch without contact, mu", float(symmetric.mu[-1])),
        Number("negative eigenvalues in the paper's own discretisation", int(stiff.negative_pivots[shown[3][1]]), digits="d"),
        Number(f"core rotation of the stable branch, degrees, mu = {wanted[1]}", core, None, reference["buckled"]["core"][-1]),
    ]
    return _entry(
        shown,
        rows_of_axes=2,
        title="Fig. 8: sample 4 at growing chemical potential; above on the symmetric branch, the last in the paper's own discretisation; "
        "below on the stable branch",
        paper="Circles at mu = -4.9678, lozenges at -0.6678, almost squares at -0.2678 (a circle has the width ratio 1, a lozenge 1.41, a "
        "square 0.71).",
        numbers=tuple(numbers),
        verdict=f"{verdict}{': ' + why if lozenge else ''}.",
        claims=(Claim("The circles of sample 4 become lozenges, then almost squares", verdict, f"They become {why}."),),
    )


def fig_10(runs: Runs) -> Entry:
    """Fig. 10: sample 7 while it swells."""
    path = runs.touching(7)
    shown = [(path, at(path, mu)) for mu in (-4.9678, -0.9178, -0.5678, -0.2678)]
    widths = axes_over_diagonals(path)
    shape = [widths[k] for _, k in shown]
    inward = all(b < a for a, b in itertools.pairwise(shape))
    numbers = [Number(f"width along the axes over that along the diagonals, mu = {path.mu[k]:.4f}", float(widths[k])) for _, k in shown]
    numbers.append(Number("unstable from mu", unstable_from(path), None, FINITE_ELEMENTS["sample-7"]["critical_mu"]))
    return _entry(
        shown,
        title="Fig. 10: sample 7 at growing chemical potential, symmetric branch with contact",
        paper="The four sides of the squares deform inward (mu = -4.9678 to -0.5678), later more near the walls than near the midlines.",
        numbers=tuple(numbers),
        verdict=CONDITION + ": so deform the holes of the symmetric branch, which is unstable." if inward else CONTRADICTED + ".",
    )


def fig_7(runs: Runs) -> Entry:
    """Fig. 7: samples 1-3 at mu = -0.9178."""
    numbers_of, mu = (1, 2, 3), -0.9178
    shown, bows = _states(runs, numbers_of, mu)
    reference = FINITE_ELEMENTS["sample-1"]["rotation"][-1]
    numbers = []
    for n, (path, k), b in zip(numbers_of, shown, bows, strict=True):
        where = f"sample {n}, mu = {path.mu[k]:.4f}{_how(path)}"
        numbers += [
            Number(f"{where}: pillar off its line, mm", float(b[k])),
            Number(f"{where}: midline rotation, degrees", float(rotation_angle(path)[k]), None, reference if n == 1 else None),
        ]
    ends = [n for n in numbers_of if runs.stopping(n).mu[-1] < mu]
    free = [runs.stopping(n) for n in numbers_of]
    common = min(float(path.mu[-1]) for path in free)
    alike = [bow(path)[at(path, common)] for path in free]
    more = all(b > a for a, b in itertools.pairwise(alike))
    bent = min(b[k] for (_, k), b in zip(shown, bows, strict=True)) > BENT
    verdict = CONTRADICTED if not bent or not more else CONDITION if ends else CONFIRMED
    numbers += [Number(f"sample {n}, mu = {common:.4f}: pillar off its line, mm", float(b)) for n, b in zip(numbers_of, alike, strict=True)]
    reason = f"The centre lines {'bend' if bent else 'do not all bend'}, {'more' if more else 'not more'} with smaller holes at the same mu"
    who = f"sample {ends[0]} ends" if len(ends) == 1 else f"samples {', '.join(map(str, ends))} end"
    reason += f"; without contact {who} before mu = {mu}." if ends else "."
    return _entry(
        shown,
        others=free,
        title=f"Fig. 7: samples 1, 2, 3 at mu = {mu}; where outlines overlap before, with contact",
        paper="The vertical pillars buckle, in sample 3 more than in samples 1 and 2.",
        numbers=tuple(numbers),
        verdict=verdict + (": the pillars bend, but not more with smaller holes." if bent and not more else "."),
        claims=(Claim("The pillars of samples 1-3 buckle, more with smaller holes", verdict, reason),),
    )


def fig_9(runs: Runs) -> Entry:
    """Fig. 9: samples 4-6 at mu = -0.95."""
    text = "Symmetric patterns; the pillars' centre lines stay straight; sample 6 deforms most."
    return _straight(runs, (4, 5, 6), -0.95, "Fig. 9", text)


def fig_11(runs: Runs) -> Entry:
    """Fig. 11: samples 7-9 at mu = -0.9178."""
    text = "Symmetric patterns; the pillars' centre lines stay straight; the sides of sample 9 deform most."
    return _straight(runs, (7, 8, 9), -0.9178, "Fig. 11", text)


def _straight(runs, samples: tuple[int, ...], mu: float, figure: str, text: str) -> Entry:
    shown, bows = _states(runs, samples, mu)
    known = {n: FINITE_ELEMENTS.get(f"sample-{n}", {}).get("critical_mu") for n in samples}
    numbers = []
    for n, (path, k), b in zip(samples, shown, bows, strict=True):
        numbers += [
            Number(f"sample {n}, mu = {path.mu[k]:.4f}{_how(path)}: pillar off its line, mm", float(b[k]), digits=".1e"),
            Number(f"sample {n}: unstable from mu", unstable_from(runs.stopping(n)), None, known[n]),
        ]
    stable = runs.touching(4) if samples[0] == 4 else runs.path("sample-7", [-4.9678, -2.9678, -1.9678, -1.4678], contact="stop")
    k = at(stable, mu)
    numbers.append(Number(f"stable branch of sample {samples[0]}, mu = {stable.mu[k]:.4f}: pillar off its line, mm", float(bow(stable)[k])))
    bent = [n for n, (_, k), b in zip(samples, shown, bows, strict=True) if b[k] > BENT]
    unstable = any(path.negative_pivots[k] > 0 for path, k in shown)
    verdict = CONTRADICTED if len(bent) == len(samples) else CONDITION if bent or unstable else CONFIRMED
    why = ["on the symmetric branch, which is unstable there"] * unstable + [f"sample {n} bends past its folds" for n in bent]
    reason = f"The centre lines {'bend in some samples' if bent else 'stay straight'}{', ' * bool(why)}{'; '.join(why)}."
    name = f"Straight pillars of samples {samples[0]}-{samples[-1]}"
    return _entry(
        [*shown, (stable, k)],
        others=[runs.stopping(n) for n in samples],
        title=f"{figure}: samples {', '.join(map(str, samples))} at mu = {mu} on the symmetric branch, with contact where outlines overlap "
        f"before and in the paper's own discretisation where the branch ends before; last, sample {samples[0]} on the stable branch",
        paper=text,
        numbers=tuple(numbers),
        verdict=f"{verdict}{': ' * bool(why)}{'; '.join(why)}.",
        claims=(Claim(name, verdict, reason),),
    )


def _states(runs, numbers, mu):
    """(path, state) of each sample at ``mu``, and the pillars' bows (k,), mm, along each path."""
    shown = [runs.shown(n, mu) for n in numbers]
    return shown, [bow(path) for path, _ in shown]


def _how(path):
    """In which way a path goes beyond the symmetric branch of the converged model without contact."""
    return " with contact" if path.model.contact is not None else " in the paper's own discretisation" if _locks(path) else ""


def _locks(path):
    return isinstance(path, SchemePath)


def _entry(shown, *, others=(), rows_of_axes=1, **texts):
    """``Entry`` with the patterns of (path, state) pairs and a row of numbers for each state of their paths and of ``others``."""
    from ..observables import FIELDS, field_values
    from ..plotting import plot_pattern

    fields = [field_values(path[[k]], "stretch") for path, k in shown]
    limits = float(min(map(np.min, fields))), float(max(np.percentile(f, 99) for f in fields))  # corners would take the whole scale
    columns = len(shown) // rows_of_axes
    size = (2.15 * columns + 0.9, 2.6 * rows_of_axes)
    figure, axes = pyplot().subplots(rows_of_axes, columns, figsize=size, layout="constrained", squeeze=False, sharex=True, sharey=True)
    for ax, (path, k) in zip(axes.flat, shown, strict=True):
        plot_pattern(path, k, ax=ax, limits=limits, colorbar=False)
        ax.label_outer()
        name = path.model.cloud.topology.plate.name.replace("-", " ")
        branch = name if rows_of_axes == 1 else "symmetric" if ax in axes[0] else "stable"
        ax.set_title(rf"{branch}{' (locks)' if _locks(path) else ''}, $\mu = {path.mu[k]:.4f}$", fontsize=8)
    coloured = next(c for c in axes.flat[0].collections if c.get_array() is not None)
    figure.colorbar(coloured, ax=axes, label=FIELDS["stretch"], shrink=0.85, extend="max")
    paths = {id(path): path for path in (*(path for path, _ in shown), *others)}.values()
    table = [row for number, path in enumerate(paths) for row in _rows(number, path, {k for other, k in shown if other is path})]
    return Entry(rows=table, figure=figure, **texts)


def _rows(number, path, shown):
    """Numbers of all states of a path; ``shown`` are those with a picture."""
    columns = {
        "mu": path.mu,
        "midline_rotation_deg": rotation_angle(path),
        "core_rotation_deg": core_rotation(path),
        "area_reduction": area_reduction(path),
        "axes_over_diagonals": axes_over_diagonals(path),
        "pillar_bow_mm": bow(path),
        "negative_pivots": path.negative_pivots,
        "shown": [int(k in shown) for k in range(len(path))],
    }
    how = dict(contact="on" if path.model.contact is not None else "stop", method="displacement" if _locks(path) else "mixed")
    return rows(columns, path=number + 1, case=path.model.cloud.topology.plate.name, **how)


@once_per_owner
def axes_over_diagonals(path: Path) -> np.ndarray:
    """Width (k,) of the first hole along the axes over that along the diagonals."""
    wanted = np.arange(8) * np.pi / 4 - np.pi
    ratios = []
    for loop in np.asarray(outlines(path)[0]):
        offset = loop - loop.mean(axis=0)
        angle, radius = np.arctan2(offset[:, 1], offset[:, 0]), np.linalg.norm(offset, axis=1)
        order = np.argsort(angle)
        r = np.interp(wanted, angle[order], radius[order], period=2 * np.pi)
        ratios.append(r[::2].sum() / r[1::2].sum())
    return np.array(ratios)


PATTERNS = {6: fig_6, 7: fig_7, 8: fig_8, 9: fig_9, 10: fig_10, 11: fig_11}
