"""Bloch waves and onset of buckling in an infinite square lattice of holes by NGSolve.

Finite elements; extra ``[bench]``.

    python benchmarks/bloch_elements.py    (six minutes)

A dry square cell of side W with a round hole at its centre swells in plane strain at the mean
deformation gradient ``stretch`` times 1: opposite edges move alike. As in ``ngsolve_gel.py`` the
state is (u, p) on curved triangles. About it, waves u = v(X) exp(i k.X) with v periodic in the dry
lattice have the stiffness K(k) at fixed mu, the second derivative of the energy. K u = lambda N u
is solved, with both matrices quasi-periodic, where N(k) is the stiffness Nv grad u : grad v of the
network (lambda < 0: unstable). Lengths in mm, k in 1/mm, mu in kT.
"""

import itertools
import time

import jax
import jax.numpy as jnp
import netgen.occ as occ
import ngsolve as ng
import numpy as np
from finite_elements import zero
from ngsolve_gel import TOLERANCE, cofactor, sparse, volume_ratio
from scipy.optimize import brentq
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from jaxgel import sample

GEL = sample("sample-1").gel  # Nv = 1e-3, chi = 1e-4
UNSTABLE = 1e-6  # a wave is when its lambda is below minus this
# kT: closer to its onset a cell of several holes may turn to the buckled state, because its mesh is
# not symmetric
CLOSE = 5e-4
START, STOP, STEP = -5.0, -1.0, 0.25  # mu that are scanned, kT
# for onsets: order of the displacements, longest edges in units of W
MESHES = ((6, 1 / 6), (6, 1 / 9))


def cell_mesh(width, radius=None, cells=1, order=6, size=1 / 6):
    """Triangles of ``cells`` x ``cells`` square cells of side ``width``, about the origin.

    Edges up to ``size`` times ``width`` long. Edges at the right and the top are identified with
    those at the left and the bottom.
    """
    side = cells * width
    face = occ.MoveTo(-side / 2, -side / 2).Rectangle(side, side).Face()
    centres = (np.arange(cells) - (cells - 1) / 2) * width
    for x, y in itertools.product(centres, centres) if radius else ():
        face = face - occ.WorkPlane().MoveTo(x, y).Circle(radius).Face()
    for name, axis, shift in (("x", occ.X, (side, 0, 0)), ("y", occ.Y, (0, side, 0))):
        face.edges.Min(axis).Identify(
            face.edges.Max(axis),
            name,
            occ.IdentificationType.PERIODIC,
            occ.gp_Trsf.Translation(shift),
        )
    mesh = ng.Mesh(occ.OCCGeometry(face, dim=2).GenerateMesh(maxh=size * width))
    mesh.Curve(order)
    return mesh


def shifts(mesh):
    """Vectors (2, 2) from master edges to their images, whose functions take exp(i k.shift).

    In the order of the mesh's identifications, which is that of the phases but not that in which
    the edges were identified.
    """
    points = np.array([vertex.point for vertex in mesh.vertices])
    pairs = {number: pair for pair, number in mesh.GetPeriodicNodePairs(ng.VERTEX)}
    return np.array(
        [points[pairs[number][1]] - points[pairs[number][0]] for number in sorted(pairs)]
    )


def factor(matrix):
    """LU factors of a Hermitian matrix, with a symmetric ordering: less fill than the default."""
    return splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.01,
        options={"SymmetricMode": True},
    )


