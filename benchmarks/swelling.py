"""Uptake of solvent in time: a film beside finite volumes, sample 1 beside the square-root law.

    python benchmarks/swelling.py [--rows film sample-1 gradient block holes] [--spacings 0.1 0.05]
    [--quick] [--figure FILE]

``film``: error of the uptake in % at some times, of a film of thickness 1 held sideways, sealed
below and wetted above, in four baths; with and without the term for layers thinner than the cells;
Newton's corrections per step; the error in % of the time at which half is taken up; the largest
error of the balance of the solvent in a step, over the solvent in the gel. The uptakes beside it
are those of one-dimensional finite volumes. Then the largest change of J of a group at once under a
load alone.

``sample-1``: mean volume ratio less that at the start over 0.08513 sqrt(t), what its outlines take
up as half-spaces, less 1 in %; the core's rotation; the time of half the rotation; the distance of
the last state from equilibrium, and the largest difference of a column of ``history.csv`` over its
largest value; how far J falls below its first value, in % of its mean change; that balance; seconds
of a warm step over those of a state of a sweep. With and without that term.

``gradient``: seconds of the gradient of sample 1's rotation by 60 parameters, 20 of holes and 40 of
a field, over those of its run, both warm; the derivative along a random direction over difference
quotients of three steps, less 1, by holes and by the field.

``block``: a square of 1 mm, free and wetted on two sides, in a bath that rises from -1 to -0.1 kT
until t = 0.1: uptake over that in equilibrium, and positions of the corner and of the middle of a
side, less those by finite elements (NGSolve, extra ``[bench]``), in %; the elements on two meshes,
which say how far these can be trusted; Newton's corrections per step and that balance.

``holes``: sample 1 as above until t = 2 beside finite elements on two meshes, of 0.4 and 0.25 mm
along the outlines (half an hour): mean volume ratio less that at the start, in %, rotation of the
core in degrees, and the time at which that is 14.5, half of what it is in equilibrium.

``--figure`` draws sample 1 alone: patterns coloured by mu at four times, the uptake against the
square root of time beside that law, and the rotation of the core, whose half is marked; a minute.
"""  # fmt: skip

import argparse
import time

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from jax.flatten_util import ravel_pytree

import jaxgel
from jaxgel.mechanics import all_volumes, volume_ratios
from jaxgel.observables import core_rotation, history, mean_volume_ratio
from jaxgel.plotting import plot_curve, plot_patterns
from jaxgel.plotting.curves import MARKS
from jaxgel.plotting.style import COLOURS, LINE, WALL, styled

TIMES = (1e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
GOOD = jaxgel.Gel(1e-3, 0.1)
FILMS = {  # gel, mu before and after, uptake at TIMES over that at the end, time at which it is 1/2
    "small jump": (
        GOOD,
        -0.5,
        -0.4999,
        (0.01797, 0.05683, 0.09844, 0.17972, 0.31129, 0.56622, 0.87604),
        0.7755,
    ),
    "swelling": (
        GOOD,
        -1.0,
        -0.1,
        (0.01013, 0.03204, 0.05549, 0.10131, 0.17548, 0.31880, 0.52152),
        2.704,
    ),
    "dry": (
        jaxgel.Gel(1e-3, 1e-4),
        -4.9678,
        -0.9178,
        (0.02793, 0.08833, 0.15300, 0.27933, 0.48236, 0.80008, 0.98145),
        0.3231,
    ),
    "drying": (
        GOOD,
        -0.1,
        -1.0,
        (0.01528, 0.04832, 0.08369, 0.15280, 0.26466, 0.48320, 0.83323),
        1.0707,
    ),
}
NUMERICAL = {"t", "residual", "lowest_eigenvalue"}  # columns of history.csv that are no observables
# of sample 1: kT; uptake over the root of time
START, BATH, HALF_SPACES = -4.9678, -0.9678, 0.08513


class WithoutLayers(jaxgel.Bath):
    """A bath whose changes are so old that no layer is thinner than a cell."""

    def inverse_root_age(self, t, start, *, rising=False, share=1.0):  # noqa: ARG002
        return 0.0


BATHS = {"with": jaxgel.Bath, "without": WithoutLayers}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--rows",
        nargs="*",
        choices=["film", "sample-1", "gradient", "block", "holes"],
        help="film and sample-1; quick gradient too",
    )
    parser.add_argument(
        "--spacings",
        nargs="*",
        type=float,
        help="mm; 0.1 and 0.05 of film and block, the default one of sample-1",
    )
    parser.add_argument("--quick", action="store_true", help="coarse clouds and few steps")
    parser.add_argument("--figure", help="file of the figure of sample 1; nothing else is computed")
    given = parser.parse_args()
    if given.figure:
        draw(given.figure, 2.2 if given.quick else None, 3 if given.quick else 10)
        return
    rows = given.rows or ["film", "sample-1", *["gradient"] * given.quick]
    small = [0.2] if given.quick else given.spacings or [0.1, 0.05]
    if "film" in rows:
        for spacing in small:
            films(spacing, 3 if given.quick else 10)
    if "sample-1" in rows:
        for spacing in [2.2] if given.quick else given.spacings or [None]:
            sample_1(spacing, 3 if given.quick else 10)
    if "gradient" in rows:
        gradient(2.2 if given.quick else None, 3 if given.quick else 16)
    if "holes" in rows:
        holes(
            [2.2] if given.quick else given.spacings or [0.55, 0.4],
            [(3.0, 1.5)] if given.quick else [(1.5, 0.4), (1.0, 0.25)],
            2 if given.quick else 5,
        )
    if "block" in rows:
        block(small, [0.5] if given.quick else [0.15, 0.1], 2 if given.quick else 10)


