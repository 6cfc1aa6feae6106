"""One design step on sample 1 by jaxgel and by NGSolve: a curve's objective and its gradient.

NGSolve is in the extra ``[bench]``.

    python benchmarks/design_step.py [--quick] [--repeats 5] [--parameters 4 60]

The objective is the mean square of the core rotation over 30 given mu from -4.9678 to -0.9178, in
degrees squared. Of the four parameters two are a hole's semi-axes and two its centre, the other
holes being its quarter turns; the sixty are mean radius and amplitudes of cos and sin of 2 phi ...
8 phi of each outline, from the ones nearest to the ellipses on. All are lengths in mm. Each peer
places its cloud or mesh for the parameters and sweeps from the dry state, on one thread. About ten
minutes of one processor, nearly half of them compilation; ``--quick`` has four parameters, jaxgel's
default cloud and one repeat, in two to three minutes.

Columns: ``size`` is nodes (jaxgel) or free displacements (NGSolve). ``value`` is the largest
relative error of the core rotation over the states, ``gradient`` the error's norm over the
gradient's norm, both in % of what adjoints give on the first mesh of `REFINED`; what the other one
differs from it is printed above. Seconds are the processor's, medians after a first call, all peers
in turn, for the value and for value and gradient together. ``ratio`` is the latter over that of
jaxgel's first row: below 1 is faster than jaxgel.

- jaxgel: defaults, reverse mode. Its sweeps also count negative pivots, find the lowest eigenvalue
  and look for contact; NGSolve's do neither, because its factorisation does not show its pivots.
  ``stability`` is what the first two take of ``both/s``; ``bare ratio`` is the ratio with that left
  out of jaxgel's time: like beside like.
- adjoint: one solve per state with the factor that Newton's method has left, then the shape
  derivative of the residual, written by hand; NGSolve's own ``DiffShape`` gives the same numbers
  and, not compiled, took twenty times as long.
- morphed: differences on a mesh whose nodes follow the outlines. remeshed: differences between new
  meshes. Their seconds are those of one sweep times the number of sweeps; their errors are measured
  with four parameters only ("-": not measured). On new meshes they vary with the step, because the
  mesh changes with the outlines.

No JAX finite elements: jax-fem's solvers import petsc4py, of which pip has no wheel. tatva
installs, but has no sweep and no solver; a peer on top of it is not written.
"""  # fmt: skip

import argparse
import dataclasses
import functools
import os
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import ngsolve as ng
import numpy as np
from ngsolve_gel import MixedGel, cofactor, plate_mesh, sparse
from ngsolve_sweep import MU, Row, sweep
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

import jaxgel
from jaxgel.continuation.frames import Frame, RegionFrame

SPACINGS = (22 / 56, 0.55)  # mm
# 0.12 % and 0.35 %: the fastest that were found within 0.35 % are quartic and quintic
ELEMENTS = (Row(5, 4, 2.5), Row(4, 2, 1.5))
REFINED = (Row(4, 1.2, 0.25), Row(5, 1.5, 0.3))
MODES = 7  # of cos and sin of each outline
# mm; elements with a vertex this near to the core stay where they are, so that the core is a fixed
# point of its element
PINNED = 1.0
TOLERANCE = 1e-6  # of an adjoint state, relative
# mm, of differences to either side; new meshes scatter by more than the smaller one shows
STEPS = {"morphed": 1e-4, "remeshed": 2e-2}
MEASURED = 4  # parameters up to which the errors of differences are measured
HEADINGS = (
    "peer",
    "size",
    "value/%",
    "gradient/%",
    "value/s",
    "both/s",
    "stability",
    "ratio",
    "bare ratio",
)
# processor seconds in which jaxgel's sweeps have examined the stability of states, by `_timed`
spent = 0.0


