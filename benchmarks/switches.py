"""A PNIPAM strip in its two phases and stretched cells, by jaxgel beside finite elements.

By NGSolve, extra ``[bench]``.

    python benchmarks/switches.py [--rows pnipam cells]

``pnipam``: a strip with a hole between walls that hold it stretched, cooled and heated through the
transition. At the temperatures that are compared it is in one phase, though not homogeneous: area
of the hole, mean volume ratio of the gel, and the highest point of the hole. The finite elements
are displacements alone, J = det F, and are led to either phase from the strip without a hole.

``cells``: the stretch at which periodic cells of a nearly incompressible neo-Hookean solid lose
their stability, shortened along x, with the stretch along y and the shear free. One hole: the
lattice shears. 2 x 2 holes: they become ellipses that lie and stand in turn. In jaxgel the gel is
so dry, mu = `DRY`, that it keeps its volume to 2e-5. The finite elements have a bulk modulus of
`BULK` shear moduli.

Each row: jaxgel, finite elements on the first of two meshes, the difference in %, and in % what the
second mesh changes.
"""  # fmt: skip

import argparse
import itertools
import time

import ngsolve as ng
import numpy as np
from bloch_elements import cell_mesh, factor
from finite_elements import Mesh, zero
from ngsolve_gel import cofactor, plate_mesh, sparse
from scipy.sparse.linalg import LinearOperator, eigsh

import jaxgel
from jaxgel.controls import Stretch
from jaxgel.observables import outlines, volume_ratio

NV, WALLS = 0.01, 2.0  # chain density, and stretch at which the walls hold the strip
# mm
STRIP = jaxgel.Plate(
    4, 4, [jaxgel.Circle((0, 0), 1.0)], edges={"top": "free"}, deformation=((WALLS, 0), (0, 1))
)
PATH = (36.0, 33.0, 31.0, 32.0, 36.0)  # degrees Celsius
COMPARED = {0: "shrunken", 1: "shrunken", 2: "swollen", 3: "swollen"}  # states of the path -> phase
STRIP_SPACINGS = (0.4, 0.2)  # mm
STRIP_MESHES = (Mesh(5, 0.6, 0.2), Mesh(4, 0.8, 0.3))
LEAD = 8  # steps in which the load that holds the strip without a hole is taken away
WIDTH, DRY, BULK = 2.0, -10.0, 1e5  # of a cell, mm; kT; over the shear modulus
# along a side -> radius, last stretch, spacings, mm
CELLS = {1: (0.8, 0.75, (1 / 8, 1 / 12, 1 / 16)), 2: (0.7, 0.83, (1 / 6, 1 / 8))}
# order of the displacements, longest edges over the side of a cell
CELL_MESHES = ((6, 1 / 8), (5, 1 / 10))
STEP, CLOSE = 0.04, 1e-3  # largest step of the stretch; how close to its onset the last state is
TOLERANCE = 1e-7  # mm, of the last correction of Newton's method


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="*", default=list(ROWS), choices=list(ROWS))
    for row in parser.parse_args().rows:
        ROWS[row]()


def compare(name, found, values):
    """Print jaxgel's value ``found`` beside those of two meshes."""
    exact, other = values
    errors = f"{100 * (found / exact - 1):+.3f} %, {100 * abs(other / exact - 1):.4f} %"
    print(f"  {name}: {found:.5f}, finite elements {exact:.5f}, {errors}", flush=True)


