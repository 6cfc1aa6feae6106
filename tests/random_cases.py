"""Random cases, and what all outcomes satisfy: a path that obeys mechanics, or one line.

    python tests/random_cases.py [CASES] [FIRST] [--time]

Draws plates, holes, gels, ranges of mu, discretisations and boundary conditions at random, sensible
or not; number FIRST + k depends on nothing else. With ``--time`` the plates swell in time, in
random baths. Prints a line per case; exit code 1 if one ends otherwise than as a path without
``faults``, or a ValueError or SweepFailed of one line. test_random_cases.py is the short form.
"""

import argparse
import collections
import dataclasses
import gc
import sys
import time
import warnings

import jax
import numpy as np

import jaxgel
from jaxgel.cases import case as cases
from jaxgel.continuation import SweepFailed
from jaxgel.equilibrium import NEWTON
from jaxgel.geometry import KINDS
from jaxgel.materials import bulk_stiffness
from jaxgel.mechanics import (
    ROUND_OFF,
    all_volumes,
    free_dofs,
    network_energy,
    residual,
    touches,
    volume_ratios,
)

# error of the area over area x reduction^2 of the pores x (spacing / size)^3 of them: 0.14 is seen,
# an eighth at half h
QUADRATURE = 0.2
# error of the area over spacing and length of outlines: chords of spacing / 8 at curvatures of 1 /
# spacing miss 1.3e-3
OUTLINE = 2e-3
# of forces computed from the energy alone, over what Newton's two tolerances let through; see
# `_imbalance`
IMBALANCE = 10
# largest error of the balance of the solvent in a step, over the solvent in the gel: that of 100
# unknowns of mu at once
BALANCE = 1e-10
SECONDS = 300  # a case that takes longer is reported
FORCE, NETWORK_FORCE = jax.jit(residual), jax.jit(jax.grad(network_energy))


def faults(path):
    """What is wrong with a path's states, a list of texts.

    Empty for a path that obeys mechanics.
    """
    found, model, gel = [], path.model, path.gel
    plate, free = model.cloud.plate, free_dofs(model.lists.topology).masters
    # compiled once
    states = [
        dataclasses.replace(path, mu=path.mu[k : k + 1], x=path.x[k : k + 1])
        for k in range(len(path))
    ]
    gap, loads = np.array([jaxgel.min_gap(one)[0] for one in states]), np.zeros((model.n_nodes, 2))
    areas = [
        np.asarray(jaxgel.area_reduction_per_hole(one))[0] if plate.holes else np.zeros(0)
        for one in states
    ]
    lowest = np.asarray(jaxgel.continuation.lowest_eigenvalue(path)) if path.t is None else None
    potential = path.mu if path.t is None else path.potential
    found += [] if path.t is None else _solvent_faults(path)
    for k, mu in enumerate(path.mu):
        x, volumes = path.x[k], np.asarray(all_volumes(model))
        carries = model.carries & (volumes > 0)
        J = np.asarray(volume_ratios(x, model))[carries]
        if not (np.all(np.isfinite(x)) and np.all(np.isfinite(path.pressure[k][volumes > 0]))):
            found.append(f"mu = {mu:.4g}: not finite")
            continue
        if not J.min() > 1:
            found.append(f"mu = {mu:.4g}: J = {J.min():.6g}")
            continue
        if not path.residual[k] < NEWTON.tolerance:
            found.append(f"mu = {mu:.4g}: residual {path.residual[k]:.2g}")
        f, scale = (
            np.asarray(FORCE(x, model, gel, potential[k], loads)),
            np.linalg.norm(NETWORK_FORCE(x, model, gel)),
        )
        most = _imbalance(J, gel)
        if not np.linalg.norm(f.ravel()[free]) < most * scale:
            found.append(f"mu = {mu:.4g}: imbalance {np.linalg.norm(f.ravel()[free]) / scale:.2g}")
        # where a wall's mirror image may push
        touching = model.contact is not None and touches(x, model)
        if not touching and not np.all(np.abs(f.sum(axis=0)) < most * scale):
            found.append(f"mu = {mu:.4g}: forces add up to {f.sum(axis=0)}")
        if lowest is not None and (lowest[k] < 0) != (path.negative_pivots[k] > 0):
            found.append(
                f"mu = {mu:.4g}: eigenvalue {lowest[k]:.3g} with {path.negative_pivots[k]} "
                "negative pivots"
            )
        found += [] if gap[k] <= 0 else _area_faults(model, mu, J @ volumes[carries], areas[k])
    return found