def mean_ratio(path):
    """Mean volume ratio (k,) of a path."""
    model = path.model
    volumes = np.where(np.asarray(model.carries), np.asarray(all_volumes(model)), 0.0)
    return np.array([volumes @ np.asarray(volume_ratios(x, model)) for x in path.x]) / volumes.sum()


def imbalance(path):
    """Largest error of the balance of the solvent in a step, over the solvent in the gel."""
    ratio, dry = (
        mean_ratio(path),
        np.asarray(all_volumes(path.model))[np.asarray(path.model.carries)].sum(),
    )
    return np.abs(
        (np.diff(ratio) * dry - np.diff(path.supplied.sum(axis=1))) / (dry * (ratio[1:] - 1))
    ).max()


def films(spacing, per_decade):
    print(
        f"film, spacing {spacing}: error of the uptake in % at t =",
        *TIMES,
        "; corrections per step; error of the time of 1/2; balance",
    )
    model = jaxgel.discretise(
        jaxgel.make_cloud(jaxgel.Plate(8 * spacing, 1.0, edges={"top": "free"}), spacing=spacing)
    )
    times = sorted(
        {*jaxgel.TimeSteps(3.0, first=1e-6, per_decade=per_decade).values(spacing, 1.0), *TIMES}
    )
    for name, (gel, start, end, expected, half) in FILMS.items():
        problem = jaxgel.Problem(model, gel, contact=False)
        last = mean_ratio(jaxgel.sweep(problem, [end]))[0]
        for term, kind in BATHS.items():
            path = jaxgel.swell(problem, kind(end), times, start=start)
            ratio = mean_ratio(path)
            share = (ratio - ratio[0]) / (last - ratio[0])
            errors = 100 * (np.interp(TIMES, path.t, share) / expected - 1)
            of_half = 100 * (float(jaxgel.time_to(path, share, 0.5)) / half - 1)
            print(
                f"{name:12}{term:8}",
                *(f"{error:+7.2f}" for error in errors),
                (
                    f"; {path.newton_iterations.sum() / len(times):.1f}; {of_half:+.2f}; "
                    f"{imbalance(path):.1e}; {path.stop.text}"
                ),
            )
    loads = jaxgel.load_vector(model, traction={"top": (0.0, 1e-4)})
    rest = jaxgel.sweep(jaxgel.Problem(model, GOOD, contact=False), [-0.5])[0]
    path = jaxgel.swell(
        jaxgel.Problem(model, GOOD, loads=loads, contact=False), -0.5, [1e-13], start=rest
    )
    J = np.stack([np.asarray(volume_ratios(x, model)) for x in path.x])[
        :, np.asarray(model.carries)
    ]
    print(f"load alone: J changes by at most {np.abs(J[1] - J[0]).max():.1e}")