def pnipam():
    """The strip at the states `COMPARED` of its path."""
    known = {}
    for number, phase in COMPARED.items():
        begin = time.perf_counter()
        strips = [PnipamStrip(mesh, PATH[number], phase) for mesh in STRIP_MESHES]
        known[number] = [strip.values() for strip in strips]
        sizes = ", ".join(f"{strip.mesh.ne} triangles" for strip in strips)
        print(
            (
                f"{PATH[number]:g} degrees, {phase}: {sizes}, J {strips[0].range()}, "
                f"{time.perf_counter() - begin:.0f} s"
            ),
            flush=True,
        )
    for spacing in STRIP_SPACINGS:
        begin = time.perf_counter()
        model = jaxgel.discretise(jaxgel.make_cloud(STRIP, spacing=spacing))
        path = jaxgel.sweep(
            jaxgel.Problem(model, jaxgel.Pnipam(NV), control=jaxgel.controls.temperature(mu=0.0)),
            list(PATH),
        )
        print(
            f"spacing {spacing}, {model.n_nodes} nodes, {time.perf_counter() - begin:.0f} s: {path}"
        )
        columns = strip_values(path)
        for number, phase in COMPARED.items():
            for quantity, column in columns.items():
                both = [values[quantity] for values in known[number]]
                compare(f"{PATH[number]:g} degrees, {phase}, {quantity}", column[number], both)


def strip_values(path):
    """What is compared of a path of the strip: {quantity: (k,)}."""
    dry = float(jaxgel.Circle((0, 0), 1.0).area())
    outline = np.asarray(outlines(path)[0])
    return {
        "hole area, mm^2": dry * (1 - np.asarray(jaxgel.area_reduction(path))),
        "mean J": np.asarray(volume_ratio(path)) @ _shares(path),
        "top of the hole, mm": outline[:, :, 1].max(axis=1),
    }


def _shares(path):
    volumes = np.asarray(jaxgel.observables.cell_volumes(path.model))
    return volumes / volumes.sum()


def pnipam_energy(F, celsius, lib):
    """Energy of PNIPAM in water, kT/v per dry volume, at ``F`` (2, 2), after Cai & Suo (2011)."""
    J, invariant = (
        F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0],
        sum(F[i, j] ** 2 for i, j in itertools.product(range(2), repeat=2)),
    )
    kelvin = celsius + 273.15
    chi = -12.947 + 0.04496 * kelvin + (17.92 - 0.0569 * kelvin) / J
    return (
        NV / 2 * (invariant - 2 - 2 * lib.log(J)) + (J - 1) * lib.log(1 - 1 / J) + chi * (1 - 1 / J)
    )


def height_of(celsius, phase):
    """Stretch along y of the strip without a hole: the first or last minimum of the energy."""
    along = np.linspace(1.02, 8, 4001) / WALLS
    slope = np.diff([pnipam_energy(np.diag([WALLS, height]), celsius, np) for height in along])
    least = along[1:-1][(slope[:-1] < 0) & (slope[1:] > 0)]
    return float(least[0 if phase == "shrunken" else -1])


class PnipamStrip:
    """The strip by finite elements at one temperature, in one phase."""

    def __init__(self, mesh, celsius, phase):
        self.mesh = plate_mesh(STRIP, mesh.order, mesh.plate, mesh.hole)
        space = ng.VectorH1(self.mesh, order=mesh.order, dirichletx="x", dirichlety="y")
        self.u = ng.GridFunction(space)
        self.u.Set(
            ng.CF(((WALLS - 1) * ng.x, (height_of(celsius, phase) - 1) * (ng.y + STRIP.height / 2)))
        )
        energy = ng.BilinearForm(space)
        energy += ng.Variation(
            pnipam_energy(ng.Id(2) + ng.Grad(space.TrialFunction()), celsius, ng).Compile()
            * ng.dx(bonus_intorder=4)
        )
        self._lead(energy)
        self.F = ng.Id(2) + ng.Grad(self.u)

    def _lead(self, energy):
        """From the state at the start, which a load holds, to the equilibrium without it."""
        state, free = self.u.vec, self.u.space.FreeDofs()
        load, residual, step = (state.CreateVector() for _ in range(3))
        energy.Apply(state, load)
        for share in 1 - np.arange(1, LEAD + 1) / LEAD:
            for _ in range(20):
                energy.Apply(state, residual)
                residual.data -= share * load
                energy.AssembleLinearization(state)
                step.data = energy.mat.Inverse(free, inverse="sparsecholesky") * residual
                state.data -= step
                if np.abs(step.FV().NumPy()).max() < TOLERANCE:
                    break
            else:
                raise RuntimeError(f"no equilibrium under {share:.3f} of the load")

    def values(self):
        """What is compared: {quantity: value}."""
        position, tangent = ng.CF((ng.x, ng.y)) + self.u, ng.specialcf.tangential(2)
        along = tangent + ng.Grad(self.u).Trace() * tangent
        hole = self.mesh.Boundaries("hole")
        swept = ng.Integrate(
            (position[0] * along[1] - position[1] * along[0]) / 2,
            self.mesh,
            definedon=hole,
            order=12,
        )
        gel, dry = ng.Integrate(ng.Det(self.F), self.mesh), ng.Integrate(ng.CF(1), self.mesh)
        rule = ng.IntegrationRule([(t,) for t in np.linspace(0, 1, 33)], [0.0] * 33)
        highest = position(self.mesh.MapToAllElements(rule, hole))[:, 1].max()
        return {"hole area, mm^2": abs(swept), "mean J": gel / dry, "top of the hole, mm": highest}

    def range(self):
        """Text of the smallest and largest volume ratio at corners and middles of the triangles."""
        rule = ng.IntegrationRule([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1 / 3, 1 / 3)], [0.0] * 4)
        J = ng.Det(self.F)(self.mesh.MapToAllElements(rule, self.mesh.Materials(".*")))
        return f"{J.min():.2f} to {J.max():.2f}"


