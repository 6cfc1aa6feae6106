"""The lattice (Deng et al. 2020, Fig. 13) on its buckled branch, with contact.

Pattern, aspect ratio, rotation and area against mu.

    python benchmarks/lattice.py [--out docs] [--quick]

``--quick`` has five states. Writes lattice.csv and lattice.png; the finite elements are those of
``finite_elements.py``.
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
from tqdm import tqdm

import jaxgel
from jaxgel.observables import aspect_ratio
from jaxgel.paper import FINITE_ELEMENTS

mpl.use("Agg")
import matplotlib.pyplot as plt

from jaxgel.plotting import plot_patterns

MU = [
    -4.9678, -3.9678, -3.4678, -3.2, -3.15, -2.9678, -2.4678, -1.9678, -1.4678, -0.9678, -0.6678,
    -0.4678, -0.3678,
]  # fmt: skip
MU += [
    -0.34, -0.3178, -0.3, -0.285, -0.2688, -0.25, -0.24, -0.23, -0.22, -0.21, -0.20, -0.195, -0.19,
    -0.18, -0.1688,
]  # fmt: skip
QUICK = [-2.9678, -2.4678, -1.4678, -0.9678, -0.6678]
CENTRE = 12  # the hole at the origin


def lattice(mu=MU):
    """The path on the stable branch."""
    plate = jaxgel.sample("lattice")
    with tqdm(total=len(mu)) as bar:
        return jaxgel.sweep(
            jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate)), plate.gel),
            mu,
            observer=jaxgel.Observer(accepted=lambda _: bar.update()),
        )


def table(path):
    """Columns (k, 6) of the sweep: mu, aspect ratio, core rotation, area, gap, negative pivots.

    The aspect ratio is that of the central hole, the rotation in degrees, the area its reduction,
    the gap the smallest one.
    """
    columns = (
        path.mu,
        aspect_ratio(path)[:, CENTRE],
        np.abs(jaxgel.core_rotation(path)),
        jaxgel.area_reduction(path),
    )
    return np.stack([*map(np.asarray, columns), jaxgel.min_gap(path), path.negative_pivots], axis=1)


def draw(path, rows, file):
    """Patterns above, the three curves below, broken at a snap of the gel in contact."""
    figure = plt.figure(figsize=(7.2, 4.5), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1, 1.1))
    patterns = above.subplots(1, 4)
    plot_patterns(path, (-2.9678, -0.9678, path.mu[-4], path.mu[-1]), axes=patterns, field="J")
    for ax in patterns:
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
    contact = rows[:, 4] < float(path.model.contact.range)
    snaps = np.flatnonzero(path.switched & contact)
    labels = "aspect ratio of the central hole", "core rotation (°)", "area reduction (%)"
    for ax, k, label in zip(below.subplots(1, 3), (1, 2, 3), labels, strict=True):
        for part in np.split(rows, snaps):
            ax.plot(
                -part[:, 0],
                part[:, k] * (100 if k == 3 else 1),
                "o-",
                color="#0072b2",
                markersize=2.5,
                linewidth=1,
            )
        if contact.any():
            ax.axvline(
                -rows[np.argmax(contact), 0],
                color="#5c6670",
                linestyle="--",
                linewidth=0.8,
                label="first contact",
            )
        if k == 2:
            known = FINITE_ELEMENTS["lattice"]["buckled"]
            ax.plot(
                -np.array(known["mu"]), known["core"], "x", color="#d55e00", label="finite elements"
            )
            ax.legend(frameon=False, fontsize=7, loc="upper left")
        ax.set(
            xscale="log", xlim=(5.5, 0.15), xlabel=r"chemical potential $\mu$ ($kT$)", ylabel=label
        )
        ax.set_xticks([5, 2, 1, 0.5, 0.2], ["−5", "−2", "−1", "−0.5", "−0.2"])
        ax.minorticks_off()
    figure.savefig(file, dpi=180)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).parents[1] / "docs",
        help="folder of lattice.csv and lattice.png (docs)",
    )
    parser.add_argument("--quick", action="store_true", help="five states")
    options = parser.parse_args()
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    path = lattice(QUICK if options.quick else MU)
    rows = table(path)
    names = "mu,aspect_ratio,core_rotation_deg,area_reduction,min_gap_mm,negative_pivots"
    np.savetxt(out / "lattice.csv", rows, delimiter=",", header=names, comments="", fmt="%.6g")
    draw(path, rows, out / "lattice.png")
    print(
        names,
        *(",".join(f"{value:.5g}" for value in row) for row in rows),
        path.stop_text,
        sep="\n",
    )
