"""Graded gels, inclusions and films: sample 1 by jaxgel beside refined finite elements.

By NGSolve, extra ``[bench]``.

    python benchmarks/printed.py [graded film "graded film" stiff soft "stiff film" "soft film"]
    [--spacing 0.39]

One row per case and mu: the core rotation of both, their relative difference, the spread of the
finite elements between the two of `MESHES`, the negative eigenvalues of both tangents, and the
surface ratio, the largest of normal to tangential stretch on the outlines by finite elements. The
gel of the graded cases is stiffer on the right: Nv = 1e-3 (1 + sin(2 pi x / width) / 2). Films are
in plane stress. The stiff inclusion is an elastomer, the soft one a gel with less cross-links;
either is an ellipse in the middle of the plate.

In plane strain the finite elements are followed up to Biot's surface ratio of 3.4, that of an
incompressible solid; these gels wrinkle from 3.3 on. Beyond it there is no smooth state that
refinement converges to: the finer the mesh, the earlier it is lost. So there is nothing to compare
with, and the row says "-". The graded gel passes 3.4 at mu of -1.29 to -1.23, by mesh, at the end
of an ellipse on its soft side. Contact is off: no sides of holes meet at these mu.
"""  # fmt: skip

import argparse
import dataclasses
import math
import time

import jax.numpy as jnp
import ngsolve as ng
import numpy as np
from finite_elements import START, Mesh, stops
from ngsolve_gel import MixedGel
from references import meshed, size_of

import jaxgel

MU = (-2.5, -1.4678, -1.3178, -0.9178)  # kT
# also gone through, where the surface is strongly compressed, kT
SMALL_STEPS = np.arange(-1.4678, MU[-1], 0.05).round(4)
MESHES = (Mesh(5, 1.5, 0.3), Mesh(4, 1.2, 0.25))
SPACING = 22 / 56  # mm, about 1800 nodes
TARGET = 0.5  # %
BIOT = 3.4  # surface ratio
SAMPLE = jaxgel.sample("sample-1")
FILM = dataclasses.replace(SAMPLE, kinematics="plane stress")
INCLUSION = jaxgel.Ellipse((0.0, 0.0), (1.5, 0.8), 0.6)
FILLED = [dataclasses.replace(plate, regions=[INCLUSION]) for plate in (SAMPLE, FILM)]
STIFF, SOFT = (
    jaxgel.Composite(SAMPLE.gel, (own,))
    for own in (jaxgel.Elastomer(Nv=0.1, bulk=10.0), jaxgel.Gel(Nv=3e-4, chi=0.2))
)
GRADED = jaxgel.Gel(Nv=lambda X: graded(X[0], jnp.sin))
CASES = {
    "graded": (SAMPLE, GRADED),
    "film": (FILM, SAMPLE.gel),
    "graded film": (FILM, GRADED),
    "stiff": (FILLED[0], STIFF),
    "soft": (FILLED[0], SOFT),
    "stiff film": (FILLED[1], STIFF),
    "soft film": (FILLED[1], SOFT),
}  # name -> plate, gel


def graded(x, sin):
    """Nv at the dry coordinate ``x``, mm, by the sine of either library."""
    return 1e-3 * (1 + 0.5 * sin(2 * math.pi * x / SAMPLE.width))


@dataclasses.dataclass
class Material:
    """Parameters of the gel and of an inclusion on a mesh; ``bulk`` is above 0 in an elastomer."""

    Nv: object
    chi: object
    bulk: object


def material(gel, mesh):
    """`Material` of a gel of numbers, a graded one or one with an inclusion."""
    if gel is GRADED:
        return Material(graded(ng.x, ng.sin), gel.chi, ng.CF(0))
    own, inside = (gel.matrix, gel.regions[0]) if isinstance(gel, jaxgel.Composite) else (gel, gel)
    names = [("Nv", own.Nv), ("chi", own.chi), ("bulk", 0.0)]
    return Material(
        *(
            mesh.MaterialCF({"region0": getattr(inside, name, value)}, default=value)
            for name, value in names
        )
    )


class FilledGel(MixedGel):
    """A gel with an inclusion, which may be an elastomer: p = K (J - 1) - Nv/J."""

    def volumes(self, gel, steps):
        J, compliance = super().volumes(gel, steps)
        passive, K = gel.bulk, ng.IfPos(gel.bulk, gel.bulk, 1.0)
        half = (K + self.p) / (2 * K)
        own = half + ng.sqrt(half**2 + gel.Nv / K)
        return ng.IfPos(passive, own, J), ng.IfPos(passive, 1 / (K + gel.Nv / own**2), compliance)


