"""Influence of range and stiffness of contact: the lattice and samples 4 and 7 past contact.

The plates are those of Deng et al. (2020).

    python benchmarks/contact.py [--cases sample-7] [--spacing 0.55] [--rows range seal cylinders]
    [--out cylinders.png]

The two are numerical, so a result should not depend on them: each line has another share of the
defaults (range 1/80 of the side, kappa 10 Nv) and prints, at the last mu, the range in mm, the core
rotation in degrees, the energy in kT/v mm^2, contact's share of it, the area reduction, the
smallest gap within a hole over the range, and the seconds that the sweep took. The row ``seal``
squeezes a nearly incompressible block, bonded below, by a flat punch to 40 per cent of its height,
on three clouds; its finite elements are ``seal_elements.py``. The row ``cylinders`` swells a gel
between fixed cylinders: mu, the force on one, kT/v mm, and the largest principal tension and
pressure in the gel, kT/v.
"""  # fmt: skip

import argparse
import time

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import jaxgel
from jaxgel.mechanics import RANGE, STIFFNESS, contact_energy, with_contact
from jaxgel.plotting import plot_patterns

# kT; the sides meet at -0.53
SQUARES = (-4.9678, -3.5, -2.5, -1.6, -1.1, -0.8, -0.65, -0.55, -0.5, -0.45, -0.42, -0.4)
# at -0.41
CIRCLES = (
    -4.9678, -3.5, -2.5, -1.6, -1.1, -0.8, -0.65, -0.55, -0.5, -0.45, -0.4, -0.37, -0.35, -0.33,
)  # fmt: skip
LATTICE = (
    -4.9678, -3.9678, -3.4678, -3.2, -3.0, -2.4678, -1.4678, -0.9678, -0.6678, -0.4678, -0.3678,
    -0.3178, -0.29, -0.275, -0.27,
)  # at -0.28  # fmt: skip
MU = {"lattice": LATTICE, "sample-4": CIRCLES, "sample-7": SQUARES}
# shares of the default range and stiffness
CASES = ((1.0, 1.0), (0.5, 1.0), (0.25, 1.0), (1.0, 3.0), (1.0, 1 / 3))


def main():
    mpl.use("Agg")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--cases", nargs="+", default=list(MU), choices=list(MU), help="plates (all)"
    )
    parser.add_argument(
        "--spacing", type=float, help="distance of the nodes in mm (the sample's own)"
    )
    parser.add_argument(
        "--rows", nargs="+", default=["range"], choices=ROWS, help="what is run (range)"
    )
    parser.add_argument("--out", default="cylinders.png", help="picture of the row cylinders")
    options = parser.parse_args()
    for name in options.rows:
        ROWS[name](options)


def ranges(options):
    """The range and the stiffness of contact."""
    print(
        f"{'plate':>9}{'range':>8}{'kappa/Nv':>9}{'core':>8}{'energy':>11}{'share':>9}"
        f"{'area red.':>10}{'gap/range':>10}{'s':>6}"
    )
    for name in options.cases:
        plate = jaxgel.sample(name)
        cloud = (
            jaxgel.make_cloud(plate)
            if options.spacing is None
            else jaxgel.make_cloud(plate, spacing=options.spacing)
        )
        for range_share, stiffness_share in CASES:
            reach, kappa = range_share * RANGE * plate.height, stiffness_share * STIFFNESS
            model = with_contact(
                jaxgel.discretise(cloud), plate.gel, range=reach, stiffness=kappa * plate.gel.Nv
            )
            start = time.perf_counter()
            path = jaxgel.sweep(jaxgel.Problem(model, plate.gel), MU[name])
            seconds = time.perf_counter() - start
            if not path.stop.ok:
                print(f"{name:>9}{reach:8.4f}{kappa:9.2f}  {path.stop_text}", flush=True)
                continue
            core, area, gap = (
                f(path)[-1] for f in (jaxgel.core_rotation, jaxgel.area_reduction, jaxgel.min_gap)
            )
            share = float(
                contact_energy(path.x[-1], path.problem.touching(path.x[-1]).model)
            ) / abs(float(path.energy[-1]))
            print(
                f"{name:>9}{reach:8.4f}{kappa:9.2f}{core:8.3f}{path.energy[-1]:11.4f}{share:9.1e}"
                f"{area:10.5f}{gap / reach:10.3f}{seconds:6.0f}",
                flush=True,
            )