class Cell:
    """One periodic mesh with its state (u, p); u is the fluctuation about the mean deformation."""

    def __init__(self, width, radius=None, cells=1, order=6, size=1 / 6, stretch=1.0, gel=GEL):
        self.mesh, self.order, self.gel, self.side = (
            cell_mesh(width, radius, cells, order, size),
            order,
            gel,
            cells * width,
        )
        self.mu, self.shifts = ng.Parameter(START), shifts(self.mesh)
        self.dx = ng.dx(bonus_intorder=4)
        space = self.space()
        self.state = ng.GridFunction(space)
        self.F = stretch * ng.Id(2) + ng.Grad(self.state.components[0])
        self.p, self.J = (
            self.state.components[1],
            volume_ratio(self.state.components[1], self.mu, gel, steps=4).Compile(),
        )
        # dJ/dp
        self.compliance = (
            1 / (1 / (self.J**2 * (self.J - 1)) - 2 * gel.chi / self.J**3 + gel.Nv / self.J**2)
        ).Compile()
        self.tangent = self.stiffness(space)
        self.residual = ng.LinearForm(space)
        (_, _), (v, q) = space.TnT()
        self.residual += (
            ng.InnerProduct(gel.Nv * self.F + self.p * cofactor(self.F), ng.Grad(v)) * self.dx
        )
        self.residual += q * (ng.Det(self.F) - self.J) * self.dx
        self.pinned = self.unknowns(space, pin=True)
        self.at = None

    def space(self, k=None):
        """Displacements and pressures, periodic or, with a wave vector, complex and quasi-periodic.

        Pressures alone are condensed.
        """
        waves = {} if k is None else {"complex": True}
        phase = (
            {}
            if k is None
            else {"phase": [complex(np.exp(1j * np.dot(k, shift))) for shift in self.shifts]}
        )
        displacement = ng.Periodic(ng.VectorH1(self.mesh, order=self.order, **waves), **phase)
        space = displacement * ng.L2(self.mesh, order=self.order - 1, **waves)
        for dof in range(displacement.ndof):
            if space.CouplingType(dof) == ng.COUPLING_TYPE.LOCAL_DOF:
                space.SetCouplingType(dof, ng.COUPLING_TYPE.INTERFACE_DOF)
        return space

    def unknowns(self, space, pin):
        """Numbers of the master displacements, less one vertex if translations are pinned."""
        used = np.zeros(space.components[0].ndof, dtype=bool)
        for element in space.components[0].Elements():
            used[[dof for dof in element.dofs if dof >= 0]] = True
        if pin:
            used[list(space.components[0].GetDofNrs(ng.NodeId(ng.VERTEX, self.mesh.nv - 1)))] = (
                False
            )
        return np.flatnonzero(used)

    def stiffness(self, space):
        """Second derivative of the energy at the state.

        With the pressure eliminated it is that of the displacements alone.
        """
        (du, dp), (v, q) = space.TnT()
        grad_u, grad_v, C = ng.Grad(du), ng.Grad(v), cofactor(self.F)
        form = ng.BilinearForm(space, condense=True)
        form += (
            self.gel.Nv * ng.InnerProduct(grad_u, grad_v)
            + self.p * ng.InnerProduct(cofactor(grad_u), grad_v)
        ) * self.dx
        form += (dp * ng.InnerProduct(C, grad_v) + q * ng.InnerProduct(C, grad_u)) * self.dx
        form += -self.compliance * dp * q * self.dx
        return form

    def network(self, space):
        """Stiffness N of the network."""
        (du, _), (v, _) = space.TnT()
        form = ng.BilinearForm(space)
        form += self.gel.Nv * ng.InnerProduct(ng.Grad(du), ng.Grad(v)) * self.dx
        return form

    def equilibrium(self, mu):
        """Newton at ``mu`` from the present state, in steps of mu up to ``STEP``.

        Returns the cell.
        """
        start = mu if self.at is None else self.at
        for at in np.linspace(start, mu, int(np.ceil(abs(mu - start) / STEP)) + 1)[
            1 if mu != start else 0 :
        ]:
            self._newton(float(at))
        return self

    def _newton(self, mu):
        self.mu.Set(mu)
        K, step = self.tangent, self.state.vec.CreateVector()
        for _ in range(30):
            K.Assemble()
            r = self.residual.Assemble().vec
            r.data += K.harmonic_extension_trans * r
            step[:] = 0
            step.FV().NumPy()[self.pinned] = factor(
                sparse(K.mat)[self.pinned][:, self.pinned]
            ).solve(r.FV().NumPy()[self.pinned])
            step.data += K.harmonic_extension * step
            step.data += K.inner_solve * r
            # of the pressures too: a uniform state has u = 0 from the start
            size = np.abs(step.FV().NumPy()).max()
            self.state.vec.data -= step
            if size < TOLERANCE:
                self.at = mu
                return
        raise RuntimeError(f"no equilibrium at mu = {mu}")

    def bloch(self, k, number=6, near=-1.0):
        """The ``number`` lambda closest to ``near``, ascending, and their modes in ``space(k)``.

        ``near`` is below all that is expected; the modes are (number, ndof). At k = 0 translations
        are left out.
        """
        space = self.space(k)
        dofs = self.unknowns(space, pin=not np.any(k))
        K, B = (
            sparse(form.Assemble().mat)[dofs][:, dofs]
            for form in (self.stiffness(space), self.network(space))
        )
        lu = factor(K - near * B)
        # in the range of the inverse
        start = lu.solve(B @ np.random.default_rng(0).normal(size=len(dofs)).astype(complex))
        values, vectors = eigsh(
            K,
            number,
            B,
            sigma=near,
            OPinv=LinearOperator(K.shape, lu.solve, dtype=complex),
            v0=start,
        )
        modes, order = np.zeros((number, space.ndof), dtype=complex), np.argsort(values)
        modes[:, dofs] = vectors[:, order].T
        return values[order], modes