def _imbalance(J, gel):
    """Largest imbalance over the network's forces: residual, and bulk stiffness times J error."""
    error = np.asarray(bulk_stiffness(J, gel)) * NEWTON.constraint_tolerance * (J - 1 + ROUND_OFF)
    return IMBALANCE * (NEWTON.tolerance + float(error.max()) / float(gel.Nv))


def _solvent_faults(path):
    """Steps whose uptake of solvent is not the inflow through the wetted parts."""
    model, carries = path.model, np.asarray(path.model.carries)
    volumes = np.asarray(all_volumes(model))[carries]
    network = np.array([volumes @ np.asarray(volume_ratios(x, model))[carries] for x in path.x])
    error = np.abs(np.diff(network) - np.diff(path.supplied.sum(axis=1))) / (
        network[1:] - volumes.sum()
    )
    return [
        f"t = {path.t[k + 1]:.4g}: solvent misses its balance by {error[k]:.2g}"
        for k in np.flatnonzero(~(error < BALANCE))
    ]


def _area_faults(model, mu, gel, reductions):
    """Gel and pores fill the box of fixed walls, by cells and by the holes' outlines."""
    plate = model.cloud.plate
    if any(condition == "free" for condition in plate.edges.values()):
        return []
    dry = np.array([loop_area(loop) for loop in jaxgel.observables.dry_outlines(model)])
    pores = float(np.sum(dry * (1 - reductions)))
    perimeter = sum(
        np.linalg.norm(np.diff(loop, axis=0, append=loop[:1]), axis=1).sum()
        for loop in jaxgel.observables.dry_outlines(model)
    )
    error, most = (
        abs(gel + pores - plate.width * plate.height),
        OUTLINE * model.cloud.spacing * perimeter,
    )
    most += QUADRATURE * float(
        np.sum(dry * reductions**2 * (model.cloud.spacing / np.sqrt(dry / np.pi)) ** 3)
    )
    return (
        [f"mu = {mu:.4g}: gel and pores miss the box by {error:.3g} of {most:.3g}"]
        if error > most
        else []
    )


def loop_area(loop):
    """Area of a closed polygon (m, 2)."""
    x, y = np.asarray(loop).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def outcome(table):
    """How a case ends, in a word, and its faults."""
    try:
        case = cases.from_table(table, "random")
        path = case.path(case.model())
    except (ValueError, SweepFailed) as problem:
        kind = "refused" if isinstance(problem, ValueError) else "no first state"
        return f"{kind}: {problem}", [] if "\n" not in str(problem) else ["more than one line"]
    return "complete" if path.stop.ok else path.stop_text, faults(path)


def random_table(rng):
    """The table of a random case of some tens to hundreds of nodes."""
    width, height = rng.uniform(2, 30, 2)
    side = min(width, height)
    edges = {
        edge: str(rng.choice(["roller", "roller", "roller", "fixed", "free"]))
        for edge in ("left", "right", "bottom", "top")
    }
    first, last = -rng.uniform(2, 8), -rng.uniform(0, 2)
    sweep = {"mu_start": first, "mu_end": last, "steps": rng.choice(["auto", 3, 6, 12])}
    sweep["steps"] = "auto" if sweep["steps"] == "auto" else int(sweep["steps"])
    sweep |= {
        "branch": str(rng.choice(["stable", "symmetric"])),
        "contact": str(rng.choice(["on", "off", "stop"])),
    }
    return {
        "plate": {"width": width, "height": height, "edges": edges},
        "holes": [random_hole(rng, width, height) for _ in range(rng.integers(0, 4))],
        "gel": {"Nv": 10 ** rng.uniform(-5, -1), "chi": rng.uniform(1e-6, 1.2)},
        "sweep": sweep,
        "discretisation": {
            "spacing": side / rng.uniform(5, 12),
            "nodes_per_hole": int(rng.integers(8, 24)),
            "basis": str(rng.choice(["linear", "quadratic"])),
        },
    }


