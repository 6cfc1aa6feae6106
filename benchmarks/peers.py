"""Work-precision diagram: sample 1 in 30 given steps of mu by jaxgel, NGSolve and scikit-fem.

Each has one thread; extra ``[bench]``.

    python benchmarks/peers.py [--runs 3] [--draw]

Prints a table, writes peers.json beside this file and docs/peers.png. Each row is a process of its
own on one processor. Time is the processor's for a sweep, which others on the machine change less
than the clock's: the median of ``--runs`` after a first one. Error is the largest relative error of
the core rotation over all 30 states against refined quartic elements
(reference_core_rotation.json). The finite elements are curved, of orders 2 to 5, with the pressure
condensed and factors kept for several corrections, on meshes about the cheapest for their error. A
peer that cannot run is reported. ``--draw`` draws the present peers.json again.
"""  # fmt: skip

import argparse
import dataclasses
import json

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from sweep import COLUMNS, HERE, isolated, machine

SPACINGS = (1.1, 22 / 24, 22 / 30, 0.55, 22 / 50, 22 / 60)  # mm
PICTURE = HERE.parent / "docs" / "peers.png"
STYLE = {"jaxgel": ("#0072b2", "o"), "NGSolve": ("#d55e00", "s"), "scikit-fem": ("#009e73", "^")}
BANDS = (0.1, 0.05, 0.03, 0.015, 0.01)  # errors at which the fastest rows are compared


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3, help="timed sweeps per row (3)")
    parser.add_argument(
        "--draw", action="store_true", help="draw peers.json again, without measuring"
    )
    options = parser.parse_args()
    file = HERE / "peers.json"
    if not options.draw:
        result = {"machine": machine(), "runs": options.runs, **measure(options.runs)}
        file.write_text(json.dumps(result, indent=1) + "\n")
    result = json.loads(file.read_text())
    compare(result["rows"])
    draw(result["rows"], PICTURE)


def measure(runs):
    """Rows of all solvers, printed as they come, and why a peer could not run."""
    cases, failed, rows = {"jaxgel": [{"spacing": spacing} for spacing in SPACINGS]}, {}, []
    for peer, module, key in (
        ("NGSolve", "ngsolve_sweep", "ngsolve"),
        ("scikit-fem", "skfem_gel", "skfem"),
    ):
        try:
            cases[peer] = [{key: dataclasses.asdict(row)} for row in __import__(module).ROWS]
        except ImportError as missing:
            failed[peer] = f"{missing}; pip install 'jaxgel[bench]'"
    print(*(heading.rjust(width) for heading, (width, _) in COLUMNS.items()), sep="")
    for peer, own in cases.items():
        for case in own:
            try:
                rows.append(isolated(case, runs, 1) | {"peer": peer})
            except SystemExit as failure:
                failed[f"{peer} {case}"] = str(failure)
                continue
            print(
                *(str(say(rows[-1])).rjust(width) for width, say in COLUMNS.values()),
                sep="",
                flush=True,
            )
    for peer, reason in failed.items():
        print(f"{peer} could not run: {reason}")
    return {"rows": rows, "failed": failed}


def compare(rows):
    """Seconds of each solver's fastest row within an error, and jaxgel's speed-up.

    The reference is the best peer.
    """
    print(
        f"{'error <':>8}"
        + "".join(f"{peer:>12}" for peer in STYLE)
        + f"{'ratio':>8}  (seconds; best peer / jaxgel)"
    )
    for band in BANDS:
        best = {
            peer: min(
                (row["cpu_s"] for row in rows if row["peer"] == peer and row["error"] <= band),
                default=float("inf"),
            )
            for peer in STYLE
        }
        ratio = min(seconds for peer, seconds in best.items() if peer != "jaxgel") / best["jaxgel"]
        print(
            f"{band:8.1%}"
            + "".join(f"{seconds:11.3f}s" for seconds in best.values())
            + f"{ratio:8.2f}"
        )


def draw(rows, file):
    """Error against seconds, both logarithmic; lines join the Pareto-optimal rows of a solver."""
    with mpl.rc_context({"font.size": 9, "axes.linewidth": 0.6, "savefig.dpi": 200}):
        figure, ax = plt.subplots(figsize=(5.6, 3.8), layout="constrained")
        for peer, (colour, marker) in STYLE.items():
            own = sorted(
                (row["cpu_s"], 100 * row["error"])
                for row in rows
                if row["peer"] == peer and row["error"] < 1
            )
            if not own:
                continue
            best = [
                point
                for k, point in enumerate(own)
                if all(point[1] < before[1] for before in own[:k])
            ]
            ax.loglog(
                *zip(*own, strict=True),
                linestyle="none",
                color=colour,
                marker=marker,
                markersize=4.5,
                markerfacecolor="white",
            )
            ax.loglog(
                *zip(*best, strict=True),
                color=colour,
                marker=marker,
                markersize=4.5,
                linewidth=1.2,
                label=peer,
            )
        ax.set(
            xlabel="processor time of a sweep of 30 states, one thread (s)",
            ylabel="largest error of the core rotation (%)",
        )
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(mpl.ticker.FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(
                mpl.ticker.FuncFormatter(
                    lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else ""
                )
            )
        ax.tick_params(which="both", labelsize=8)
        ax.grid(which="both", linewidth=0.3, color="#d0d4d8")
        ax.legend(
            frameon=False,
            title="open: another of its rows is\nfaster and as precise",
            title_fontsize=7,
            alignment="left",
        )
        figure.savefig(file)
        plt.close(figure)


if __name__ == "__main__":
    main()