class Problem(NamedTuple):
    """Plate whose holes follow a vector of parameters."""

    plate: jaxgel.Plate
    """The plate at the start."""
    theta: Callable
    """Parameters of the holes, for `Plate.at`, as a function of the vector."""
    start: np.ndarray
    """The vector (m,) where objective and gradient are taken, mm."""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="four parameters, jaxgel's default cloud, one repeat"
    )
    parser.add_argument("--repeats", type=int, default=5, help="timed calls per row (5)")
    parser.add_argument(
        "--parameters",
        type=int,
        nargs="+",
        choices=PROBLEMS,
        default=list(PROBLEMS),
        help="numbers of parameters (4 60)",
    )
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])
    os.environ["NPROC"] = "1"  # XLA's threads
    ng.SetNumThreads(1)
    for frame in (RegionFrame, Frame):
        frame.check, frame.factorised = _timed(frame.check), _timed(frame.factorised)
    for number in options.parameters[:1] if options.quick else options.parameters:
        compare(
            PROBLEMS[number](),
            SPACINGS[1:] if options.quick else SPACINGS,
            1 if options.quick else options.repeats,
        )


def compare(problem, spacings, repeats):
    """Print the rows of all peers for one problem."""
    start = problem.start
    refined = [Adjoint(problem, row).both(start) for row in REFINED]
    between = [100 * error for error in errors(*refined)]
    print(
        f"\n{len(start)} parameters; refined elements differ by {between[0]:.4f} % in the value "
        f"and {between[1]:.3f} % in the gradient"
    )
    print(f"{HEADINGS[0]:34}" + "".join(f"{heading:>11}" for heading in HEADINGS[1:]), flush=True)
    peers = [Meshless(problem, spacing) for spacing in spacings] + [
        Adjoint(problem, row) for row in ELEMENTS
    ]
    remeshed = Remeshed(problem, ELEMENTS[0])
    seconds = times_in_turn(
        [*(peer.curve for peer in peers), *(peer.both for peer in peers), remeshed.curve],
        start,
        repeats,
    )
    unit = seconds[len(peers)]
    for peer, value, both in zip(peers, seconds, seconds[len(peers) :], strict=False):
        line(peer.label, peer.size, errors(peer.both(start), refined[0]), value[0], *both, unit)
    first = len(spacings)  # of the finite elements
    for name, peer, (value, _) in (
        ("morphed", peers[first], seconds[first]),
        ("remeshed", remeshed, seconds[-1]),
    ):
        for side, sweeps in (("one-sided", 1 + len(start)), ("central", 1 + 2 * len(start))):
            gradient = (
                differences(peer.curve, start, STEPS[name], side)
                if len(start) <= MEASURED
                else None
            )
            label = f"NGSolve P{ELEMENTS[0].order} {name}, {side}"
            line(
                label,
                peers[first].size,
                errors((peer.curve(start), gradient), refined[0]),
                value,
                sweeps * value,
                0.0,
                unit,
            )


def errors(found, exact):
    """Relative errors of curve (largest) and gradient (of its norm); nan without gradient."""
    core, gradient = found
    of_gradient = (
        np.nan
        if gradient is None
        else np.linalg.norm(gradient - exact[1]) / np.linalg.norm(exact[1])
    )
    return np.abs(core / exact[0] - 1).max(), of_gradient


def line(label, size, relative, value, both, stability, unit):
    gradient = f"{100 * relative[1]:11.2f}" if np.isfinite(relative[1]) else f"{'-':>11}"
    ratios = both / unit[0], (both - stability) / (unit[0] - unit[1])
    seconds = "".join(f"{number:11.3f}" for number in (value, both, stability, *ratios))
    print(f"{label:34}{size:11}{100 * relative[0]:11.3f}{gradient}{seconds}", flush=True)


def times_in_turn(functions, start, repeats):
    """Median processor seconds of each function, and those of stability, in ``repeats`` rounds.

    A first round is not counted. The parameters are slightly others each time.
    """
    taken = []
    for k in range(repeats + 1):
        taken.append([])
        for function in functions:
            begin, before = time.process_time(), spent
            function(start * (1 + 1e-6 * k))
            taken[-1].append((time.process_time() - begin, spent - before))
    return [
        tuple(map(statistics.median, zip(*column, strict=True)))
        for column in zip(*taken[1:], strict=True)
    ]


def _timed(check):
    """``check`` of a frame, whose processor seconds are added to ``spent``."""

    @functools.wraps(check)
    def call(*args):
        global spent
        begin, before = time.process_time(), spent
        try:
            return check(*args)
        finally:
            spent = before + time.process_time() - begin  # one of the two calls the other

    return call