def wedge(width, parts):
    """Wave vectors (m, 2) of the irreducible wedge Gamma-X-M, on a grid of ``parts`` along Gamma-X.

    Gamma itself as a limit.
    """
    grid = [(i / parts, j / parts) for i in range(1, parts + 1) for j in range(i + 1)]
    return np.pi / width * np.array([*grid, (0.01, 0), (0.01, 0.005), (0.01, 0.01)])


def lowest(cell, mu, waves):
    """Lowest lambda at ``mu`` of each wave vector (m, 2)."""
    cell.equilibrium(mu)
    return np.array([cell.bloch(k, 2)[0][0] for k in waves])


def onset(cell, waves, start=START, stop=STOP):
    """First mu at which the lowest lambda of the ``waves`` (m, 2) is 0, and the wave; or None."""
    scan = {}
    for mu in np.arange(start, stop + STEP / 2, STEP):
        scan[mu] = lowest(cell, mu, waves)
        if scan[mu].min() < 0:
            if mu == start:
                raise RuntimeError(f"unstable at mu = {mu} already")
            critical = scan[mu].argmin()
            return crossing(
                cell, waves[critical], {at: values[critical] for at, values in scan.items()}
            ), waves[critical]
    return None


def crossing(cell, k, values):
    """The mu at which lambda is 0, by polynomials through the ``values`` nearest to 0.

    These are a dict of some mu; the four nearest are used.
    """
    for _ in range(10):
        near = sorted(values, key=lambda at: abs(values[at]))[:4]
        guess = zero(near, [values[at] for at in near])
        if min(abs(guess - at) for at in near) < CLOSE:
            return guess
        values[guess] = lowest(cell, guess, [k])[0]
    raise RuntimeError(f"lambda was not followed to 0: {values}")


def onset_of_lattice(width, radius, start=START, stop=STOP, parts=(4, 8), **options):
    """Onset of buckling of the endless lattice: mu, wave vector and the lowest lambda found there.

    None if there is none up to ``stop``. The waves of a coarse wedge are followed, and those of a
    fine one searched at the onset, until none there is unstable before.
    """
    cell, waves = Cell(width, radius, **options), wedge(width, parts[0])
    while found := onset(cell, waves, start, stop):
        mu, k = found
        fine = wedge(width, parts[1])
        values = lowest(cell, mu, fine)
        if values.min() > -UNSTABLE:
            return mu, k, float(values.min())
        waves = np.vstack([waves, fine[values.argmin()]])
    return None


def onset_of_cells(width, radius, cells=2, start=START, stop=STOP, **options):
    """Onset mu of ``cells`` x ``cells`` holes in one periodic cell by periodic modes; or None."""
    found = onset(Cell(width, radius, cells, **options), np.zeros((1, 2)), start, stop)
    return found and found[0]