SEAL = jaxgel.Gel(Nv=1e-2, chi=0.1)
SEAL_MU, SEAL_RANGE, STROKES = -8.0, 0.02, np.linspace(0.0, 0.6, 13)  # kT, mm, mm


def seal_plate(spacing):
    """Half of a block of 2 x 1 mm, bonded below, mirrored on the left, between two plates.

    The plate below is for what folds over.
    """
    reach = 0.5 + 1.01 * SEAL_RANGE
    plates = [
        jaxgel.HalfPlane((0.0, reach), (0.0, -1.0)),
        jaxgel.HalfPlane((0.0, -reach), (0.0, 1.0)),
    ]
    edges = {"left": "roller", "bottom": "fixed", "right": "free", "top": "free"}
    return jaxgel.Plate(1.0, 1.0, edges=edges, obstacles=plates, spacing=spacing, gel=SEAL)


def seal(_):
    """Stroke and force of a seal; J is 1.0001."""
    columns = []
    for spacing in (0.2, 0.1, 0.05):
        model = jaxgel.discretise(jaxgel.make_cloud(seal_plate(spacing)))
        problem = jaxgel.Problem(
            model, SEAL, control=jaxgel.Punch((0.0, -1.0), mu=SEAL_MU), contact_range=SEAL_RANGE
        )
        start = time.perf_counter()
        path = jaxgel.sweep(problem, STROKES.tolist())
        columns.append(np.asarray(jaxgel.obstacle_force(path))[:, 0, 1])
        print(
            (
                f"spacing {spacing}: {model.n_nodes} nodes, {time.perf_counter() - start:.0f} s, "
                f"{path.stop_text}"
            ),
            flush=True,
        )
    for k, stroke in enumerate(STROKES):
        print(
            f"{stroke:6.2f}"
            + "".join(
                f"{column[k]:11.6f}" if k < len(column) else f"{'-':>11}" for column in columns
            )
        )


CYLINDERS = jaxgel.Gel(Nv=1e-2, chi=0.1)
SWELLING = (-3.0, -1.0, -0.5, -0.3, -0.2, -0.15, -0.1, -0.05)  # kT
RADII, CLEARANCE = (0.3, 0.1), 0.1  # mm, of the cylinders, and their distance from the dry gel


def cylinders(options):
    """A quarter of a square gel, 2 mm wide, between four fixed cylinders on its axes.

    After Plummer et al. 2024, arXiv 2307.11827.
    """
    figure, axes = plt.subplots(len(RADII), 3, figsize=(8.0, 5.4), layout="constrained")
    for radius, row in zip(RADII, axes, strict=True):
        away = 0.5 + CLEARANCE + radius
        pins = [jaxgel.Disc((-0.5, away), radius), jaxgel.Disc((away, -0.5), radius)]
        edges = {"left": "roller", "bottom": "roller", "right": "free", "top": "free"}
        plate = jaxgel.Plate(1.0, 1.0, edges=edges, obstacles=pins, spacing=options.spacing or 0.05)
        model = jaxgel.discretise(jaxgel.make_cloud(plate))
        path = jaxgel.sweep(jaxgel.Problem(model, CYLINDERS, contact_range=0.02), SWELLING)
        stress = np.asarray(jaxgel.observables.cauchy_stress(path))
        xx, yy, xy = np.moveaxis(stress, -1, 0)
        mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        force = np.asarray(jaxgel.obstacle_force(path))[:, 0, 1]
        print(f"radius {radius} mm: {path.stop_text}")
        print("      mu     force   tension  pressure")
        for mu, one, most, least in zip(
            path.mu, force, (mean + half).max(axis=1), (mean - half).min(axis=1), strict=True
        ):
            print(f"{mu:8.3f}{one:10.5f}{most:10.5f}{-least:10.5f}", flush=True)
        shown = [SWELLING[1], SWELLING[4], path.mu[-1]]
        plot_patterns(path, shown, axes=row)
    figure.savefig(options.out, dpi=150)


ROWS = {"range": ranges, "seal": seal, "cylinders": cylinders}


if __name__ == "__main__":
    main()