def differences(curve, start, step, side):
    """Gradient of the objective by one-sided or central differences."""
    steps = step * np.eye(len(start))
    back = (
        [objective(curve(start))] * len(start)
        if side == "one-sided"
        else [objective(curve(start - e)) for e in steps]
    )
    ahead = [objective(curve(start + e)) for e in steps]
    return np.subtract(ahead, back) / (step if side == "one-sided" else 2 * step)


def objective(core):
    """Mean square of the core rotations (k,), degrees squared."""
    return (core**2).mean()


def four():
    """Sample 1 by the semi-axes and the centre of its first ellipse.

    The others are quarter turns of it about the core.
    """
    plate = jaxgel.sample("sample-1")
    turns = [np.linalg.matrix_power([[0, -1], [1, 0]], k) for k in range(4)]

    @jax.jit
    def theta(p):
        return [{"semi_axes": p[:2], "centre": turn @ p[2:]} for turn in turns]

    return Problem(plate, theta, np.array([5.0, 4.0, 5.0, 5.0]))


def sixty():
    """Sample 1 with Fourier outlines in place of its ellipses."""
    sample = jaxgel.sample("sample-1")
    phi = 2 * np.pi * np.arange(128) / 128
    harmonics = np.arange(2, MODES + 2)[:, None]
    radii = [np.asarray(jax.vmap(hole.radius_at)(phi - hole.angle)) for hole in sample.holes]
    waves = [np.ones_like(phi) / 2, *np.cos(harmonics * phi), *np.sin(harmonics * phi)]
    start = np.hstack([2 * np.mean(waves * radius, axis=1) for radius in radii])

    @jax.jit
    def theta(p):
        return [
            {"radius": q[0], "cos": q[1 : 1 + MODES] / q[0], "sin": q[1 + MODES :] / q[0]}
            for q in p.reshape(4, -1)
        ]

    holes = [
        jaxgel.Fourier(hole.centre, **own)
        for hole, own in zip(sample.holes, theta(start), strict=True)
    ]
    return Problem(dataclasses.replace(sample, holes=tuple(holes)), theta, start)


class Meshless:
    """jaxgel on one cloud, which follows the holes."""

    def __init__(self, problem, spacing):
        self.plate, self.theta, _ = problem
        self.cloud = jaxgel.make_cloud(self.plate, spacing=spacing)
        self.label, self.size = f"jaxgel {spacing:.3f} mm", len(self.cloud.nodes)
        self._gradient = jax.value_and_grad(self._objective, has_aux=True)

    def _objective(self, p):
        model = jaxgel.discretise(self.cloud.at(self.plate.at(self.theta(p))))
        core = jaxgel.core_rotation(
            jaxgel.sweep(jaxgel.Problem(model, self.plate.gel), MU.tolist())
        )
        return objective(core), core

    def curve(self, p):
        return np.asarray(self._objective(jnp.asarray(p))[1])

    def both(self, p):
        """Curve, and gradient of its objective."""
        (_, core), gradient = self._gradient(jnp.asarray(p))
        return np.asarray(core), np.asarray(gradient)