def sample_1(spacing, per_decade):
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.sample("sample-1"), spacing=spacing))
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 1e-4), contact=False)
    values = np.linspace(START, BATH, 30)
    of_sweep = [seconds(lambda: jaxgel.sweep(problem, values)) for _ in range(2)][1][0] / len(
        values
    )
    end = jaxgel.sweep(problem, [BATH])
    times = sorted(
        {*jaxgel.TimeSteps(100.0, first=3e-4, per_decade=per_decade).values(1.0, 1.0), *TIMES[1:]}
    )
    for term, kind in BATHS.items():
        run = [
            seconds(lambda kind=kind: jaxgel.swell(problem, kind(BATH), times, start=START))
            for _ in range(2)
        ][1]
        spent, path = run
        ratio, angle = mean_ratio(path), np.degrees(np.asarray(core_rotation(path)))
        uptake = 100 * (
            np.interp(TIMES[1:4], path.t, ratio - ratio[0]) / (HALF_SPACES * np.sqrt(TIMES[1:4]))
            - 1
        )
        half = np.exp(np.interp(angle[-1] / 2, angle[1:], np.log(path.t[1:])))
        step, errors = spent / len(times), " ".join(f"{error:+.1f}" for error in uptake)
        J = np.stack([np.asarray(volume_ratios(x, model)) for x in path.x])[
            :, np.asarray(model.carries)
        ]
        below = 100 * (J[0] - J).max() / (ratio[-1] - ratio[0])
        off, corrections = (
            np.abs(path.x[-1] - end.x[0]).max(),
            path.newton_iterations.sum() / len(times),
        )
        table, last = history(path), history(end)
        names = [
            name
            for name, column in last.items()
            if name in table and name not in NUMERICAL and np.asarray(column).dtype == float
        ]
        apart = {
            name: abs(table[name][-1] - last[name][0]) / np.abs(table[name]).max() for name in names
        }
        worst = max(apart, key=apart.get)
        print(
            f"sample 1, {model.n_nodes} nodes, {term} the term: uptake over the law less 1, in %, "
            f"at {TIMES[1:4]}: {errors}"
        )
        print(
            f"  half the rotation at t = {half:.3f}; from equilibrium {off:.1e} mm; J falls by "
            f"{below:.2f} %; {path.stop.text}"
        )
        print(
            f"  columns from equilibrium: at most {apart[worst]:.1e}, {worst}; balance of the "
            f"solvent {imbalance(path):.1e}"
        )
        print(
            f"  {corrections:.1f} corrections, {step:.2f} s a step, {step / of_sweep:.0f} states "
            "of a sweep"
        )


HALF_TURN = 14.5  # degrees
BLOCK_TIMES, RAMP = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0), 0.1


def block(spacings, sizes, per_decade):
    """Block A beside finite elements."""
    from ngsolve_gel import plate_mesh

    plate = jaxgel.Plate(
        1.0, 1.0, edges={"right": "free", "top": "free"}, gel=jaxgel.Gel(1e-2, 0.1)
    )
    print("block: uptake in %, middle of a side, corner (mm) at t =", *BLOCK_TIMES)
    bath, points = jaxgel.Bath([-1.0, -0.1], times=[0.0, RAMP]), [(0.5, -0.5), (0.5, 0.5)]
    growing = jaxgel.TimeSteps(BLOCK_TIMES[-1], first=1e-3, per_decade=per_decade).values(
        1.0, 1.0, [RAMP]
    )
    times = np.array(sorted({*growing.tolist(), *BLOCK_TIMES}))
    expected = None
    for size in sizes:
        rows = np.array(
            by_elements(
                plate_mesh(plate, 3, size, size), plate.gel, -1.0, bath, times, BLOCK_TIMES, points
            )
        ).T
        rows[0] = 100 * (rows[0] - rows[0, 0]) / (rows[0, -1] - rows[0, 0])
        expected = np.stack([rows[0], rows[1] + 0.5, rows[4] + 0.5])[:, 1:-1]
        print(
            f"elements of {size}:",
            *(" ".join(f"{value:.5g}" for value in row) + ";" for row in expected),
        )
    for spacing in spacings:
        model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing))
        problem = jaxgel.Problem(model, plate.gel, contact=False)
        path = jaxgel.swell(problem, bath, times, start=-1.0)
        ratio, last = mean_ratio(path), mean_ratio(jaxgel.sweep(problem, [-0.1]))[0]
        at = [
            int(np.argmin(np.linalg.norm(model.nodes - np.array(point), axis=1)))
            for point in points
        ]
        own = np.stack(
            [
                100 * (ratio - ratio[0]) / (last - ratio[0]),
                path.x[:, at[0], 0] + 0.5,
                path.x[:, at[1], 0] + 0.5,
            ]
        )
        errors = 100 * (
            own[:, [int(np.argmin(np.abs(path.t - t))) for t in BLOCK_TIMES]] / expected - 1
        )
        print(
            f"spacing {spacing}, error in %:",
            *(" ".join(f"{error:+.2f}" for error in row) + ";" for row in errors),
        )
        print(
            f"  {path.newton_iterations.sum() / len(times):.1f} corrections per step; balance of "
            f"the solvent {imbalance(path):.1e}"
        )