class FilmGel(MixedGel):
    """Film elements: displacement, and s = ln(J - 1) of one order less, which keeps J above 1.

    In an elastomer it is s = ln(J).

    The energy, with J / det F for the stretch of the thickness, is stationary in both; NGSolve
    differentiates it.
    """

    def __init__(self, plate, mesh, order):
        super().__init__(plate, mesh, order)
        space, gel = self.state.space, plate.gel
        (du, ds), (v, t) = space.TnT()
        self.p.Set(ng.IfPos(gel.bulk, 0.0, START - 1))  # mu = s + 1 close to the dry state
        self.F, s = (ng.Id(2) + ng.Grad(self.u)).MakeVariable(), ng.CF(self.p).MakeVariable()
        self.J = J = ng.IfPos(gel.bulk, 0.0, 1.0) + ng.exp(s)
        network = (
            gel.Nv
            / 2
            * (ng.InnerProduct(self.F, self.F) - 3 + (J / ng.Det(self.F)) ** 2 - 2 * ng.log(J))
        )
        swelling = -(J - 1) * ng.log(1 + ng.exp(-s)) - gel.chi / J - self.mu * (J - 1)
        self.density = network + ng.IfPos(gel.bulk, gel.bulk / 2 * (J - 1) ** 2, swelling)
        first = self.density.Diff(self.F, ng.Grad(v)) + self.density.Diff(s, t)
        self.residual, self.tangent = ng.LinearForm(space), ng.BilinearForm(space, condense=True)
        self.residual += first.Compile() * self.dx
        self.tangent += (first.Diff(self.F, ng.Grad(du)) + first.Diff(s, ds)).Compile() * self.dx

    def energy(self):
        return float(ng.Integrate(self.density * self.dx, self.mesh))


def main(names, spacing):
    begin = time.perf_counter()
    print(
        "core rotation of sample 1 in degrees, difference of jaxgel to NGSolve in % (target "
        f"{TARGET}), spread of NGSolve in %"
    )
    heads = (
        "mu",
        "jaxgel",
        "NGSolve",
        "difference",
        "spread",
        "met",
        "negative",
        "NGSolve's",
        "surface",
    )
    print(f"{'':>12}" + "".join(f"{head:>11}" for head in heads))
    for name in names or CASES:
        plate, gel = CASES[name]
        path, seconds = swept(plate, gel, spacing)
        results = [elements(plate, gel, mesh) for mesh in MESHES]
        angles = np.asarray(jaxgel.core_rotation(path))
        for k, mu in enumerate(MU):
            found = angles[k] if k < len(path) else math.nan
            core, negative, surface = results[0]["rows"].get(mu, (math.nan,) * 3)
            other = results[1]["rows"].get(mu, (math.nan,) * 3)[0]
            difference, spread = 100 * (found / core - 1), 100 * abs(other / core - 1)
            met = "-" if math.isnan(difference) else "yes" if abs(difference) <= TARGET else "NO"
            pivots = path.negative_pivots[k] if k < len(path) else math.nan
            cells = (
                f"{mu:.4f}",
                *map(shown, (found, core, difference, spread)),
                met,
                *(shown(n, 0) for n in (pivots, negative)),
            )
            print(
                f"{name:>12}" + "".join(f"{cell:>11}" for cell in (*cells, shown(surface, 2))),
                flush=True,
            )
        sizes = "; ".join(f"{result['size']}, {result['seconds']:.0f} s" for result in results)
        print(f"{'':>12}   {path.model.n_nodes} nodes, {seconds:.0f} s; {sizes}", flush=True)
    print(f"{time.perf_counter() - begin:.0f} s")


def shown(value, places=4):
    return "-" if math.isnan(value) else f"{value:.{places}f}"


def swept(plate, gel, spacing):
    """Path of jaxgel at `MU`, as far as it goes, and the seconds that model and sweep took."""
    begin = time.perf_counter()
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing))
    return jaxgel.sweep(
        jaxgel.Problem(model, gel, contact=False), list(MU)
    ), time.perf_counter() - begin


def elements(plate, gel, mesh):
    """Finite elements: a dict of "rows" by mu, "size" and "seconds".

    A row has core rotation, negative eigenvalues and surface ratio.
    """
    begin, is_film = time.perf_counter(), plate.kinematics == "plane stress"
    _, made, order = meshed(plate, mesh)
    plate = dataclasses.replace(plate, gel=material(gel, made))
    gel = FilmGel(plate, made, order) if is_film else FilledGel(plate, made, order, steps=4)
    rows = {}
    for mu in gel.follow(stops(START, sorted({*MU, *SMALL_STEPS.tolist()}))):
        surface = gel.outlines()[2].max()
        if not is_film and surface > BIOT:
            break
        if mu in MU:
            rows[mu] = gel.core_rotation(), gel.modes()[0], surface
    return {"rows": rows, "size": size_of(mesh, gel), "seconds": time.perf_counter() - begin}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)} (all)")
    parser.add_argument(
        "--spacing",
        type=float,
        default=SPACING,
        help="distance of the nodes of jaxgel, mm (%(default).3f)",
    )
    options = parser.parse_args()
    if unknown := set(options.names) - set(CASES):
        parser.error(f"unknown case {', '.join(unknown)}")
    main(options.names, options.spacing)