class Morph:
    """Mesh whose outlines follow the parameters, its interior by a harmonic function."""

    def __init__(self, mesh, order, problem):
        plate, theta, _ = problem
        space = ng.H1(mesh, order=order, dirichlet="x|y|hole")
        u, v = space.TnT()
        self.laplacian = sparse(
            ng.BilinearForm(ng.grad(u) * ng.grad(v) * ng.dx).Assemble().mat
        ).tocsr()
        self.at_outlines, base = _interpolation(space, mesh, order)
        inside = np.array(space.FreeDofs())
        for element in space.Elements(ng.VOL):
            corners = np.array([mesh[vertex].point for vertex in element.vertices]) - np.array(
                plate.core or (0.0, 0.0)
            )
            if (np.linalg.norm(corners, axis=1) < PINNED).any() or _contains_origin(corners):
                inside[list(element.dofs)] = False
        self.inside = np.flatnonzero(inside)
        self.factor = splu(self.laplacian[self.inside][:, self.inside].tocsc())
        self.deformation = ng.GridFunction(ng.VectorH1(mesh, order=order))
        mesh.SetDeformation(self.deformation)
        self.displacement = _outline_displacement(plate, theta, base)

    def move(self, p):
        """Place the mesh for the parameters ``p``."""
        d = self.at_outlines @ np.asarray(self.displacement(p))
        d[self.inside] = -self.factor.solve((self.laplacian @ d)[self.inside])
        self.deformation.vec.FV().NumPy()[:] = d.T.ravel()

    def pull(self, p, derivative):
        """Derivatives by ``p`` from those by the mesh's coefficients (2 n)."""
        s = derivative.reshape(2, -1).T.copy()
        inner, s[self.inside] = self.factor.solve(s[self.inside]), 0
        s -= self.laplacian[:, self.inside] @ inner
        return np.asarray(jax.vjp(self.displacement, p)[1](jnp.asarray(self.at_outlines.T @ s))[0])