def holes(spacings, sizes, per_decade):
    """Sample 1 beside finite elements."""
    from ngsolve_gel import plate_mesh
    from ngsolve_swelling import Swelling

    plate, gel = jaxgel.sample("sample-1"), jaxgel.Gel(1e-3, 1e-4)
    wanted = np.array([*TIMES[1:6], 2.0])
    growing = jaxgel.TimeSteps(wanted[-1], first=3e-4, per_decade=per_decade).values(1.0, 1.0)
    times = np.array(sorted({*growing.tolist(), *wanted.tolist()}))

    def show(name, taken_up, angles):
        at = [np.interp(wanted, times, values) for values in (100 * taken_up, angles)]
        half = np.exp(np.interp(HALF_TURN, angles, np.log(times), right=np.nan))
        print(f"{name}:", *(" ".join(f"{value:.4g}" for value in row) + ";" for row in at), end=" ")
        print(f"{HALF_TURN} degrees at t = {half:.3f}", flush=True)

    print("holes: uptake in %, rotation of the core in degrees at t =", *wanted)
    for size, hole in sizes:
        found = Swelling(plate_mesh(plate, 3, size, hole), gel, 3, START)
        start, now, rows = found.ratio(), 0.0, []
        for end in times:
            found.step(end - now, np.array([BATH, BATH]))
            now = end
            rows.append((found.ratio() - start, found.rotation((1e-3, 1e-3))))
        show(f"elements of {hole} at outlines", *np.array(rows).T)
    for spacing in spacings:
        model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing))
        path = jaxgel.swell(jaxgel.Problem(model, gel, contact=False), BATH, times, start=START)
        ratio = mean_ratio(path)
        show(f"spacing {spacing}", (ratio - ratio[0])[1:], np.asarray(core_rotation(path))[1:])


def by_elements(mesh, gel, start, bath, times, wanted, points):
    """Rows at the start, at ``wanted`` times and in equilibrium.

    A row has the mean volume ratio and the positions of ``points``.
    """
    from ngsolve_swelling import GAMMA, Swelling

    found, now, rows = Swelling(mesh, gel, 3, start), 0.0, []

    def row():
        return [
            found.ratio(),
            *np.ravel([found.position((1 - 1e-9) * np.array(point)) for point in points]),
        ]

    rows.append(row())
    for end in times:
        found.step(end - now, bath.at(np.array([now + GAMMA * (end - now), end])))
        now = end
        if np.any(np.isclose(end, wanted, rtol=1e-12)):
            rows.append(row())
    for _ in range(3):
        found.step(100.0, bath.at(np.array([100.0, 100.0])))
    return [*rows, row()]


