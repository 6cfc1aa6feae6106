"""Convergence of jaxgel with the node spacing on samples 1 and 4, both bases.

The references are refined finite elements.

    python benchmarks/convergence.py [--out DIR] [--quick]

Sample 1, stable branch: rotation of the midline and of the core, area reduction and energy at five
mu. Sample 4, symmetric branch: the critical mu. Prints the relative errors with the observed rates
(least squares of log error against log spacing), and writes convergence.json and convergence.png
into DIR. ``--quick`` stops at the default spacing. Four minutes, 7 GB.

Contact is off for sample 1, whose holes stay open at these mu: the linear basis wrinkles so finely
that sides of one wrinkle would touch. With the quadratic basis the errors of rotations and critical
mu change sign near the default spacing: those rates are of the coarse clouds.
"""  # fmt: skip

import argparse
import json
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np

import jaxgel
from jaxgel.paper import FINITE_ELEMENTS

mpl.use("Agg")
import matplotlib.pyplot as plt

SPACINGS = (1.1, 22 / 30, 0.55, 22 / 60, 0.275)  # mm
BASES = ("linear", "quadratic")
MU = (-2.9678, -1.9678, -1.4678, -0.9678, -0.9178)  # kT
ON_THE_WAY = (-4.9678, -3.9678, -1.2178)
KNOWN = FINITE_ELEMENTS["sample-1"]
NAMES = {
    "midline rotation": "rotation",
    "core rotation": "core",
    "area reduction": "area",
    "energy": "energy",
}
REFERENCE = {
    name: tuple(KNOWN[key][KNOWN["mu"].index(mu)] for mu in MU) for name, key in NAMES.items()
}
CRITICAL_MU = FINITE_ELEMENTS["sample-4"]["critical_mu"]
LAST = -1.3  # mu up to which the bifurcation is sought, kT


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/convergence"),
        help="folder for the table and the figure (out/convergence)",
    )
    parser.add_argument("--quick", action="store_true", help="only the three coarsest spacings")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for basis in BASES:
        for spacing in SPACINGS[: 3 if options.quick else None]:
            begin = time.perf_counter()
            rows.append(sample_1(basis, spacing) | {"critical mu": critical_mu(basis, spacing)})
            rows[-1]["seconds"] = time.perf_counter() - begin
            print(
                (
                    f"{basis}, spacing {spacing:.4f} mm, {rows[-1]['nodes']} nodes: "
                    f"{rows[-1]['seconds']:.0f} s"
                ),
                flush=True,
            )
    rates = {
        basis: observed_rates([row for row in rows if row["basis"] == basis]) for basis in BASES
    }
    for basis in BASES:
        print_table(basis, [row for row in rows if row["basis"] == basis], rates[basis])
    result = {
        "mu": MU,
        "finite elements": REFERENCE | {"critical mu": CRITICAL_MU},
        "rows": rows,
        "rates": rates,
    }
    (options.out / "convergence.json").write_text(json.dumps(result, indent=1) + "\n")
    draw(rows, rates, options.out / "convergence.png")


def sample_1(basis, spacing):
    """Values of sample 1 at ``MU``; nan after the sweep's end if it stopped early."""
    plate = jaxgel.sample("sample-1")
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing), basis=basis)
    path = jaxgel.sweep(jaxgel.Problem(model, plate.gel, contact=False), sorted((*MU, *ON_THE_WAY)))
    measured = {
        "midline rotation": np.abs(jaxgel.rotation_angle(path)),
        "core rotation": np.abs(jaxgel.core_rotation(path)),
        "area reduction": jaxgel.area_reduction(path),
        "energy": path.energy,
    }
    at = {mu: k for k, mu in enumerate(path.mu)}
    values = {
        name: [float(value[at[mu]]) if mu in at else float("nan") for mu in MU]
        for name, value in measured.items()
    }
    return {"basis": basis, "spacing": spacing, "nodes": model.n_nodes} | values


def critical_mu(basis, spacing):
    """Critical mu of sample 4's symmetric branch, kT; nan if there is none up to ``LAST``."""
    plate = jaxgel.sample("sample-4")
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing), basis=basis)
    found = jaxgel.critical_points(jaxgel.Problem(model, plate.gel), (-4.9678, LAST))
    return float(found[0].mu) if found else float("nan")


def relative_error(name, value):
    """Signed relative errors, of the values at ``MU`` or of the critical mu."""
    exact = np.array(REFERENCE[name]) if name in REFERENCE else np.array([CRITICAL_MU])
    return np.atleast_1d(value) / exact - 1


def observed_rates(rows):
    """Name -> order of the error in the spacing at each of ``MU``, and of the largest ("worst")."""
    spacing = np.log([row["spacing"] for row in rows])
    rates = {}
    for name in (*REFERENCE, "critical mu"):
        errors = np.abs([relative_error(name, row[name]) for row in rows])
        rates[name] = {
            "each": [slope(spacing, column) for column in errors.T],
            "worst": slope(spacing, errors.max(axis=1)),
        }
    return rates