def random_time_table(rng):
    """The table of a random case that swells in time, on a cloud of some tens of nodes."""
    table = random_table(rng)
    end, start = 10 ** rng.uniform(-2, 3), table["sweep"]["mu_start"]
    table["sweep"] = {"mu_start": start, "branch": table["sweep"]["branch"]}
    # of more than about 0.5 most gels can separate into phases, which is refused
    table["gel"]["chi"] = rng.uniform(1e-6, 0.6)
    table["discretisation"]["spacing"] = min(
        table["plate"]["width"], table["plate"]["height"]
    ) / rng.uniform(4, 8)
    table["time"] = {
        "end": end,
        "steps_per_decade": int(rng.integers(1, 5)),
        "D": 10 ** rng.uniform(-1, 1),
    }
    table["time"] |= {"first": end * 10 ** rng.uniform(-6, -1)} if rng.uniform() < 0.7 else {}
    table["bath"] = random_bath(rng, end)
    for hole in table["holes"]:
        hole |= [{}, {}, {"wet": False}, {"bath": random_bath(rng, end)}][rng.integers(4)]
    sealed = [
        edge
        for edge, condition in table["plate"]["edges"].items()
        if condition == "free" and rng.uniform() < 0.3
    ]
    table["plate"] |= {"wet": dict.fromkeys(sealed, False)} if sealed else {}
    return table


def random_bath(rng, end):
    """Table of a random bath: a number, a ramp or values at times; a few above pure solvent."""
    mu = -rng.uniform(-0.2, 6.0)
    kind = rng.integers(3)
    if kind < 2:
        return {"mu": mu} | ({"ramp": end * 10 ** rng.uniform(-4, 0.5)} if kind else {})
    times = np.append(np.sort(rng.uniform(0, 0.9 * end, 3)), end)
    return {"mu": (-rng.uniform(0, 6.0, 4)).tolist(), "times": times.tolist()}


def random_hole(rng, width, height):
    """The table of a random hole, somewhere in the plate or cut by its edge."""
    kind, size = str(rng.choice(list(KINDS))), min(width, height) * rng.uniform(0.08, 0.3)
    centre = (rng.uniform(-0.5, 0.5, 2) * [width, height]).tolist()
    if kind == "polygon":
        angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 7))))
        return {
            "kind": kind,
            "vertices": (
                centre + size * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            ).tolist(),
        }
    own = {
        "circle": {"radius": size},
        "ellipse": {
            "semi_axes": [size, size * rng.uniform(0.4, 1)],
            "angle": rng.uniform(0, np.pi),
        },
        "rectangle": {"sides": [size, size * rng.uniform(0.5, 2)], "angle": rng.uniform(0, np.pi)},
        "superellipse": {
            "semi_axes": [size, size],
            "exponent": rng.uniform(1.2, 6),
            "angle": rng.uniform(0, np.pi),
        },
        "fourier": {
            "radius": size,
            "cos": rng.uniform(-0.15, 0.15, 2).tolist(),
            "sin": rng.uniform(-0.15, 0.15, 2).tolist(),
        },
    }
    return {"kind": kind, "centre": centre} | own[kind]


def main():
    """Run the cases and count their outcomes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("count", nargs="?", type=int, default=100)
    parser.add_argument("first", nargs="?", type=int, default=0)
    parser.add_argument("--time", action="store_true")
    given = parser.parse_args()
    count, first, drawn = (
        given.count,
        given.first,
        random_time_table if given.time else random_table,
    )
    outcomes, wrong = collections.Counter(), 0
    warnings.simplefilter("error")
    for number in range(first, first + count):
        began = time.perf_counter()
        try:
            text, bad = outcome(drawn(np.random.default_rng(number)))
        except Exception as problem:
            text, bad = (
                "broken",
                [f"{type(problem).__name__}: {' '.join(str(problem).split())[:200]}"],
            )
        seconds = time.perf_counter() - began
        bad += [f"took {seconds:.0f} s"] if seconds > SECONDS else []
        wrong += bool(bad)
        outcomes[text.split(":")[0].split(" after")[0]] += 1
        print(
            f"{number:4d} {seconds:5.1f} s  {text[:300]}",
            *(f"     FAULT {fault}" for fault in bad[:3]),
            sep="\n",
            flush=True,
        )
        jax.clear_caches()
        gc.collect()
    print(f"{count} cases: {dict(outcomes)}; {wrong} with faults")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
