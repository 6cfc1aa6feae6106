"""The seal of ``contact.py`` by NGSolve: a bonded block under a flat punch.

The contact energy is the same.

    python benchmarks/seal_elements.py [--size 0.05] [--order 3] [--to 0.6] [--step 0.01]

Displacement of order k, discontinuous pressure of order k - 1, as in ``ngsolve_gel.py``. The
contact energy is integrated over the deformed top and side of the block, at the quadrature points
of its sides. Prints the stroke in mm and the force in kT/v mm.
"""  # fmt: skip

import argparse

import netgen.occ as occ
import ngsolve as ng
import numpy as np
from ngsolve_gel import cofactor, volume_ratio

import jaxgel

GEL, MU, RANGE, STIFFNESS = jaxgel.Gel(Nv=1e-2, chi=0.1), -8.0, 0.02, 10.0
CLEARANCE = 1.01 * RANGE  # of both plates from the dry block, mm
TOLERANCE, ITERATIONS, HALVINGS, LEFT = 1e-9, 60, 12, 0.2


class Seal:
    """Half a block, 2 mm wide and 1 mm high, bonded below, with its mirror line at x = -0.5."""

    def __init__(self, size, order):
        face = occ.MoveTo(-0.5, -0.5).Rectangle(1.0, 1.0).Face()
        for edge, name in ((face.edges.Min(occ.X), "mirror"), (face.edges.Min(occ.Y), "base")):
            edge.name = name
        face.vertices.Max(occ.X + occ.Y).maxh = face.vertices.Max(occ.X - occ.Y).maxh = size / 3
        self.mesh = ng.Mesh(occ.OCCGeometry(face, dim=2).GenerateMesh(maxh=size, grading=0.3))
        displacement = ng.VectorH1(
            self.mesh, order=order, dirichletx="mirror|base", dirichlety="base"
        )
        space = displacement * ng.L2(self.mesh, order=order - 1)
        self.state, self.depth, self.n_displacement = (
            ng.GridFunction(space),
            ng.Parameter(0.0),
            displacement.ndof,
        )
        (du, dp), (v, q) = space.TnT()
        u, p = self.state.components
        F, J = ng.Id(2) + ng.Grad(u), volume_ratio(p, MU, GEL).Compile()
        C, kappa = cofactor(F), STIFFNESS * GEL.Nv
        compliance = (1 / (1 / (J**2 * (J - 1)) - 2 * GEL.chi / J**3 + GEL.Nv / J**2)).Compile()
        self.tangent, self.residual = ng.BilinearForm(space, condense=True), ng.LinearForm(space)
        self.tangent += (
            GEL.Nv * ng.InnerProduct(ng.Grad(du), ng.Grad(v))
            + p * ng.InnerProduct(cofactor(ng.Grad(du)), ng.Grad(v))
        ) * ng.dx
        self.tangent += (
            dp * ng.InnerProduct(C, ng.Grad(v))
            + q * ng.InnerProduct(C, ng.Grad(du))
            - compliance * dp * q
        ) * ng.dx
        self.residual += (
            ng.InnerProduct((GEL.Nv * F + p * C).Compile(), ng.Grad(v)) * ng.dx
            + q * (ng.Det(F) - J).Compile() * ng.dx
        )
        side = ng.ds(definedon=self.mesh.Boundaries("default|"), bonus_intorder=8)
        height = ng.y + u[1]
        self.gaps = [0.5 + CLEARANCE - self.depth - height, height + 0.5 + CLEARANCE]
        slopes = [self._slope(gap / RANGE) for gap in self.gaps]
        for gap, slope, sign in zip(self.gaps, slopes, (-1, 1), strict=True):
            s = gap / RANGE
            self.residual += sign * kappa * slope * v[1] * side
            self.tangent += kappa / RANGE * ng.IfPos(1 - s, 2 / s**3 - 2, 0.0) * du[1] * v[1] * side
        self.pressure, self.side, self.space = -kappa * slopes[0], side, space

    @staticmethod
    def _slope(s):
        """Derivative of psi(s) = (1 - s)^3 / s."""
        return ng.IfPos(1 - s, -1 / s**2 + 3 - 2 * s, 0.0)

    def distances(self):
        """Gaps (m,) of points of the surface to the plates, mm."""
        points = self.mesh.MapToAllElements(
            ng.IntegrationRule(ng.SEGM, 16), self.mesh.Boundaries("default|")
        )
        return np.concatenate([np.ravel(gap(points)) for gap in self.gaps])

    def equilibrium(self, depth):
        """Newton's method at one depth; a step leaves a share of every gap."""
        self.depth.Set(depth)
        vector = self.state.vec
        for _ in range(ITERATIONS):
            self.tangent.Assemble()
            self.residual.Assemble()
            step, r, K = vector.CreateVector(), self.residual.vec, self.tangent
            r.data += K.harmonic_extension_trans * r
            step.data = K.mat.Inverse(self.space.FreeDofs(True), inverse="sparsecholesky") * r
            step.data += K.harmonic_extension * step
            step.data += K.inner_solve * r
            before, share, distances = (
                vector.CreateVector(),
                1.0,
                np.maximum(self.distances(), LEFT * RANGE),
            )
            before.data = vector
            for _ in range(HALVINGS):
                vector.data = before - share * step
                if np.all(self.distances() > LEFT * distances):
                    break
                share /= 2
            size = share * np.abs(step.FV().NumPy()[: self.n_displacement]).max()
            if size < TOLERANCE:
                return
        raise RuntimeError(
            f"NGSolve: no equilibrium at a stroke of {depth:.4f}, last correction {size:.1e} mm"
        )

    def force(self):
        return ng.Integrate(self.pressure * self.side, self.mesh)


def strokes(size, order, to, step, shown):
    """(stroke, force) at the multiples of ``shown``, until Newton's method ends."""
    seal, found = Seal(size, order), []
    seal.state.components[1].Set(-GEL.Nv)
    for k in range(round(to / step) + 1):
        seal.equilibrium(k * step)
        if abs(k * step / shown - round(k * step / shown)) < 1e-9:
            found.append((k * step, seal.force()))
            print(f"{k * step:8.3f}{seal.force():12.6f}", flush=True)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("size", 0.05), ("to", 0.6), ("step", 0.01)):
        parser.add_argument(f"--{name}", type=float, default=default)
    parser.add_argument("--order", type=int, default=3)
    options = parser.parse_args()
    try:
        strokes(options.size, options.order, options.to, options.step, 0.05)
    except RuntimeError as end:
        print(end)