def _contains_origin(corners):
    """Whether the triangle with these corners (3, 2) contains the origin."""
    areas = [
        a[0] * b[1] - a[1] * b[0]
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    return min(areas) >= 0 or max(areas) <= 0


def _interpolation(space, mesh, order):
    """Matrix (dofs, points) of interpolation at the outlines' Chebyshev points, and these.

    The points are (m, 2).
    """
    t = (1 - np.cos(np.pi * np.arange(order + 1) / order)) / 2
    region = mesh.Boundaries("hole")
    points = ng.CF((ng.x, ng.y))(
        mesh.MapToAllElements(ng.IntegrationRule([(s,) for s in t], [0.0] * len(t)), region)
    )
    rows, columns, values = [], [], []
    edges = [element for element in space.Elements(ng.BND) if region.Mask()[element.index]]
    for k, edge in enumerate(edges):
        shapes = np.array([space.GetFE(edge).CalcShape(s) for s in t])
        rows.append(np.repeat(edge.dofs, order + 1))
        columns.append(np.tile(np.arange(order + 1) + k * (order + 1), order + 1))
        values.append(np.linalg.inv(shapes).ravel())
    rows, columns, values = map(np.hstack, (rows, columns, values))
    shared = np.isin(rows, range(mesh.nv))  # each vertex belongs to two edges
    return csr_matrix(
        (np.where(shared, values / 2, values), (rows, columns)), shape=(space.ndof, len(points))
    ), points


def _outline_displacement(plate, theta, base):
    """Function of the parameters: way (m, 2) of the points ``base`` to the outlines.

    The way is along the ray from the centre of their hole.
    """
    arms = base[:, None] - np.array([hole.centre for hole in plate.holes])
    owner = np.abs([jax.vmap(hole.excess)(base) for hole in plate.holes]).argmin(axis=0)
    phi = np.arctan2(*arms[np.arange(len(base)), owner].T[::-1])
    rays = np.stack([np.cos(phi), np.sin(phi)], axis=1)

    @jax.jit
    def displacement(p):
        moved = jnp.zeros(base.shape)
        for k, hole in enumerate(plate.at(theta(p)).holes):
            own = np.flatnonzero(owner == k)
            radii = jax.vmap(hole.radius_at)(phi[own] - getattr(hole, "angle", 0.0))
            moved = moved.at[own].set(hole.centre + radii[:, None] * rays[own] - base[own])
        return moved

    return displacement


class Adjoint:
    """NGSolve on one mesh, which follows the holes, with adjoint states written by hand."""

    def __init__(self, problem, row):
        plate = jaxgel.sample("sample-1")
        mesh = plate_mesh(plate, row.order, row.plate, row.hole, row.grading)
        self.gel, self.morph = MixedGel(plate, mesh, row.order), Morph(mesh, row.order, problem)
        self.label, self.size = f"NGSolve P{row.order} adjoint, {mesh.ne} cells", self.gel.free_dofs
        self.adjoint = ng.GridFunction(self.gel.state.space)
        self.forward, self.shape = self._forms()
        self.dofs, self.gradients = self._core()
        self.right, self.step = self.adjoint.vec.CreateVector(), self.adjoint.vec.CreateVector()

    def _forms(self):
        """Tangent times the adjoint state and shape derivative of the residual, as linear forms."""
        gel, (w, s) = self.gel, self.adjoint.components
        (v, q), V = gel.state.space.TestFunction(), self.morph.deformation.space.TestFunction()
        Nv, G, C, p = gel.plate.gel.Nv, ng.Grad(w), cofactor(gel.F), gel.p
        H = (Nv * G + p * cofactor(G) + s * C).Compile()
        forward = ng.LinearForm(gel.state.space)
        forward += ng.InnerProduct(H, ng.Grad(v)) * gel.dx
        forward += q * (ng.InnerProduct(C, G) - gel.compliance * s).Compile() * gel.dx
        P = Nv * gel.F + p * C
        density = ng.InnerProduct(P, G) + s * (ng.Det(gel.F) - gel.J)
        shape = ng.LinearForm(self.morph.deformation.space)
        shape += (
            ng.InnerProduct(
                (density * ng.Id(2) - ng.Grad(gel.u).trans * H - G.trans * P).Compile(), ng.Grad(V)
            )
            * gel.dx
        )
        return forward, shape

    def _core(self):
        """Degrees of freedom (n,) of the displacement about the core, and gradients there."""
        gel, point = self.gel, self.gel.mesh(*(self.gel.plate.core or (0.0, 0.0)))
        dofs = [d for d in gel.u.space.GetDofNrs(ng.ElementId(ng.VOL, point.nr)) if d >= 0]
        values, rows = gel.u.vec.FV().NumPy(), []
        for dof in dofs:
            values[:] = 0
            values[dof] = 1
            rows.append(ng.Grad(gel.u)(point))
        values[:] = 0
        return dofs, np.array(rows)

    def _core_and_derivative(self, gel):
        """Core rotation, degrees, and its derivative (2 n) by the mesh's coefficients."""
        state = gel.state.vec.FV().NumPy()
        F = np.eye(2).ravel() + state[self.dofs] @ self.gradients
        s, t = F[2] - F[1], F[0] + F[3]
        self.right[:] = 0
        self.right.FV().NumPy()[self.dofs] = np.degrees(
            self.gradients @ np.array([-s, -t, t, -s]) / (s**2 + t**2)
        )
        self._solve()
        self.shape.Assemble()
        return np.degrees(np.arctan2(s, t)), -self.shape.vec.FV().NumPy()  # a new array

    def _solve(self):
        """Adjoint state by iterations with the factor that Newton's method has left."""
        gel, K, r = self.gel, self.gel.tangent, self.gel.residual.vec
        self.adjoint.vec[:] = 0
        r.data = self.right
        for _ in range(30):
            r.data += K.harmonic_extension_trans * r
            self.step.data = gel.inverse * r
            self.step.data += K.harmonic_extension * self.step
            self.step.data += K.inner_solve * r
            self.adjoint.vec.data += self.step
            if ng.Norm(self.step) < TOLERANCE * ng.Norm(self.adjoint.vec):
                return
            self.forward.Assemble()
            r.data = self.right - self.forward.vec
        raise RuntimeError("NGSolve: the adjoint state does not converge")

    def curve(self, p):
        self.morph.move(p)
        return np.array(sweep(self.gel)[0])

    def both(self, p):
        """Curve, and gradient of its objective."""
        self.morph.move(p)
        core, derivatives = map(
            np.array, zip(*sweep(self.gel, observe=self._core_and_derivative)[0], strict=True)
        )
        return core, self.morph.pull(p, np.asarray(jax.grad(objective)(core)) @ derivatives)


class Remeshed:
    """NGSolve on a new mesh for each set of parameters."""

    def __init__(self, problem, row):
        self.plate, self.theta, _ = problem
        self.row = row

    def curve(self, p):
        plate, row = self.plate.at(self.theta(p)), self.row
        return np.array(
            sweep(
                MixedGel(
                    plate, plate_mesh(plate, row.order, row.plate, row.hole, row.grading), row.order
                )
            )[0]
        )


PROBLEMS = {4: four, 60: sixty}

if __name__ == "__main__":
    main()