@styled
def gradient(spacing, count):
    """Cost and error of a gradient."""
    plate = jaxgel.sample("sample-1")
    cloud = jaxgel.make_cloud(plate, spacing=spacing)
    theta, holes_of = ravel_pytree(
        [dict(centre=o.centre, semi_axes=o.semi_axes, angle=o.angle) for o in plate.holes]
    )
    values = np.concatenate([theta, np.zeros(60 - len(theta))])

    def rotation(values):
        model = jaxgel.discretise(cloud.at(plate.at(holes_of(jnp.asarray(values[: len(theta)])))))
        waves = values[len(theta) :]
        stiffness = jaxgel.WithHoles(
            lambda X: 1e-3 * (1 + waves @ jnp.cos(jnp.arange(len(waves)) * X[0] / 5))
        )
        problem = jaxgel.Problem(model, jaxgel.Gel(stiffness, 1e-4), contact=False)
        return core_rotation(
            jaxgel.swell(problem, BATH, np.geomspace(1e-3, 1.0, count), start=START)
        )[-1]

    both = jax.value_and_grad(rotation)
    first, (_, slopes) = seconds(lambda: jax.block_until_ready(both(jnp.asarray(values))))
    whole, _ = seconds(lambda: jax.block_until_ready(both(jnp.asarray(values))))
    run = min(seconds(lambda: rotation(values))[0] for _ in range(2))
    print(
        f"{len(cloud.nodes)} nodes, {count} steps: {whole / run - 1:.2f} runs of {run:.1f} s; "
        f"first with its run {first:.0f} s"
    )
    slopes = np.asarray(slopes)
    for name, part, size in (
        ("holes", slice(0, len(theta)), 1.0),
        ("field", slice(len(theta), 60), 0.05),
    ):
        direction = np.zeros(60)
        direction[part] = size * np.random.default_rng(0).normal(size=60)[part]
        errors = []
        for h in (1e-3, 1e-4, 1e-5):
            quotient = (rotation(values + h * direction) - rotation(values - h * direction)) / (
                2 * h
            )
            errors.append(f"{slopes @ direction / float(quotient) - 1:+.1e}")
        print(f"  by {name}, steps 1e-3, 1e-4, 1e-5: {' '.join(errors)}")


def draw(file, spacing, per_decade):
    """The figure of sample 1."""
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.sample("sample-1"), spacing=spacing))
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 1e-4), contact=False)
    path = jaxgel.swell(
        problem, BATH, jaxgel.TimeSteps(100.0, first=1e-3, per_decade=per_decade), start=START
    )
    figure = plt.figure(figsize=(9.3, 5.0), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.06, 1))
    plot_patterns(path, [0.01, 0.1, 1.0, 10.0], axes=above.subplots(1, 4, sharey=True), field="mu")
    left, right = below.subplots(1, 2)
    share = 100 * np.asarray(jaxgel.uptake_fraction(path, jaxgel.sweep(problem, [BATH])))
    ratio = np.asarray(mean_volume_ratio(path))
    law = 100 * HALF_SPACES / ((ratio[-1] - ratio[0]) * 100 / share[-1])
    left.plot(
        np.sqrt(path.t), share, marker="o", markersize=2.5, color=COLOURS[0], label="sample 1"
    )
    left.plot(
        [0, 2.2],
        [0, 2.2 * law],
        color=LINE,
        linewidth=0.8,
        linestyle="--",
        label="half-spaces along the outlines",
    )
    left.set(
        xlabel=r"$\sqrt{Dt}$ (mm)",
        ylabel="uptake over that in equilibrium (%)",
        xlim=(0, 6),
        ylim=(0, 104),
    )
    left.legend(frameon=False, fontsize=7.5, loc="lower right")
    plot_curve(path, "rotation", ax=right)
    half = core_rotation(path)[-1] / 2
    time_of_half = float(jaxgel.time_to(path, "core_rotation", half))
    right.plot(
        [right.get_xlim()[0], time_of_half, time_of_half],
        [half, half, 0],
        color=LINE,
        linewidth=0.7,
        linestyle=":",
    )
    right.plot(time_of_half, half, "o", color=COLOURS[1], markersize=5)
    text = f"half at $Dt = {time_of_half:.2f}$ mm²"
    right.annotate(
        text, (time_of_half, half), xytext=(-8, 4), textcoords="offset points", ha="right"
    )
    right.plot([], [], color=WALL, linewidth=0.9, linestyle=MARKS["crease"], label="crease limit")
    right.legend(frameon=False, fontsize=7.5)
    right.set(xlabel=r"$Dt$ (mm²)", ylim=(0, None))
    figure.savefig(file, dpi=140)


def seconds(function):
    """Seconds of a call, and its result."""
    first = time.perf_counter()
    result = function()
    return time.perf_counter() - first, result


if __name__ == "__main__":
    main()
