"""The tables of the how-to pages: python benchmarks/howto.py [--quick] [rotations] [cell] [box]

``rotations`` is sample 1 by spacing and basis (docs/howto/discretisation.md); ``cell`` is the onset
of buckling of the periodic cell of 2 x 2 holes, the lattice without end, by spacing
(docs/howto/boundary.md); ``box`` is the lowest eigenvalue of a gel without holes by its pressure,
and the pressures in three samples (docs/howto/trust.md). Without names all. ``--quick`` has the
first row of each alone.
"""

import argparse

import numpy as np

import jaxgel

MU = [-2.9678, -1.9678, -1.4678, -0.9678]
ROWS = [dict(spacing=spacing) for spacing in (1.1, 22 / 30, 0.55, 22 / 60)] + [dict(basis="linear")]
SPACINGS = (0.2, 0.125, 0.1, 1 / 12, 0.0625)  # mm
PRESSURES = (60, 45, 40, 20, 0, -200, -400, -600, -800)  # Nv


def rotations(rows):
    """Rotation of sample 1's midline, degrees."""
    plate = jaxgel.sample("sample-1")
    print("nodes  " + " ".join(f"{mu:9.4f}" for mu in MU))
    for options in ROWS[:rows]:
        spacing = options.get("spacing")
        model = jaxgel.discretise(
            jaxgel.make_cloud(plate, spacing=spacing),
            **{k: v for k, v in options.items() if k != "spacing"},
        )
        angles = jaxgel.rotation_angle(jaxgel.sweep(jaxgel.Problem(model, plate.gel), MU))
        print(
            f"{len(model.cloud.nodes):5d}  "
            + " ".join(f"{angle:9.3f}" for angle in np.asarray(angles)),
            options,
            flush=True,
        )


def cell(rows):
    """First critical mu of the periodic cell, kT."""
    holes = [jaxgel.Circle((x, y), 0.9) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    print("spacing  nodes  onset")
    for spacing in SPACINGS[:rows]:
        plate = jaxgel.Plate(4, 4, holes, edges="periodic")
        model = jaxgel.discretise(
            jaxgel.make_cloud(plate, spacing=spacing, nodes_per_hole=round(4 / spacing))
        )
        (point, *_) = jaxgel.critical_points(
            jaxgel.Problem(model, jaxgel.Gel(Nv=1e-3, chi=1e-5)), (-5.0, -2.0), most=1
        )
        print(f"{spacing:7.4f}  {len(model.cloud.nodes):5d}  {point.mu:.4f}", flush=True)


def box(rows):
    """Lowest eigenvalue, over the network's stiffness, of a deformed rectangle by p / Nv."""
    gel, F = jaxgel.Gel(Nv=1e-3, chi=1e-4), ((1.2, 0.2), (0.1, 0.9))
    # mu at which there is no pressure
    without = float(jaxgel.materials.osmotic(np.linalg.det(F), 0.0, gel))
    print("spacing  " + " ".join(f"{p:6d}" for p in PRESSURES))
    for spacing in (0.5, 0.25)[:rows]:
        model = jaxgel.discretise(
            jaxgel.make_cloud(jaxgel.Plate(4, 3, edges="fixed", deformation=F), spacing=spacing)
        )
        paths = [
            jaxgel.sweep(
                jaxgel.Problem(model, gel, contact=False),
                [without - p * gel.Nv],
                branch="symmetric",
                eigenvalues=True,
            )
            for p in PRESSURES
        ]
        print(
            f"{spacing:7.2f}  " + " ".join(f"{path.lowest_eigenvalue[0]:6.2f}" for path in paths),
            flush=True,
        )
    for name in ("sample-1", "sample-4", "sample-7")[:rows]:
        plate = jaxgel.sample(name)
        path = jaxgel.sweep(
            jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate)), plate.gel),
            [*MU[:-1], -0.9178],
        )
        p = path.pressure[:, path.model.carries] / plate.gel.Nv
        print(f"{name}: p / Nv from {p.min():.2f} to {p.max():.2f}", flush=True)


if __name__ == "__main__":
    tables = {"rotations": rotations, "cell": cell, "box": box}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="TABLE", help=f"of {', '.join(tables)} (all)")
    parser.add_argument("--quick", action="store_true", help="the first row of each alone")
    options = parser.parse_args()
    for name in options.names or tables:
        tables[name](1 if options.quick else None)
