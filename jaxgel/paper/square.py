"""Figs. 2-4 of Deng et al. (2020), the uniaxially swelling square, and Section 4.

The interpolating method is compared with others.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ..cases import sample
from ..cloud import Cloud, make_cloud
from ..continuation import sweep
from ..discretisation import discretise, make_probe
from ..equilibrium import UNOBSERVED, Observer, State
from ..geometry import Plate
from ..materials import uniaxial_swelling
from ..mechanics import Problem
from .items import COLOURS, Entry, Number, Runs, pyplot
from .newton import ALGORITHMS, equilibria
from .scheme import make_scheme

MU = [
    -4.9, -4.0, -3.0, -2.5, -2.0, -1.5, -1.2, -1.0, -0.8, -0.6, -0.4, -0.3, -0.2, -0.1, -0.05, 0.0,
]  # fmt: skip
SIDES = (7, 9, 11, 13, 15)
REPEATS = 3
ENOUGH = 4.0  # s of one point, after which it is not repeated
_PENALTY = dict(conditions="penalty", penalty=1e3)
METHODS: dict[str, dict[str, Any] | None] = {
    "IICVEFG, mixed, consistent (default)": None,
    "IICVEFG, mixed, paper's cells": dict(method="cells"),
    "IICVEFG, displacement (as printed)": dict(),
    **{
        f"ICVEFG, displacement, penalty 1e{k}": dict(
            kind="icvmls", conditions="penalty", penalty=10.0**k
        )
        for k in (2, 3, 4, 5)
    },
    "IICVEFG, displacement, penalty 1e3": _PENALTY,
    "ICVEFG, mixed, penalty 1e3": _PENALTY | dict(kind="icvmls", method="cells"),
    "EFG, displacement, penalty 1e3": _PENALTY | dict(kind="mls"),
    "EFG, mixed, penalty 1e3": _PENALTY | dict(kind="mls", method="cells"),
    "EFG, mixed, multipliers": dict(kind="mls", method="cells", conditions="lagrange"),
}
"""Name -> the variant of the paper's scheme, options of `make_scheme`.

