"""Figs. 2-4 of Deng et al. (2020): the square that swells uniaxially, by the interpolating method and those it is compared with."""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ..cases import sample
from ..cloud import Cloud, make_cloud
from ..continuation import sweep
from ..discretisation import discretise, make_probe
from ..equilibrium import Observer, State
from ..geometry import Plate
from ..materials import uniaxial_swelling
from ..mechanics import Problem
from .items import COLOURS, CONDITION, CONFIRMED, CONTRADICTED, Claim, Entry, Number, Runs, pyplot
from .newton import equilibria
from .scheme import make_scheme

MU = [-4.9, -4.0, -3.0, -2.5, -2.0, -1.5, -1.2, -1.0, -0.8, -0.6, -0.4, -0.3, -0.2, -0.1, -0.05, 0.0]
SIDES = (7, 9, 11, 13, 15)
REPEATS = 3
ENOUGH = 4.0  # s of one point, after which it is not repeated
LIMIT = 5.0  # s, of every point
_PENALTY = dict(conditions="penalty", penalty=1e3)
METHODS: dict[str, dict[str, Any] | None] = {
    "IICVEFG, mixed, consistent (default)": None,
    "IICVEFG, mixed, paper's cells": dict(method="cells"),
    "IICVEFG, displacement (as printed)": dict(),
    **{f"ICVEFG, displacement, penalty 1e{k}": dict(kind="icvmls", conditions="penalty", penalty=10.0**k) for k in (2, 3, 4, 5)},
    "IICVEFG, displacement, penalty 1e3": _PENALTY,
    "ICVEFG, mixed, penalty 1e3": _PENALTY | dict(kind="icvmls", method="cells"),
    "EFG, displacement, penalty 1e3": _PENALTY | dict(kind="mls"),
    "EFG, mixed, penalty 1e3": _PENALTY | dict(kind="mls", method="cells"),
    "EFG, mixed, multipliers": dict(kind="mls", method="cells", conditions="lagrange"),
}
"""Name -> the variant of the paper's scheme, options of `make_scheme`; None for the default of `discretise`."""
DEFAULT, PRINTED, OTHER = "IICVEFG, mixed, consistent (default)", "IICVEFG, displacement (as printed)", "ICVEFG, displacement, penalty 1e3"
ALIKE = "IICVEFG, displacement, penalty 1e3"
PLAIN = "EFG, displacement, penalty 1e3"
TIMED = (DEFAULT, PRINTED, ALIKE, OTHER, "ICVEFG, mixed, penalty 1e3", PLAIN, "EFG, mixed, penalty 1e3")


def stretches(runs: Runs) -> dict[str, np.ndarray]:
    """Per method of ``METHODS`` the stretch l2 at each of ``MU``, nan where it did not get there; computed once."""
    if "stretches" not in runs.shared:
        runs.shared["stretches"] = {name: _stretches(runs, name) for name in METHODS}
    return runs.shared["stretches"]


def _stretches(runs, name):
    cloud, values = runs.cloud("square"), np.full(len(MU), np.nan)
    states, positions = _swollen(cloud, name, MU, lambda state: runs.on_state(f"{name}, mu = {state.mu:.2f}"))
    half = cloud.plate.height / 2
    for k, state in enumerate(states):
        (_, below), (_, above) = positions(state.x, np.array([[0.0, -half], [0.0, half]]))
        values[k] = (above - below) / (2 * half)
    return values


def _swollen(cloud: Cloud, name: str, mu: list[float], on_step: Callable[[State], Any] = lambda _: None) -> tuple[list[State], Callable]:
    """States of the square by a method, and the function of nodal values and points of the dry plate that gives deformed positions."""
    options, gel = METHODS[name], cloud.plate.gel
    if options is None:
        model = discretise(cloud)
        path = sweep(Problem(model, gel), mu, branch="symmetric", observer=Observer(accepted=on_step))
        return [path[k] for k in range(len(path))], lambda x, points: np.asarray(make_probe(model, points).position(x))
    scheme = make_scheme(cloud, **options)
    states = []
    for state in equilibria(scheme, gel, mu):
        on_step(state)
        states.append(state)
    return states, scheme.positions


def errors(runs: Runs) -> dict[str, np.ndarray]:
    """Per method the relative errors (k,) of l2 against Eq. (59)."""
    exact = np.asarray(uniaxial_swelling(np.array(MU), sample("square").gel))
    return {name: np.abs(values / exact - 1) for name, values in stretches(runs).items()}


