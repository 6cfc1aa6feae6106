"""Reliability of error bars: true errors beside the bars of `jaxgel.accuracy`.

For the paper's samples, the lattice and random plates.

    python benchmarks/error_bars.py [--cases sample-1 random-3 ...] [--truth 2.5] [--out FILE]
    [--quick]

The truth is a cloud with ``--truth`` times as many squares along a side. Prints for every case,
every quantity, and all together the share of numbers whose true error lies within the bar, and the
median of bar over true error. Targets: 90 % or more, and 4 or less.
"""

import argparse
import json
from pathlib import Path

import numpy as np

import jaxgel
from jaxgel.observables import QUANTITIES
from jaxgel.verification import ACCURACY

MU = np.linspace(-4.9678, -1.4678, 8).tolist()
SQUARES = 20  # along the shorter side of a random plate
NAMES = [f"sample-{k}" for k in range(1, 9)] + ["lattice"] + [f"random-{k}" for k in range(10)]
KNOWN = 1e-9  # of the largest value: errors below it are round-off


def random_plate(seed):
    """A plate with one to four holes at random in rows and columns, and a random gel."""
    rng = np.random.default_rng(1000 + seed)
    w, h = rng.choice([6.0, 8.0, 10.0]), rng.choice([6.0, 8.0])
    across, up = rng.integers(1, 3), rng.integers(1, 3)
    room, holes = 0.5 * min(w / across, h / up), []
    for i, j in np.ndindex(across, up):
        centre = np.array([(i + 0.5) / across * w - w / 2, (j + 0.5) / up * h - h / 2])
        a, b = room * rng.uniform([0.45, 0.35], 0.75)
        centre = (centre + room * rng.uniform(-0.1, 0.1, 2)).tolist()
        round_hole = rng.random() < 0.3
        holes.append(
            jaxgel.Circle(centre, a)
            if round_hole
            else jaxgel.Ellipse(centre, (a, b), rng.uniform(-1.5, 1.5))
        )
    edges = {} if rng.random() < 0.6 else {"top": ("free", "roller")[rng.integers(2)]}
    gel = jaxgel.Gel(Nv=float(10 ** rng.uniform(-3, -2)), chi=float(rng.uniform(0, 0.4)))
    return jaxgel.Plate(
        float(w), float(h), holes, edges=edges, gel=gel, spacing=float(min(w, h) / SQUARES)
    )


def errors_of(name, truth, spacing=None):
    """Rows (quantity, true error, half of the bar) of the numbers of a case."""
    plate = (
        random_plate(int(name.split("-")[1])) if name.startswith("random") else jaxgel.sample(name)
    )
    spacing = plate.spacing if spacing is None else spacing

    def path_at(h):
        return jaxgel.sweep(
            jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate, spacing=h)), plate.gel), MU
        )

    found = jaxgel.accuracy(path_at, spacing)
    fine = path_at(spacing / truth)
    rows = []
    for quantity, bars in found.bars.items():
        exact = np.asarray(QUANTITIES[quantity].of(fine), dtype=float) * QUANTITIES[quantity].scale
        k = min(len(exact), len(bars.own))
        exact, own, bar = exact[:k], bars.own[:k], bars.error[:k]
        if quantity in ("rotation", "core_rotation") and np.nansum(exact * own) < 0:
            exact = -exact  # buckled to the other side
        error = np.abs(own - exact)
        counted = (
            np.isfinite(error)
            & np.isfinite(bar)
            & (error > KNOWN * np.nanmax(np.abs(exact), initial=0.0))
        )
        rows += [
            (quantity, e, b)
            for e, b in zip(error[counted].tolist(), bar[counted].tolist(), strict=True)
        ]
    return rows


def line(label, rows):
    """Share within the bars and median of bar over error of some rows."""
    error, bar = np.array([row[1] for row in rows]), np.array([row[2] for row in rows])
    within, ratio = 100 * np.mean(error <= bar), np.median(bar / error)
    print(f"{label:<20}{len(rows):>8}{within:>12.1f}{ratio:>12.2f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=NAMES)
    parser.add_argument("--truth", type=float, default=2.5)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--quick", action="store_true", help="one coarse plate")
    args = parser.parse_args()
    cases, spacing = (["sample-1"], 1.1) if args.quick else (args.cases, None)
    print(f"{'':<20}{'numbers':>8}{'within %':>12}{'bar/error':>12}")
    found = {}
    for name in cases:
        found[name] = errors_of(name, 1.5 if args.quick else args.truth, spacing)
        line(name, found[name])
        if args.out:
            args.out.write_text(json.dumps(found), encoding="utf-8")
    rows = [row for own in found.values() for row in own]
    for quantity in ACCURACY:
        own = [row for row in rows if row[0] == quantity]
        if own:
            line(quantity, own)
    line("all", rows)


if __name__ == "__main__":
    main()
