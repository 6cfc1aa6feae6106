"""Refined finite elements (NGSolve), references of ``accuracy.py``: writes references.json.

Extra ``[bench]``.

    python benchmarks/references.py [sample-1 sample-2 sample-3 sensitivities]

Samples 1-3 along the stable branch: rotation of the core and of the midline, energy. Sample 1:
derivatives of both rotations with respect to its geometry and its gel, by central differences of
states that are solved anew on a morphed mesh. Each value is that of the first of `MESHES`; the
spread beside it is the largest difference that the others make. The critical mu are those of
``finite_elements.py``.
"""  # fmt: skip

import argparse
import dataclasses
import functools
import json
import time
from pathlib import Path

import ngsolve as ng
import numpy as np
from finite_elements import START, Mesh, compact, stops, with_spread
from ngsolve_gel import MixedGel, plate_mesh

from jaxgel import sample

FILE = Path(__file__).with_name("references.json")
MESHES = (Mesh(5, 1.0, 0.12), Mesh(4, 1.2, 0.25))
# kT
MU = (
    -4.9678, -4.4678, -3.9678, -3.4678, -2.9678, -2.4678, -1.9678, -1.7178, -1.4678, -1.4178,
    -1.2178, -1.0678, -0.9678, -0.9178,
)  # fmt: skip
# mu up to which all meshes keep the smooth branch, kT
LAST = {"sample-1": -0.9178, "sample-2": -1.0678, "sample-3": -1.4178}
OBSERVED = {
    "core": lambda gel: abs(gel.core_rotation()),
    "midline": lambda gel: abs(gel.midline_rotation()),
    "energy": MixedGel.energy,
}
AT = -1.4678  # mu of the sensitivities, kT
STEPS = {  # differences of the parameters to either side: mm, radians, 1
    "long semi-axis": 0.01,
    "short semi-axis": 0.01,
    "tilt": 0.005,
    "x of hole 0": 0.01,
    "y of hole 0": 0.01,
    "Nv": 2e-5,
    "chi": 5e-5,
}


def main(names):
    known = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    for name in names or (*LAST, "sensitivities"):
        known[name] = sensitivities() if name == "sensitivities" else curve(name)
        content = {
            "about": (
                f"`python benchmarks/references.py` with NGSolve {ng.__version__}: mixed elements, "
                "the pressure of one order less; the spread is the largest difference to other "
                "meshes, of sensitivities also to twice the step. Core: polar rotation at the "
                "plate's centre; midline: the paper's angle, of the highest and lowest point of "
                "the deformed line y = 0."
            ),
            "units": (
                "mu kT, rotations degrees, energy kT/v mm^2; sensitivities degrees per mm, per "
                "radian (tilt), per 1 (Nv, chi)"
            ),
            **{key: known[key] for key in (*LAST, "sensitivities") if key in known},
        }
        FILE.write_text(compact(content), encoding="utf-8")


def curve(name):
    """Observed values of a sample along its stable branch, with their spread."""
    results, sizes = [], []
    wanted = [mu for mu in MU if mu <= LAST[name]]
    # smaller steps where the surface is strongly compressed
    path = sorted({*wanted, *np.arange(AT, LAST[name], 0.05).round(4).tolist()})
    for mesh in MESHES:
        gel = MixedGel(*meshed(sample(name), mesh), steps=4)
        rows = [
            [value(gel) for value in OBSERVED.values()]
            for mu in gel.follow(stops(START, path))
            if mu in wanted
        ]
        results.append(
            {"mu": wanted} | dict(zip(OBSERVED, map(list, zip(*rows, strict=True)), strict=True))
        )
        sizes.append(size_of(mesh, gel))
        print(f"{name}, {sizes[-1]}: {results[-1]}", flush=True)
    return with_spread(results) | {"mesh": f"{sizes[0]}; spread: {'; '.join(sizes[1:])}"}


def meshed(plate, mesh):
    """The arguments of ``MixedGel`` for a plate: itself, its mesh and the order."""
    return plate, plate_mesh(plate, mesh.order, mesh.plate, mesh.hole), mesh.order


def size_of(mesh, gel):
    return f"P{mesh.order}, {gel.mesh.ne} curved triangles, {gel.free_dofs} free displacements"


def solved(mesh, mu):
    """Sample 1 in equilibrium at ``mu`` on a mesh."""
    gel = MixedGel(*meshed(sample("sample-1"), mesh), steps=4)
    for _ in gel.follow(stops(START, [mu])):
        pass
    return gel


def sensitivities():
    """Derivatives of the amounts of both rotations of sample 1 at ``AT``, a dict.

    {"core": {parameter: value}, "midline": ..., "spread": ...}.
    """
    results, sizes = [], []
    for mesh in MESHES:
        gel = solved(mesh, AT)
        sizes.append(size_of(mesh, gel))
        for factor in (1, 2):
            begin = time.perf_counter()
            found = {name: derivative(gel, name, factor * step) for name, step in STEPS.items()}
            results.append(
                {
                    kind: {name: values[k] for name, values in found.items()}
                    for k, kind in enumerate(("core", "midline"))
                }
            )
            print(
                (
                    f"{sizes[-1]}, steps x {factor}, {time.perf_counter() - begin:.0f} s: "
                    f"{results[-1]}"
                ),
                flush=True,
            )
    return (
        {"mu": AT} | with_spread(results) | {"mesh": f"{sizes[0]}; spread: {'; '.join(sizes[1:])}"}
    )