def fig_2(runs: Runs) -> Entry:
    """Fig. 2: l2 over mu."""
    found, exact = stretches(runs), np.asarray(uniaxial_swelling(np.array(MU), sample("square").gel))
    figure, ax = pyplot().subplots(figsize=(5.2, 3.6), layout="constrained")
    fine = np.linspace(MU[0], -1e-4, 400)
    ax.plot(fine, uniaxial_swelling(fine, sample("square").gel), color="black", linewidth=0.9, label="Eq. (59)")
    shown = (DEFAULT, PRINTED, OTHER, "EFG, displacement, penalty 1e3")
    for name, colour, marker, size in zip(shown, COLOURS, "os^+", (7, 4.5, 4, 6), strict=False):
        ax.plot(MU, found[name], marker, color=colour, markersize=size, markerfacecolor="none", linestyle="none", label=name)
    ax.set(xlabel=r"chemical potential $\mu$ ($kT$)", ylabel=r"stretch $\lambda_2$", yscale="log")
    ax.set_yticks([1, 2, 4, 8], ["1", "2", "4", "8"])
    ax.minorticks_off()
    ax.legend(frameon=False, fontsize=7.5, loc="upper left")
    error = errors(runs)
    numbers = [
        Number(f"stretch l2 at mu = 0, {name}", float(found[name][-1]), None, float(exact[-1]), ".6f") for name in (DEFAULT, PRINTED)
    ]
    numbers += [Number(f"largest relative error, {n}", _worst(error[n])) for n in METHODS if n.startswith("ICVEFG, displacement")]
    return Entry(
        title="Fig. 2: stretch of the square over the chemical potential",
        paper="IICVEFG agrees with Eq. (59); ICVEFG does for penalty factors of 1e2 to 1e5.",
        numbers=tuple(numbers),
        reference="Eq. (59)",
        verdict=f"Both follow the closed form where they converge; the default is off by at most {np.nanmax(error[DEFAULT]):.1e}.",
        rows=[{"mu": mu, "exact": exact[k]} | {name: values[k] for name, values in found.items()} for k, mu in enumerate(MU)],
        figure=figure,
    )


def _worst(error):
    reached = np.flatnonzero(np.isfinite(error))
    if len(reached) == 0:
        return "no state at all"
    text = f"{np.nanmax(error):.1e}"
    return text if reached[-1] == len(MU) - 1 else f"{text}, stopped after mu = {MU[reached[-1]]:g}"


def fig_3(runs: Runs) -> Entry:
    """Fig. 3: relative error of l2 over mu."""
    error = errors(runs)
    figure, ax = pyplot().subplots(figsize=(6.9, 3.9), layout="constrained")
    for name, colour, marker in zip(METHODS, [*COLOURS, *COLOURS[:5]], "osv^<>Dd+xP*", strict=True):
        style = {"I": "-", "C": "--", "F": ":"}[name[1]]  # IICVEFG, ICVEFG, EFG
        if np.isfinite(error[name]).any():
            ax.semilogy(MU, np.maximum(error[name], 1e-16), marker + style, color=colour, markersize=3.5, linewidth=0.9, label=name)
    ax.axhline(1e-10, color="#5c6670", linewidth=0.7, linestyle="--")
    ax.axhline(1e-4, color="#5c6670", linewidth=0.7, linestyle="--")
    ax.set(xlabel=r"chemical potential $\mu$ ($kT$)", ylabel=r"relative error of $\lambda_2$", ylim=(5e-17, 1))
    ax.figure.legend(frameon=False, fontsize=7.5, loc="outside right center")
    best, printed = error[DEFAULT], error[PRINTED]
    middle = {name: float(np.median(e[np.isfinite(e)])) if np.isfinite(e).any() else float("nan") for name, e in error.items()}
    both = np.isfinite(printed) & np.isfinite(error[OTHER])
    below = np.sum(printed[both] < error[OTHER][both])
    verdict = CONFIRMED if below == both.sum() else CONDITION if below > both.sum() / 2 else CONTRADICTED
    better = middle["EFG, displacement, penalty 1e3"] < middle[PRINTED]
    plain = "is more accurate than" if better else "is less accurate than"
    reason = (
        f"As printed, IICVEFG has the smaller error at {below} of the {both.sum()} values of mu that both reach; plain MLS with the same "
    )
    reason += f"penalty {plain} IICVEFG as printed, so that the incomplete basis (1, z) costs ICVEFG more digits than its penalty."
    numbers = [Number(f"largest relative error, {name}", _worst(error[name])) for name in METHODS]
    numbers += [Number(f"median relative error, {name}", middle[name], digits=".1e") for name in (DEFAULT, PRINTED, OTHER, PLAIN)]
    return Entry(
        title="Fig. 3: relative error of the stretch",
        paper="The error of IICVEFG is smaller than that of ICVEFG at every chemical potential.",
        numbers=tuple(numbers),
        reference="Eq. (59)",
        verdict=f"{verdict}; with consistent integration the error is {np.nanmax(best):.1e} at most.",
        rows=[{"mu": mu} | {name: values[k] for name, values in error.items()} for k, mu in enumerate(MU)],
        claims=(Claim("IICVEFG is more accurate than ICVEFG", verdict, reason),),
        figure=figure,
    )


