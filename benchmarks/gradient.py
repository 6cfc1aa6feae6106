"""Cost of the gradient of a sweep: sample 1, 30 mu to -0.9178, against the sweep alone.

    python benchmarks/gradient.py [--out DIR] [--spacing H] [--repeats N]

Two objectives, the rotation at the last mu and the sum of squares of the core rotation over the
whole curve; 4 and 60 design parameters (semi-axes, or Fourier modes of the outlines). Prints
medians after compilation and the cost of a gradient over the cost of the sweep, (value and
gradient - value) / value, and writes gradient.json into DIR. The two are timed in turn, and the
median is that of pairs: a machine is not equally fast all the time. Both times include the
discretisation of the moved cloud. The reverse pass alone, in the column before the last, is a
difference of nothing: its share varies less.
"""  # fmt: skip

import argparse
import json
import platform
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel

MU = np.linspace(-4.9678, -0.9178, 30).tolist()  # kT
MODES = 7  # cos and sin of 2 phi ... 8 phi on each of four holes, with radius: 60 parameters
TARGETS = {"last state": 0.15, "whole curve": 0.3}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/gradient"),
        help="folder for gradient.json (out/gradient)",
    )
    parser.add_argument(
        "--spacing", type=float, default=None, help="node spacing in mm (the paper's 0.55)"
    )
    parser.add_argument(
        "--repeats", type=int, default=9, help="pairs of runs of which the median is taken (9)"
    )
    options = parser.parse_args()
    rows = []
    print(
        f"{'parameters':>10} {'objective':>12} {'sweep':>8} {'+ gradient':>10} {'cost':>6} "
        f"{'target':>7} {'reverse':>8} {'compile':>8}"
    )
    for name, (objectives, start) in problems(options.spacing).items():
        for label, objective in objectives.items():
            first, *times = times_in_turn(objective, start, options.repeats)
            value, record, reverse = np.transpose(times)
            cost, share = (
                float(np.median((record + reverse) / value - 1)),
                float(np.median(reverse) / np.median(value)),
            )
            row = dict(
                parameters=name,
                objective=label,
                sweep_s=np.median(value),
                both_s=np.median(record + reverse),
                cost=cost,
            )
            row |= dict(target=TARGETS[label], reverse=share, first_call_s=sum(first))
            rows.append(row)
            print(
                f"{name:>10} {label:>12} {row['sweep_s']:7.3f}s {row['both_s']:9.3f}s {cost:6.2f} "
                f"{row['target']:7.2f} {share:8.2f} "
                f"{row['first_call_s']:7.1f}s",
                flush=True,
            )
    result = {"rows": rows, "jax": jax.__version__, "machine": platform.machine()}
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "gradient.json").write_text(json.dumps(result, indent=1) + "\n")


def problems(spacing):
    """Number of parameters -> ({objective's name: function of the parameters}, start)."""
    ellipses = jaxgel.sample("sample-1")
    centres = [np.asarray(hole.centre) for hole in ellipses.holes]
    fourier = jaxgel.Plate(
        22,
        22,
        [jaxgel.Fourier(c, 4.5, np.zeros(MODES), np.zeros(MODES)) for c in centres],
        spacing=ellipses.spacing,
        gel=ellipses.gel,
    )

    tilts = [hole.angle for hole in ellipses.holes]

    # as a user's own arithmetic should be: one operation at a time it takes longer than the
    # placement of the cloud
    @jax.jit
    def axes(p):
        both = zip(centres, tilts, strict=True)
        return [
            {"semi_axes": p[:2], "centre": c + np.sign(c) * p[2], "angle": tilt + p[3]}
            for c, tilt in both
        ]

    @jax.jit
    def modes(p):
        return [
            {"radius": q[0], "cos": q[1 : 1 + MODES], "sin": q[1 + MODES :]}
            for q in p.reshape(4, -1)
        ]

    one = np.concatenate([[4.5, 0.3], np.zeros(2 * MODES - 1)])
    other = np.concatenate([[4.5, -0.3], np.zeros(2 * MODES - 1)])
    return {
        "4": (objectives(ellipses, axes, spacing), jnp.array([5.0, 4.0, 0.0, 0.0])),
        "60": (
            objectives(fourier, modes, spacing),
            jnp.asarray(np.concatenate([one, other, one, other])),
        ),
    }


def objectives(plate, theta, spacing):
    """The two objectives of a design vector that ``theta`` turns into hole parameters."""
    cloud = jaxgel.make_cloud(plate, spacing=spacing)

    def path(p):
        return jaxgel.sweep(
            jaxgel.Problem(jaxgel.discretise(cloud.at(plate.at(theta(p)))), plate.gel), MU
        )

    return {
        "last state": lambda p: jaxgel.core_rotation(path(p))[-1],
        "whole curve": lambda p: jnp.sum(jaxgel.core_rotation(path(p)) ** 2),
    }


def times_in_turn(objective, start, repeats):
    """Seconds of value, recorded value and gradient, ``repeats`` + 1 times at moved parameters.

    They are moved slightly; the value is recorded for the reverse pass.
    """
    seconds = []
    for k in range(repeats + 1):
        at = start * (1 + 1e-6 * k)
        ends = [time.perf_counter()]
        jax.block_until_ready(objective(at))
        ends.append(time.perf_counter())
        value, pull = jax.vjp(objective, at)
        jax.block_until_ready(value)
        ends.append(time.perf_counter())
        jax.block_until_ready(pull(jnp.ones_like(value)))
        seconds.append(np.diff([*ends, time.perf_counter()]))
    return seconds


if __name__ == "__main__":
    main()