def derivative(gel, name, step):
    """Central differences (2,) of the amounts of core and midline rotation, degrees."""
    ahead, behind = (rotations(gel, name, sign * step) for sign in (1, -1))
    return (np.sign(ahead) * (ahead - behind) / (2 * step)).tolist()


def rotations(gel, name, change):
    """Core and midline rotation (2,), degrees, in the equilibrium near ``gel``.

    One parameter has changed.
    """
    if name in ("Nv", "chi"):
        material = dataclasses.replace(
            gel.plate.gel, **{name: getattr(gel.plate.gel, name) + change}
        )
        changed = MixedGel(
            dataclasses.replace(gel.plate, gel=material), gel.mesh, gel.order, steps=4
        )
    else:
        changed = MorphedGel(gel, functools.partial(moved, name=name, change=change))
    changed.state.vec.data = gel.state.vec
    changed.equilibrium(AT)
    found = np.array([changed.core_rotation(), changed.midline_rotation()])
    gel.mesh.UnsetDeformation()
    return found


def moved(hole, index, name, change):
    """An ellipse after one parameter of the plate has changed."""
    a, b = map(float, hole.semi_axes)
    x, y = map(float, hole.centre)
    return {
        "long semi-axis": lambda: dataclasses.replace(hole, semi_axes=(a + change, b)),
        "short semi-axis": lambda: dataclasses.replace(hole, semi_axes=(a, b + change)),
        "tilt": lambda: dataclasses.replace(hole, angle=float(hole.angle) + change),
        "x of hole 0": lambda: dataclasses.replace(hole, centre=(x + change * (index == 0), y)),
        "y of hole 0": lambda: dataclasses.replace(hole, centre=(x, y + change * (index == 0))),
    }[name]()


class MorphedGel(MixedGel):
    """A ``MixedGel`` on the mesh of another, moved with the outlines of its ellipses.

    The motion is harmonic between them. ``motion(hole, index)`` is the moved hole. The mesh stays
    moved, for the other gel too, until its ``UnsetDeformation``.
    """

    def __init__(self, gel, motion):
        self.motion = ng.GridFunction(ng.VectorH1(gel.mesh, order=gel.order, dirichlet=".*"))
        self._extend(gel.plate, motion)
        gel.mesh.SetDeformation(self.motion)
        super().__init__(gel.plate, gel.mesh, gel.order, steps=4)
        # a longer ellipse cuts the midline at 5 mm; the extrema are at 4.13 mm
        self.midline = gel.midline[np.abs(gel.midline) < 4.5]

    def _extend(self, plate, motion):
        """Motion of the mesh: that of the outlines, 0 on the edges, harmonic in between."""
        shift = ng.CF((0, 0))
        for index, hole in enumerate(plate.holes):
            centre, to_circle = frame(hole)
            arm = ng.CF((ng.x, ng.y)) - ng.CF(tuple(centre))
            new_centre, new_to_circle = frame(motion(hole, index))
            # the outline's affine image
            image = (
                ng.CF(tuple(new_centre)) + matrix(np.linalg.inv(new_to_circle) @ to_circle) * arm
            )
            inside = ng.Norm(matrix(to_circle) * arm) - (1 + 1e-3)
            shift += ng.IfPos(inside, 0, 1) * (image - ng.CF((ng.x, ng.y)))
        space = self.motion.space
        self.motion.Set(shift, definedon=space.mesh.Boundaries("hole"), dual=True)
        u, v = space.TnT()
        form = ng.BilinearForm(ng.InnerProduct(ng.Grad(u), ng.Grad(v)) * ng.dx).Assemble()
        residual = (-form.mat * self.motion.vec).Evaluate()
        self.motion.vec.data += (
            form.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky") * residual
        )

    def points(self, x, y):
        """Points of the mesh (m,) that the motion brings to ``x`` and ``y`` (m,), mm.

        The mesh finds points where it was before.
        """
        target = np.stack([x, y], axis=1)
        dry = target.copy()
        for _ in range(8):
            dry = target - self.motion(self.mesh(*dry.T))
        return self.mesh(*dry.T)


def frame(ellipse):
    """Centre (2,) of an ellipse and the matrix (2, 2) from the arm to the unit circle."""
    c, s = np.cos(float(ellipse.angle)), np.sin(float(ellipse.angle))
    return np.array(ellipse.centre, float), np.array([[c, s], [-s, c]]) / np.array(
        ellipse.semi_axes, float
    )[:, None]


def matrix(A):
    return ng.CF(tuple(np.ravel(A)), dims=(2, 2))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(LAST)}, sensitivities (all)"
    )
    names = parser.parse_args().names
    if unknown := set(names) - {*LAST, "sensitivities"}:
        parser.error(f"unknown name {', '.join(unknown)}")
    main(names)