def fig_4(runs: Runs) -> Entry:
    """Fig. 4: time against the number of nodes."""
    rows = []
    for side in SIDES:
        cloud = make_cloud(_square(side))
        for name in TIMED:
            runs.on_state(f"{name}, {side} x {side} nodes")
            rows.append(_timed(cloud, name))
    seconds = {name: np.array([row["cpu_seconds"] for row in rows if row["method"] == name]) for name in TIMED}
    sides = ", ".join(f"{side}²" for side in SIDES)
    numbers = [Number(f"median seconds to mu = 0, {sides} nodes, {name}", ", ".join(f"{v:.2f}" for v in seconds[name])) for name in TIMED]
    numbers += [
        Number(f"end of the branch, mu, {r['method']}, {r['nodes']} nodes", r["reached_mu"]) for r in rows if r["reached_mu"] < MU[-1]
    ]
    own = max(seconds[DEFAULT].max(), seconds[PRINTED].max())
    claim = _time_claim(seconds)
    over = [f"{r['method']}, {r['nodes']} nodes" for r in rows if r["cpu_seconds"] >= LIMIT]
    return Entry(
        title="Fig. 4: computing time",
        paper="Up to about 1500 s with 15 x 15 nodes; IICVEFG takes less time than ICVEFG with penalty 1e3 for each number of nodes.",
        numbers=tuple(numbers),
        reference="none: times depend on the machine",
        verdict=f"{claim.verdict}; every point of IICVEFG takes {'less' if own < LIMIT else 'more'} than {LIMIT:g} s"
        + (f"; longer take {'; '.join(over)}." if over else ", and so does every other one."),
        rows=rows,
        claims=(claim,),
        figure=_time_figure(rows),
    )


def _square(side):
    """The unit square with side x side nodes."""
    return Plate(1.0, 1.0, edges={"top": "free"}, spacing=1 / (side - 1), gel=sample("square").gel)


def _timed(cloud, name):
    """Median seconds of warm runs from the cloud to the last mu reached, on the clock and on the processor, iterations and end.

    What a method spends beyond, until it gives its branch up, is not counted.
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


def _time_claim(seconds):
    """Whether IICVEFG takes less time than ICVEFG at each number of nodes, with the conditions of each and with the same penalty."""
    ratio, alike = (seconds[OTHER] / seconds[name] for name in (PRINTED, ALIKE))
    verdict = CONTRADICTED if not np.all(ratio > 1) else CONFIRMED if np.all(alike > 1) else CONDITION
    text = f"ICVEFG with penalty 1e3 takes {ratio.min():.2f} to {ratio.max():.2f} times as long as IICVEFG, and {alike.min():.2f} to "
    text += f"{alike.max():.2f} times as long where IICVEFG has the penalty of ICVEFG."
    return Claim("IICVEFG takes less time than ICVEFG", verdict, text)


def _time_figure(rows: Any) -> Any:
    figure, ax = pyplot().subplots(figsize=(6.9, 3.6), layout="constrained")
    for name, colour, marker in zip(TIMED, COLOURS, "os^Dv<>", strict=True):
        own = [row for row in rows if row["method"] == name]
        style = {"I": "-", "C": "--", "F": ":"}[name[1]]  # IICVEFG, ICVEFG, EFG
        ax.semilogy([r["nodes"] for r in own], [r["cpu_seconds"] for r in own], marker + style, color=colour, markersize=4, label=name)
        early = [r for r in own if r["reached_mu"] < MU[-1]]
        open_marker = dict(color=colour, markerfacecolor="white", markersize=4.5)
        ax.plot([r["nodes"] for r in early], [r["cpu_seconds"] for r in early], marker, **open_marker)
    ax.plot([], [], "o", color="black", markerfacecolor="white", markersize=4.5, label=r"open: to where it lost its branch, $\mu < 0$")
    ax.axhline(LIMIT, color="#5c6670", linewidth=0.7, linestyle="--")
    ax.set(xlabel="number of nodes", ylabel=r"median processor time to the last $\mu$ (s)")
    ax.set_xticks([side**2 for side in SIDES], [f"{side}×{side}" for side in SIDES])
    ax.minorticks_off()
    ax.set_yticks([t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if ax.get_ylim()[0] < t < ax.get_ylim()[1]])
    ax.yaxis.set_major_formatter("{x:g}")
    figure.legend(frameon=False, fontsize=7.5, loc="outside right center")
    return figure