def energy(F, mu, gel=GEL):
    """Energy per dry volume at the deformation gradient ``F`` (2, 2), by jaxgel."""
    J = jnp.linalg.det(F)
    return gel.network(F, gel) + gel.volumetric(J, gel) - mu * (J - 1)


def free_stretch(mu):
    """Stretch in the plane of a gel without holes that swells freely in plane strain."""
    return brentq(
        lambda stretch: float(jax.grad(lambda s: energy(s * jnp.eye(2), mu))(stretch)),
        1.0001,
        3.0,
        xtol=1e-14,
    )


def plane_waves(stretch, mu, k, width, reach=4):
    """Wave vectors (m, 2), their lambda (m, 2) and polarisations (m, 2, 2) by the acoustic tensor.

    They are k up to the lattice's.
    """
    F = stretch * jnp.eye(2)
    C = np.asarray(jax.hessian(energy)(F, mu))
    vectors = np.array(k) + 2 * np.pi / width * np.array(
        list(itertools.product(range(-reach, reach + 1), repeat=2))
    )
    acoustic = np.einsum("ijkl,mj,ml->mik", C, vectors, vectors)
    return vectors, *np.linalg.eigh(acoustic / (GEL.Nv * np.sum(vectors**2, axis=1))[:, None, None])


def rayleigh(cell, k, wave, polarisation):
    """K over N of the plane wave exp(i wave.X), projected into the cell's space of k."""
    space = cell.space(k)
    dofs, _, (v, _) = cell.unknowns(space, pin=False), *space.TnT()
    plane = ng.CF(tuple(map(float, polarisation))) * ng.exp(
        1j * (float(wave[0]) * ng.x + float(wave[1]) * ng.y)
    )
    K, N = (
        sparse(form.Assemble().mat)[dofs][:, dofs]
        for form in (cell.stiffness(space), cell.network(space))
    )
    u = factor(N).solve(
        ng.LinearForm(ng.InnerProduct(plane, v) * cell.dx).Assemble().vec.FV().NumPy()[dofs]
    )
    return (np.vdot(u, K @ u) / np.vdot(u, N @ u)).real


def main():
    begin = time.perf_counter()

    def report(*parts):
        print(f"{time.perf_counter() - begin:5.0f} s ", *parts, flush=True)

    for radius, (order, size) in itertools.product((0.8, 0.7), MESHES):
        options = {"order": order, "size": size}
        name = f"W = 2, r = {radius}, P{order}, maxh W/{1 / size:.0f}: onset"
        report(
            name,
            "of the lattice (mu, k W/pi, lowest lambda):",
            *readable(onset_of_lattice(2.0, radius, **options)),
        )
        report(name, "of 2 x 2 holes:", onset_of_cells(2.0, radius, **options))
    report(
        "lattice sample, r = 0.9: onset",
        *readable(onset_of_lattice(2.0, 0.9, gel=sample("lattice").gel, order=6)),
    )
    report("no hole, mu = -2: stretch", stretch := free_stretch(-2.0))
    compare_plane_waves(2.0, stretch, -2.0, np.pi / 2.0 * np.array((0.6, 0.2)))
    report("done")


def readable(found, width=2.0):
    """What ``onset_of_lattice`` found, the wave vector in units of pi/W."""
    return (None,) if found is None else (found[0], (found[1] * width / np.pi).tolist(), found[2])


def compare_plane_waves(width, stretch, mu, k):
    """Print lambda of a cell without a hole: elements, acoustic tensor and relative difference."""
    cell = Cell(width, order=6, stretch=stretch).equilibrium(mu)
    vectors, values, directions = plane_waves(stretch, mu, k, width)
    for value, exact in zip(cell.bloch(k)[0], np.sort(values, axis=None), strict=False):
        print("  transverse", value, exact, value / exact - 1)
    for wave in np.argsort(np.sum(vectors**2, axis=1))[:3]:
        value, exact = rayleigh(cell, k, vectors[wave], directions[wave, :, 1]), values[wave, 1]
        print("  longitudinal, Rayleigh quotient", value, exact, value / exact - 1)


if __name__ == "__main__":
    main()
