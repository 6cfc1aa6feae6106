"""The barrier of design/bistable.py beside finite elements (NGSolve, extra ``[bench]``).

It takes two meshes and a few minutes.

    python benchmarks/barrier.py

The straight state is the symmetric branch of a mesh with the plate's mirror lines, the turned one
is entered where that branch loses its stability; the barrier is the difference of their energies,
beside the values of design/verified.json.
"""  # fmt: skip

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
from finite_elements import PAST, START, Mesh, critical, enter
from ngsolve_gel import MixedGel, plate_mesh

STUDIES = Path(__file__).parents[1] / "design"
MESHES = (Mesh(5, 2.0, 0.9), Mesh(4, 2.0, 0.8))
STEP = 0.04  # of mu between states, kT


def main():
    sys.path.insert(0, str(STUDIES))
    import bistable

    record = json.loads((STUDIES / "verified.json").read_text(encoding="utf-8"))["bistable"]
    found = record["parameters"]
    plate = dataclasses.replace(bistable.plate(found), gel=bistable.gel(found))
    for mesh in MESHES:
        height, unstable = barrier(plate, bistable.MU, mesh)
        print(
            f"P{mesh.order}, {mesh.plate} mm: barrier {height:.4e} kT/v mm^2, the saddle has "
            f"{unstable} negative eigenvalues"
        )
        for key in ("search", "best"):
            own = record[key]["reported"]["barrier"]
            print(f"  jaxgel, {key}: {own:.4e}, difference {100 * (own / height - 1):.2f} %")


def barrier(plate, mu, mesh):
    """Energy difference of straight and turned state, kT/v mm^2, and the straight one's index.

    The index is the number of negative eigenvalues.
    """
    gel = MixedGel(
        plate, plate_mesh(plate, mesh.order, mesh.plate, mesh.hole, folds=1), mesh.order, steps=4
    )
    at = critical(gel)["critical_mu"]
    enter(gel, at)
    turned = energy(gel, at + PAST[-1], mu)
    gel.state.vec[:] = 0
    straight = energy(gel, START, mu)
    return straight - turned, gel.modes()[0]


def energy(gel, first, last):
    """At the ``last`` mu, followed from the present state by way of the ``first``."""
    for _ in gel.follow(np.linspace(first, last, int(np.ceil((last - first) / STEP)) + 1)):
        pass
    return gel.energy()


if __name__ == "__main__":
    main()