def slope(spacing, error):
    """Order of the error in the spacing by least squares of the logarithms."""
    known = np.isfinite(error)
    return (
        float(np.polyfit(spacing[known], np.log(error[known]), 1)[0])
        if known.sum() > 1
        else float("nan")
    )


def print_table(basis, rows, rates):
    """Relative errors in %, one line per spacing, and the rates below."""
    print(
        f"\n{basis} basis: relative error in %\n{'':18}{'spacing':>9}{'nodes':>7}"
        + "".join(f"{mu:10.4f}" for mu in MU)
        + f"{'worst':>10}"
    )
    for name in REFERENCE:
        for k, row in enumerate(rows):
            error = 100 * relative_error(name, row[name])
            cells = "".join(f"{e:10.3f}" for e in (*error, np.abs(error).max()))
            print(f"{name if k == 0 else '':18}{row['spacing']:9.4f}{row['nodes']:7d}{cells}")
        print(
            f"{'':18}{'rate':>9}{'':7}"
            + "".join(f"{r:10.2f}" for r in (*rates[name]["each"], rates[name]["worst"]))
        )
    for k, row in enumerate(rows):
        value = row["critical mu"]
        error = 100 * relative_error("critical mu", value)[0]
        print(
            f"{'critical mu' if k == 0 else '':18}{row['spacing']:9.4f}{'':7}{value:10.4f}"
            f"{error:10.3f}"
        )
    print(f"{'':18}{'rate':>9}{'':17}{rates['critical mu']['worst']:10.2f}")


def draw(rows, rates, file):
    """Largest error over ``MU`` of every quantity against the spacing, with a line of slope 2."""
    style = {
        "font.size": 8.5,
        "axes.titlesize": 8.5,
        "axes.linewidth": 0.6,
        "lines.linewidth": 1.2,
        "savefig.dpi": 200,
    }
    with mpl.rc_context(style):
        figure, axes = plt.subplots(2, 3, figsize=(7.2, 4.8), sharex=True, layout="constrained")
        for ax, name in zip(axes.flat, (*REFERENCE, "critical mu"), strict=False):
            draw_quantity(ax, name, rows, rates)
        for ax in axes[:, 0]:
            ax.set_ylabel("relative error (%)")
        for ax in (*axes[1, :2], axes[0, 2]):
            ax.set_xlabel("node spacing (mm)")
        axes[0, 2].tick_params(labelbottom=True)
        note = (
            "line: largest error over five $\\mu$,\nits rate by least squares;\n"
            "shade: down to the smallest;\nreference: finite elements"
        )
        axes[1, 2].axis("off")
        axes[1, 2].legend(
            *axes[0, 0].get_legend_handles_labels(),
            frameon=False,
            loc="upper left",
            bbox_to_anchor=(0, 0.95),
        )
        axes[1, 2].text(0.03, 0.5, note, va="top", transform=axes[1, 2].transAxes, fontsize=7.5)
        figure.savefig(file)
        plt.close(figure)


def draw_quantity(ax, name, rows, rates):
    """Both bases' errors of one quantity, with their rates, and whole decades of error."""
    largest = []
    for k, (basis, colour, marker) in enumerate(
        zip(BASES, ("#d55e00", "#0072b2"), "so", strict=True)
    ):
        mine = [row for row in rows if row["basis"] == basis]
        spacing = [row["spacing"] for row in mine]
        errors = 100 * np.abs([relative_error(name, row[name]) for row in mine])
        largest.append(errors.max(axis=1))
        ax.loglog(
            spacing, largest[-1], color=colour, marker=marker, markersize=4, label=f"{basis} basis"
        )
        if errors.shape[1] > 1:
            ax.fill_between(
                spacing,
                errors.min(axis=1),
                errors.max(axis=1),
                color=colour,
                alpha=0.12,
                linewidth=0,
            )
        ax.text(
            0.97,
            0.13 - 0.08 * k,
            f"rate {rates[basis][name]['worst']:.1f}",
            color=colour,
            ha="right",
            transform=ax.transAxes,
        )
    low, high = np.floor(np.log10(np.nanmin(largest) / 2)), np.ceil(np.log10(np.nanmax(largest)))
    ends = np.array([max(spacing) / 2, max(spacing)])
    ax.loglog(
        ends,
        10**high * 0.8 * (ends / ends[1]) ** 2,
        color="#5c6670",
        linewidth=0.7,
        linestyle="--",
        label="slope 2",
    )
    ax.set(ylim=(10**low, 10**high), title=f"{name}, sample {4 if name == 'critical mu' else 1}")
    ax.set_xticks(SPACINGS[::2], [f"{s:g}" for s in SPACINGS[::2]])
    ax.minorticks_off()


if __name__ == "__main__":
    main()
