"""Order of closing: two of four holes in a bath lose half their area, the others a quarter.

Problem: semi-axes, tilt and centres of two pairs of elliptic holes, each symmetric by half a turn;
least hole area, ligaments of at least 1 mm, no self-contact. Start: nearly round holes, which lose
shares of 0.37 and 0.32. In a large incompressible gel of shear modulus G a small pressure p takes
the share p (a / b + b / a) / (2 G) of its area from an ellipse, so slender holes lose more and
round ones, of any size, the least.
"""

from pathlib import Path

import numpy as np

from jaxgel.cases import load_study, run_study
from jaxgel.observables import area_reduction_per_hole

study = load_study(Path(__file__).with_suffix(".toml"))
TIMES = (0.1, 0.4, 1.0)  # of the patterns
PAIRS = {"holes 0 and 2": 0, "holes 1 and 3": 1}


def draw(start, best, file):
    """The optimum at three times, coloured by mu, and the shares of area lost against time."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from jaxgel.plotting import STYLE, plot_patterns

    with mpl.rc_context(STYLE):
        figure = plt.figure(figsize=(6.8, 5.0), layout="constrained")
        above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
        plot_patterns(best, TIMES, axes=above.subplots(1, 3, sharey=True), field="mu")
        axes = below.subplots(1, 2, sharey=True)
        for ax, path, title in zip(axes, (start, best), ("start", "optimum"), strict=True):
            lost = 100 * np.asarray(area_reduction_per_hole(path))
            for (name, hole), colour in zip(PAIRS.items(), ("#d55e00", "#0072b2"), strict=True):
                ax.plot(path.t, lost[:, hole], color=colour, marker="o", markersize=2.5, label=name)
            ax.axhline(50, color="#5c6670", linewidth=0.7, linestyle=":")
            ax.set(title=title, xlabel="time $t$", xlim=(0, None), ylim=(0, None))
        axes[0].set(ylabel="area lost (%)")
        axes[0].legend(frameon=False, loc="lower right")
        figure.savefig(file, dpi=130)


def main(folder):
    """Search, verify on a fresh cloud with half the steps, write the folder and order.png."""
    design, verified = run_study(study, folder, quiet=False)
    print(design.text)
    paths = {}
    for name, parameters in (("start", study.problem.start), ("best", design.parameters)):
        found, paths[name] = study.verify(parameters, spacing=verified["best"]["spacing"])
        lost = area_reduction_per_hole(paths[name])[-1]
        shares = ", ".join(f"{pair} {float(lost[hole]):.3f}" for pair, hole in PAIRS.items())
        print(f"{name}, shares of area lost at t = 1: {shares}; {found['reason']}")
    draw(paths["start"], paths["best"], Path(folder) / "order.png")


if __name__ == "__main__":
    main(Path("out") / study.name)