None for the default of `discretise`.
"""
DEFAULT, PRINTED, OTHER = (
    "IICVEFG, mixed, consistent (default)",
    "IICVEFG, displacement (as printed)",
    "ICVEFG, displacement, penalty 1e3",
)
ALIKE = "IICVEFG, displacement, penalty 1e3"
PLAIN = "EFG, displacement, penalty 1e3"
TIMED = (
    DEFAULT,
    PRINTED,
    ALIKE,
    OTHER,
    "ICVEFG, mixed, penalty 1e3",
    PLAIN,
    "EFG, mixed, penalty 1e3",
)
STYLES = {"I": "-", "C": "--", "F": ":"}  # by the second letter: IICVEFG, ICVEFG, EFG


def stretches(runs: Runs) -> dict[str, np.ndarray]:
    """Per method of ``METHODS`` the stretch l2 at each of ``MU``, nan if it did not get there.

    Computed once.
    """
    return runs.once("stretches", lambda: {name: _stretches(runs, name) for name in METHODS})


def _stretches(runs, name):
    cloud, values = runs.cloud("square"), np.full(len(MU), np.nan)
    states, positions = _swollen(cloud, name, MU, runs.observer(name))
    half = cloud.plate.height / 2
    for k, state in enumerate(states):
        (_, below), (_, above) = positions(state.x, np.array([[0.0, -half], [0.0, half]]))
        values[k] = (above - below) / (2 * half)
    return values


def _swollen(
    cloud: Cloud, name: str, mu: list[float], observer: Observer = UNOBSERVED
) -> tuple[list[State], Callable]:
    """States of the square by a method, and its function of deformed positions.

    The function takes nodal values and points of the dry plate.
    """
    options, gel = METHODS[name], cloud.plate.gel
    if options is None:
        model = discretise(cloud)
        path = sweep(Problem(model, gel), mu, branch="symmetric", observer=observer)
        return [path[k] for k in range(len(path))], lambda x, points: np.asarray(
            make_probe(model, points).position(x)
        )
    scheme = make_scheme(cloud, **options)
    states = []
    for state in equilibria(scheme, gel, mu):
        observer.accepted(state)
        states.append(state)
    return states, scheme.positions


def exact(mu: Any) -> np.ndarray:
    """Stretch l2 (k,) of the square at ``mu`` (k,), kT; Eq. (59)."""
    return np.asarray(uniaxial_swelling(np.asarray(mu), sample("square").gel))


def fig_2(runs: Runs) -> Entry:
    """Fig. 2: l2 over mu."""
    found, closed = stretches(runs), exact(MU)
    figure, ax = pyplot().subplots(figsize=(5.2, 3.6), layout="constrained")
    fine = np.linspace(MU[0], -1e-4, 400)
    ax.plot(fine, exact(fine), color="black", linewidth=0.9, label="Eq. (59)")
    for name, colour, marker, size in zip(
        (DEFAULT, PRINTED, OTHER, PLAIN), COLOURS, "os^+", (7, 4.5, 4, 6), strict=False
    ):
        ax.plot(
            MU,
            found[name],
            marker,
            color=colour,
            markersize=size,
            markerfacecolor="none",
            linestyle="none",
            label=name,
        )
    ax.set(xlabel=r"chemical potential $\mu$ ($kT$)", ylabel=r"stretch $\lambda_2$", yscale="log")
    ax.set_yticks([1, 2, 4, 8], ["1", "2", "4", "8"])
    ax.minorticks_off()
    ax.legend(frameon=False, fontsize=7.5, loc="upper left")
    return Entry(
        title="Fig. 2: stretch of the square over the chemical potential",
        paper="IICVEFG agrees with Eq. (59); ICVEFG does for penalty factors of 1e2 to 1e5.",
        numbers=[
            Number(
                f"stretch l2 at mu = 0, {name}",
                float(found[name][-1]),
                None,
                float(closed[-1]),
                ".6f",
            )
            for name in (DEFAULT, PRINTED)
        ],
        reference="Eq. (59)",
        rows=[
            {"mu": mu, "exact": closed[k]} | {name: values[k] for name, values in found.items()}
            for k, mu in enumerate(MU)
        ],
        figure=figure,
    )


def fig_3(runs: Runs) -> Entry:
    """Fig. 3: relative error of l2 over mu."""
    error = {name: np.abs(values / exact(MU) - 1) for name, values in stretches(runs).items()}
    figure, ax = pyplot().subplots(figsize=(6.9, 3.9), layout="constrained")
    numbers = []
    for name, colour, marker in zip(METHODS, 2 * COLOURS, "osv^<>Dd+xP*", strict=False):
        style = dict(color=colour, markersize=3.5, linewidth=0.9, label=name)
        ax.semilogy(MU, np.maximum(error[name], 1e-16), marker + STYLES[name[1]], **style)
        reached = np.isfinite(error[name])
        numbers += [
            Number(
                f"largest relative error, {name}",
                float(np.max(error[name], initial=0, where=reached)),
                digits=".1e",
            ),
            Number(
                f"median relative error, {name}",
                float(np.median(error[name][reached])),
                digits=".1e",
            ),
            Number(f"last mu, {name}", float(np.max(MU, initial=MU[0], where=reached))),
        ]
    ax.set(
        xlabel=r"chemical potential $\mu$ ($kT$)",
        ylabel=r"relative error of $\lambda_2$",
        ylim=(5e-17, 1),
    )
    figure.legend(frameon=False, fontsize=7.5, loc="outside right center")
    return Entry(
        title="Fig. 3: relative error of the stretch",
        paper="The error of IICVEFG is smaller than that of ICVEFG at every chemical potential.",
        numbers=numbers,
        reference="Eq. (59)",
        rows=[
            {"mu": mu} | {name: values[k] for name, values in error.items()}
            for k, mu in enumerate(MU)
        ],
        figure=figure,
    )


def fig_4(runs: Runs) -> Entry:
    """Fig. 4: time against the number of nodes."""
    rows = []
    for side in SIDES:
        cloud = make_cloud(
            Plate(1.0, 1.0, edges={"top": "free"}, spacing=1 / (side - 1), gel=sample("square").gel)
        )
        for name in TIMED:
            runs.on_state(f"{name}, {side} x {side} nodes")
            rows.append(_timed(cloud, name))
    figure, ax = pyplot().subplots(figsize=(6.9, 3.6), layout="constrained")
    numbers, sides = [], ", ".join(f"{side}²" for side in SIDES)
    for name, colour, marker in zip(TIMED, COLOURS, "os^Dv<>", strict=True):
        own = [row for row in rows if row["method"] == name]
        nodes, seconds = [row["nodes"] for row in own], [row["cpu_seconds"] for row in own]
        ax.semilogy(
            nodes, seconds, marker + STYLES[name[1]], color=colour, markersize=4, label=name
        )
        ends = ", ".join(f"{row['reached_mu']:g}" for row in own)
        numbers.append(
            Number(
                f"median seconds to mu = {ends} with {sides} nodes, {name}",
                ", ".join(f"{value:.2g}" for value in seconds),
            )
        )
    ax.set(xlabel="number of nodes", ylabel=r"median processor time to the last $\mu$ (s)")
    ax.set_xticks([side**2 for side in SIDES], [f"{side}×{side}" for side in SIDES])
    figure.legend(frameon=False, fontsize=7.5, loc="outside right center")
    return Entry(
        title="Fig. 4: computing time, to where a method loses its branch",
        paper=(
            "Up to about 1500 s with 15 x 15 nodes; IICVEFG takes less time than ICVEFG with "
            "penalty 1e3 for each number of nodes."
        ),
        numbers=numbers,
        reference="none: times depend on the machine",
        rows=rows,
        figure=figure,
    )


def _timed(cloud, name):
    """Median seconds of warm runs to the last mu, wall and processor, iterations and end.

    Runs begin at the cloud and end at the last mu reached. What a method spends beyond, until it
    gives its branch up, is not counted.
    """
    seconds, cpu = [], []
    _swollen(cloud, name, MU[:2])  # compiles
    while len(seconds) < REPEATS and sum(seconds) < ENOUGH:
        now = start = time.perf_counter(), time.process_time()

        def reached(_):
            nonlocal now
            now = time.perf_counter(), time.process_time()

        states, _ = _swollen(cloud, name, MU, reached)
        for times, a, b in zip((seconds, cpu), start, now, strict=True):
            times.append(b - a)
    return {
        "nodes": len(cloud.nodes),
        "method": name,
        "runs": len(seconds),
        "seconds": statistics.median(seconds),
        "cpu_seconds": statistics.median(cpu),
        "newton_iterations": sum(state.newton_iterations for state in states),
        "reached_mu": states[-1].mu,
    }


def algorithm(runs: Runs) -> Entry:
    """Section 4: increments from the freely swollen state against the total energy."""
    mu, cloud = [-3.9678, -2.9678, -1.9678, -1.4678], runs.cloud("sample-1", 1.1)
    scheme = make_scheme(cloud)
    total, incremental = (
        list(equilibria(scheme, cloud.plate.gel, mu, algorithm=name)) for name in ALGORITHMS
    )
    table = [
        {
            "mu": a.mu,
            "largest_difference_mm": float(np.abs(a.x - b.x).max()),
            "newton_total": a.newton_iterations,
            "newton_incremental": b.newton_iterations,
        }
        for a, b in zip(total, incremental, strict=True)
    ]
    difference = [row["largest_difference_mm"] for row in table]
    figure, ax = pyplot().subplots(figsize=(4.2, 2.8), layout="constrained")
    ax.semilogy(mu, np.maximum(difference, 1e-16), "o-", color=COLOURS[0], markersize=4)
    ax.set(
        xlabel=r"chemical potential $\mu$ ($kT$)",
        ylabel="largest difference (mm)",
        ylim=(1e-16, 1e-7),
    )
    return Entry(
        title=(
            "Section 4: the paper's incremental algorithm against the total energy, "
            f"{len(cloud.nodes)} nodes"
        ),
        paper=(
            "Increments of u' from the free-swelling state, u' = (1 - l) X on the rollers, K = "
            "K_L0 + K_L1 + K_NL."
        ),
        numbers=[
            Number(f"largest difference of positions, mm, mu = {m}", d, digits=".1e")
            for m, d in zip(mu, difference, strict=True)
        ],
        reference="total energy",
        rows=table,
        figure=figure,
    )