def cells():
    """Onsets of one hole and of 2 x 2."""
    for number, (radius, last, spacings) in CELLS.items():
        begin = time.perf_counter()
        exact = [NeoHookeanCell(number, radius, *mesh).onset() for mesh in CELL_MESHES]
        print(
            f"{number} x {number} holes: finite elements lose their stability at the stretches "
            f"{exact}, {time.perf_counter() - begin:.0f} s"
        )
        for spacing in spacings:
            begin = time.perf_counter()
            model = cell_model(number, radius, spacing)
            (point,) = jaxgel.critical_points(
                jaxgel.Problem(model, jaxgel.Gel(), control=Stretch("x", mu=DRY)),
                (1.0, last),
                most=1,
            )
            print(
                f"  spacing {spacing:.4f}, {model.n_nodes} nodes, "
                f"{time.perf_counter() - begin:.0f} s: {point.text}"
            )
            compare("  strain", 1 - point.value, [1 - stretch for stretch in exact])


def cell_model(number, radius, spacing):
    """Model of ``number`` x ``number`` cells with holes of a ``radius``, mm."""
    centres = np.arange(1 - number, number, 2) * WIDTH / 2
    holes = [jaxgel.Circle(centre, radius) for centre in itertools.product(centres, centres)]
    side = number * WIDTH
    plate = jaxgel.Plate(
        side, side, holes, edges="periodic", deformation=((1.0, "free"), ("free", "free"))
    )
    return jaxgel.discretise(
        jaxgel.make_cloud(plate, spacing=spacing, nodes_per_hole=round(4 / spacing / 4) * 4)
    )


