"""The best designs of two studies beside finite elements (NGSolve, extra ``[bench]``).

After ``jaxgel design design/printed.toml`` and ``jaxgel design design/cushion.toml``.

    python benchmarks/studies.py out/printed/best.toml out/cushion/best.toml

For each design file the number that the study is about, by jaxgel on the cloud of the verification
and by finite elements: at each mu of the study the rotation of the midline of a plate, degrees,
with the largest ratio of normal to tangential stretch on the holes, as far as finite elements have
a smooth state, up to about Biot's ratio of 3.4; or the distance of the free edges of a film from
the target outline, root mean square and largest, over the width of the film, of which the plate is
a quarter.
"""  # fmt: skip

import argparse
import dataclasses
import sys
from pathlib import Path

import jax
import ngsolve as ng
import numpy as np
import shapely
from finite_elements import START, Mesh, stops
from ngsolve_gel import plate_mesh
from printed import FilledGel, FilmGel, Material

import jaxgel
from jaxgel.cases import load_case

SAMPLES = 401  # along each side of the plate, of a field that is given to NGSolve
STUDIES = Path(__file__).parents[1] / "design"
STEPS = 0.05  # of mu between states, kT


def main(files):
    for file in files:
        case = load_case(file)
        film = case.plate.kinematics == "plane stress"
        path = case.path(case.model())
        elements = meshes(case, Mesh(4, 0.05, 0.05) if film else Mesh(4, 1.0, 0.2))
        wanted = [round(float(mu), 5) for mu in path.mu]
        angles = np.abs(np.asarray(jaxgel.rotation_angle(path)))
        for mu in reached(elements, through(wanted)):
            if mu in wanted and not film:
                own, other, surface = (
                    angles[wanted.index(mu)],
                    abs(elements.midline_rotation()),
                    elements.outlines()[2].max(),
                )
                difference = 100 * (own / other - 1)
                print(
                    f"{file}: mu {mu:.4f}: {own:.2f} degrees, NGSolve {other:.2f}, difference "
                    f"{difference:.2f} %; surface {surface:.1f}"
                )
        if film:
            points = (
                np.asarray(path.x[-1])[free_nodes(path.model)],
                free_points(elements, case.plate),
            )
            own, other = (distances(one) / (2 * case.plate.width) for one in points)
            print(
                f"{file}: free edges off by {shares(own)} of the film's width, NGSolve "
                f"{shares(other)}"
            )


def reached(elements, values):
    """The values of mu up to which finite elements have a state."""
    try:
        yield from elements.follow(values)
    except RuntimeError as lost:
        print(lost)


def shares(distances):
    return f"{100 * np.sqrt(np.mean(distances**2)):.2f} % (largest {100 * distances.max():.2f} %)"


def meshes(case, mesh):
    """Finite elements of a case whose Nv is a field."""
    plate, gel = case.plate, case.gel
    made = plate_mesh(dataclasses.replace(plate, regions=()), mesh.order, mesh.plate, mesh.hole)
    w, h = plate.width / 2, plate.height / 2
    x, y = np.meshgrid(np.linspace(-w, w, SAMPLES), np.linspace(-h, h, SAMPLES))
    values = np.asarray(jax.vmap(gel.Nv)(np.stack([x.ravel(), y.ravel()], axis=1))).reshape(
        SAMPLES, SAMPLES
    )
    Nv = ng.VoxelCoefficient((-w, -h), (w, h), values, linear=True)
    own = dataclasses.replace(plate, gel=Material(Nv, gel.chi, ng.CF(0)))
    return (
        FilmGel(own, made, mesh.order)
        if plate.kinematics == "plane stress"
        else FilledGel(own, made, mesh.order, steps=4)
    )


def through(wanted):
    """The ``wanted`` values of mu in steps of at most `STEPS`, refined towards the pure solvent."""
    last = wanted[-1]
    more = [
        *np.arange(-2.0, min(last, -0.1), STEPS).round(5),
        *(mu for mu in (-0.1, -0.05, -0.02, -0.01, -0.005) if mu < last),
    ]
    return stops(START, sorted({*wanted, *map(float, more)}))


def free_nodes(model):
    topology = model.lists.topology
    free = [
        topology.edge_nodes[edge]
        for edge, condition in topology.plate.edges.items()
        if condition == "free"
    ]
    return np.unique(np.concatenate(free))


def free_points(elements, plate, count=200):
    """Deformed points of the right and the upper edge."""
    along = np.linspace(-0.5, 0.5, count)
    x = np.concatenate([np.full(count, plate.width / 2), plate.width * along])
    y = np.concatenate([plate.height * along, np.full(count, plate.height / 2)])
    inside = 1 - 1e-9
    return np.stack([x, y], axis=1) + elements.u(elements.points(inside * x, inside * y))


def distances(points):
    """Of ``points`` (p, 2) from the target outline of the cushion, mm."""
    sys.path.insert(0, str(STUDIES))
    from cushion import outline

    return shapely.distance(shapely.points(points), shapely.LineString(outline(401)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "files", nargs="+", metavar="BEST.toml", help="best.toml of a study's folder"
    )
    main(parser.parse_args().files)
