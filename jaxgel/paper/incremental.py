"""Section 4 of Deng et al. (2020): the incremental algorithm against the total energy."""

from typing import Any

import numpy as np

from .items import COLOURS, CONFIRMED, CONTRADICTED, Entry, Number, Runs, pyplot
from .newton import ALGORITHMS, equilibria
from .scheme import make_scheme

SAME = 1e-8  # mm, largest difference of positions that are the same


def algorithm(runs: Runs) -> Entry:
    """Section 4: increments from the freely swollen state against the total energy."""
    mu = [-3.9678, -2.9678, -1.9678, -1.4678]
    cloud, found = runs.cloud("sample-1", 1.1), {}
    scheme = make_scheme(cloud)
    for name in ALGORITHMS:
        runs.on_state(f"sample-1, {name}")
        found[name] = list(equilibria(scheme, cloud.plate.gel, mu, algorithm=name))
    table = []
    for total, incremental in zip(*found.values(), strict=False):
        iterations = {f"newton_{name}": states[len(table)].newton_iterations for name, states in found.items()}
        difference = float(np.abs(total.x - incremental.x).max())
        table.append({"nodes": len(total.x), "mu": total.mu, "largest_difference_mm": difference} | iterations)
    worst = max(row["largest_difference_mm"] for row in table)
    done = len(table) == len(mu) and worst < SAME
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


def _difference_figure(table: Any) -> Any:
    """Largest difference of the two formulations' positions at each mu."""
    figure, ax = pyplot().subplots(figsize=(4.2, 2.8), layout="constrained")
    ax.semilogy([r["mu"] for r in table], [max(r["largest_difference_mm"], 1e-16) for r in table], "o-", color=COLOURS[0], markersize=4)
    ax.axhline(SAME, color="#5c6670", linewidth=0.7, linestyle="--")
    ax.set(xlabel=r"chemical potential $\mu$ ($kT$)", ylabel="largest difference (mm)", ylim=(1e-16, 1e-7))
    return figure