class NeoHookeanCell:
    """Periodic cells of a nearly incompressible neo-Hookean solid with the shear modulus 1.

    The unknowns are the fluctuation u, the pressure p and the mean deformation gradient's
    components F22 and F12 = F21; F11 is the stretch. The stationary point of int (F:F - 2)/2 + p
    (J - 1) - (p + 1)^2/(2 BULK) is sought; the pressure is condensed.
    """

    def __init__(self, number, radius, order, size):
        self.mesh = cell_mesh(WIDTH, radius, number, order, size)
        fluctuation, mean = (
            ng.Periodic(ng.VectorH1(self.mesh, order=order)),
            ng.NumberSpace(self.mesh),
        )
        pressure = ng.L2(self.mesh, order=order - 1)
        space = fluctuation * pressure * mean * mean
        for dof in range(fluctuation.ndof):
            if space.CouplingType(dof) == ng.COUPLING_TYPE.LOCAL_DOF:
                space.SetCouplingType(dof, ng.COUPLING_TYPE.INTERFACE_DOF)
        self.state, self.stretch, dx = (
            ng.GridFunction(space),
            ng.Parameter(1.0),
            ng.dx(bonus_intorder=2),
        )
        self.state.components[1].Set(-1.0)
        (du, dp, *dmean), (v, q, *vmean) = space.TnT()
        p, change, test = self.state.components[1], gradient(du, *dmean), gradient(v, *vmean)
        F = ng.CF((self.stretch, 0, 0, 1), dims=(2, 2)) + gradient(
            self.state.components[0], *self.state.components[2:]
        )
        self.tangent, self.network = ng.BilinearForm(space, condense=True), ng.BilinearForm(space)
        self.tangent += (
            ng.InnerProduct(change, test) + p * ng.InnerProduct(cofactor(change), test)
        ) * dx
        self.tangent += (
            dp * ng.InnerProduct(cofactor(F), test)
            + q * ng.InnerProduct(cofactor(F), change)
            - dp * q / BULK
        ) * dx
        self.network += ng.InnerProduct(change, test) * dx
        self.residual = ng.LinearForm(space)
        self.residual += (
            ng.InnerProduct(F + p * cofactor(F), test) + q * (ng.Det(F) - 1 - (p + 1) / BULK)
        ) * dx
        used = np.zeros(space.ndof, dtype=bool)
        for element in space.Elements():
            used[[dof for dof in element.dofs if dof >= 0]] = True
        used[fluctuation.ndof : fluctuation.ndof + pressure.ndof] = False
        # against translations
        used[list(fluctuation.GetDofNrs(ng.NodeId(ng.VERTEX, self.mesh.nv - 1)))] = False
        self.dofs = np.flatnonzero(used)  # the shear is the last one
        self.weight = self.matrix(self.network)

    def matrix(self, form):
        """Of the unknowns without the pressure (n, n)."""
        return sparse(form.Assemble().mat)[self.dofs][:, self.dofs]

    def equilibrium(self, stretch):
        """Newton at ``stretch`` from the present state.

        Without shear, as the symmetric state is, though the mesh is not symmetric.
        """
        self.stretch.Set(stretch)
        K, step, dofs = self.tangent, self.state.vec.CreateVector(), self.dofs[:-1]
        for _ in range(20):
            inverse = factor(self.matrix(K)[:-1, :-1])
            r = self.residual.Assemble().vec
            r.data += K.harmonic_extension_trans * r
            step[:] = 0
            step.FV().NumPy()[dofs] = inverse.solve(r.FV().NumPy()[dofs])
            step.data += K.harmonic_extension * step
            step.data += K.inner_solve * r
            self.state.vec.data -= step
            if np.abs(step.FV().NumPy()[dofs]).max() < TOLERANCE:
                return
        raise RuntimeError(f"no equilibrium at the stretch {stretch}")

    def lowest(self, stretch, near=-0.3):
        """Lowest eigenvalue of the tangent over the network's stiffness at ``stretch``.

        ``near`` is below it.
        """
        self.equilibrium(stretch)
        K = self.matrix(self.tangent)
        inverse = factor(K - near * self.weight)
        start = inverse.solve(self.weight @ np.random.default_rng(0).normal(size=len(self.dofs)))
        return float(
            eigsh(
                K,
                2,
                self.weight,
                sigma=near,
                OPinv=LinearOperator(K.shape, inverse.solve),
                v0=start,
            )[0].min()
        )

    def onset(self):
        """The stretch at which the lowest eigenvalue is 0, approached from the stable side."""
        found, guess = {1.0: self.lowest(1.0)}, 0.0
        while min(found) - guess > CLOSE:
            at = max(min(found) - STEP, guess + CLOSE / 2)
            found[at] = self.lowest(at)
            near = sorted(found)[:4]
            guess = zero(near, [found[stretch] for stretch in near]) if len(near) == 4 else 0.0
        return guess


def gradient(u, along, shear):
    """Gradient of a fluctuation and of what it changes of the mean deformation."""
    return ng.Grad(u) + ng.CF((0, shear, shear, along), dims=(2, 2))


ROWS = {"pnipam": pnipam, "cells": cells}


if __name__ == "__main__":
    main()
