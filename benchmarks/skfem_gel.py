"""The swollen gel of sample 1 in scikit-fem: the mixed problem of ``ngsolve_gel.py``.

The mesh is of the same kind (by Netgen). Displacement of order k on triangles with curved
(quadratic) edges on the holes, pressure discontinuous of order k-1, eliminated element by element
in NumPy; SciPy's SuperLU in symmetric mode, its ordering kept from the first factor on. A factor
serves several corrections.
"""

import dataclasses
import statistics
import time
from importlib.metadata import version

import numpy as np
import skfem
from ngsolve_gel import KEEP, TOLERANCE, plate_mesh
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from skfem.helpers import ddot, grad

from jaxgel import sample

PLATE = sample("sample-1")
NV, CHI = PLATE.gel.Nv, PLATE.gel.chi
MU = np.linspace(-4.9678, -0.9178, 30)
ELEMENTS = {
    1: skfem.ElementTriP1,
    2: skfem.ElementTriP2,
    3: skfem.ElementTriP3,
    4: skfem.ElementTriP4,
}
SUPERLU = dict(diag_pivot_thresh=0.0, options=dict(SymmetricMode=True, Equil=False))


@dataclasses.dataclass(frozen=True)
class Row:
    """A mesh: order k, longest edges in the plate and on the holes (mm), growth of the edges."""

    order: int
    plate: float
    hole: float
    grading: float = 0.3


ROWS = (Row(3, 4, 3, grading=0.8), Row(3, 4, 3), Row(3, 2, 0.9), Row(4, 6, 4), Row(4, 4, 2.5))


def curved_mesh(plate, hole, grading):
    """Netgen's triangles with the middles of the edges on the holes moved onto the ellipses."""
    mesh = plate_mesh(PLATE, 1, plate, hole, grading)
    corners = np.array([[vertex.nr for vertex in element.vertices] for element in mesh.Elements()])
    straight = skfem.MeshTri(
        np.array([vertex.point for vertex in mesh.vertices]).T.copy(), corners.T.copy()
    )
    curved = skfem.MeshTri2.from_mesh(straight)
    middles = straight.p[:, straight.facets[:, straight.boundary_facets()]].mean(axis=1)
    middles = middles[:, np.abs(middles).max(axis=0) < 11 * (1 - 1e-9)]
    points = curved.doflocs.copy()
    places = cKDTree(points.T).query(middles.T)[1]
    centre = 5 * np.sign(middles)
    axes = np.where(np.prod(centre, axis=0) > 0, [[5.0], [4.0]], [[4.0], [5.0]])
    offset = (middles - centre) / axes
    points[:, places] = centre + axes * offset / np.linalg.norm(offset, axis=0)
    return dataclasses.replace(curved, doflocs=points)


def cofactor(A):
    """Cofactors (2, 2, ...) of matrices (2, 2, ...)."""
    return np.array([[A[1, 1], -A[1, 0]], [-A[0, 1], A[0, 0]]])


def volume_ratio(s):
    """J*(p) for s = mu + p, and its derivative; see ``ngsolve_gel.volume_ratio``."""
    z = np.exp(s - 1)
    w = z * (1 + z * (1 + z * (3 / 2 + z * (8 / 3 + z * (125 / 24 + z * 54 / 5)))))
    for _ in range(2):
        w = w - (np.log(w) + (1 - w) * (1 - NV) + CHI * (1 - w) ** 2 - s) / (
            1 / w - (1 - NV) - 2 * CHI * (1 - w)
        )
    J = 1 / (1 - w)
    return J, 1 / (1 / (J**2 * (J - 1)) - 2 * CHI / J**3 + NV / J**2)


@skfem.BilinearForm
def stiffness(u, v, w):
    """Second derivative in the displacement: the network, and the pressure by the cofactors."""
    return NV * ddot(grad(u), grad(v)) + w.p * ddot(cofactor(grad(u)), grad(v))


@skfem.BilinearForm
def coupling(p, v, w):
    """The pressure on the cofactors of F."""
    return p * ddot(w.C, grad(v))


@skfem.BilinearForm
def compliance(p, q, w):
    """dJ*/dp."""
    return w.slope * p * q


@skfem.LinearForm
def force(v, w):
    """Internal forces."""
    return ddot(NV * w.F + w.p * w.C, grad(v))


@skfem.LinearForm
def constraint(q, w):
    """J - J*(p)."""
    return q * w.error


class MixedGel:
    """One mesh with its state (u, p), its tangent and factor."""

    def __init__(self, row):
        mesh, k = curved_mesh(row.plate, row.hole, row.grading), row.order
        self.row, self.u_basis = (
            row,
            skfem.Basis(mesh, skfem.ElementVector(ELEMENTS[k]()), intorder=2 * k - 1),
        )
        self.p_basis = self.u_basis.with_element(skfem.ElementTriDG(ELEMENTS[k - 1]()))
        held = [
            self.u_basis.get_dofs(lambda x, i=i: np.abs(x[i]) > 11 * (1 - 1e-9)).all([f"u^{i + 1}"])
            for i in range(2)
        ]
        self.free = np.setdiff1d(np.arange(self.u_basis.N), np.concatenate(held))
        self.u, self.p = np.zeros(self.u_basis.N), np.zeros(self.p_basis.N)
        self.u_dofs, self.p_dofs = self.u_basis.element_dofs.T, self.p_basis.element_dofs.T
        self._pattern()
        self.order = None
        self.core = self._core_basis(mesh)

    def _pattern(self):
        """Where the entries of the elements' matrices go in the free-free one."""
        local = np.full(self.u_basis.N, -1)
        local[self.free] = np.arange(len(self.free))
        n = self.u_dofs.shape[1]
        row, column = (
            local[np.broadcast_to(d, (len(self.u_dofs), n, n))].ravel()
            for d in (self.u_dofs[:, :, None], self.u_dofs[:, None])
        )
        self.kept = (row >= 0) & (column >= 0)
        f = len(self.free)
        key, self.place = np.unique(column[self.kept] * f + row[self.kept], return_inverse=True)
        self.indices, self.indptr = key % f, np.searchsorted(key // f, np.arange(f + 1))

    def _core_basis(self, mesh):
        """Basis with the plate's centre as its one point."""
        # the curved one cannot search; its holes are far away
        straight = skfem.MeshTri(mesh.doflocs[:, : mesh.nvertices], mesh.t)
        cell = int(straight.element_finder()(np.zeros(1), np.zeros(1))[0])
        at = mesh.mapping().invF(np.zeros((2, 1, 1)), tind=np.array([cell]))[:, 0]
        return skfem.Basis(
            mesh, self.u_basis.elem, elements=np.array([cell]), quadrature=(at, np.ones(1))
        )

    def linearise(self):
        """Residuals (f,), (e, m) of displacement and pressure, and the fields of the tangent."""
        F = grad(self.u_basis.interpolate(self.u)) + np.eye(2)[:, :, None, None]
        C, p = cofactor(F), np.asarray(self.p_basis.interpolate(self.p))
        J, slope = volume_ratio(p + self.mu)
        error = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0] - J
        fields = dict(F=F, C=C, p=p, slope=slope, error=error)
        return (
            force.assemble(self.u_basis, **fields),
            constraint.assemble(self.p_basis, **fields)[self.p_dofs],
            fields,
        )

    def factor(self, fields):
        """Factor of the tangent, the pressures eliminated: K + B M^-1 B^T."""
        K = stiffness.coo_data(self.u_basis, **fields).tolocal()
        B = coupling.coo_data(self.p_basis, self.u_basis, **fields)
        # its own tolocal() takes the two sides for each other
        self.B = B.data.reshape(*B.local_shape[::-1], -1).transpose(2, 1, 0)
        self.M = np.linalg.inv(compliance.coo_data(self.p_basis, **fields).tolocal())
        K = K + self.B @ self.M @ self.B.transpose(0, 2, 1)
        data = np.bincount(self.place, K.ravel()[self.kept])
        if self.order is None:
            matrix = csc_matrix((data, self.indices, self.indptr))
            self.order = np.argsort(splu(matrix, permc_spec="MMD_AT_PLUS_A", **SUPERLU).perm_c)
            numbered = csc_matrix((np.arange(1.0, len(data) + 1), self.indices, self.indptr))[
                self.order
            ][:, self.order].tocsc()
            numbered.sort_indices()  # as SuperLU would in place
            self.permuted = numbered.data.astype(int) - 1, numbered.indices, numbered.indptr
        source, indices, indptr = self.permuted
        self.lu = splu(csc_matrix((data[source], indices, indptr)), permc_spec="NATURAL", **SUPERLU)

    def correct(self, r_u, r_p):
        """Apply one correction with the factor at hand; its largest displacement in mm."""
        by_element = np.einsum("eij,ej->ei", self.B @ self.M, r_p)
        rhs = -(r_u + np.bincount(self.u_dofs.ravel(), by_element.ravel(), self.u_basis.N))[
            self.free
        ]
        du = np.zeros(self.u_basis.N)
        du[self.free[self.order]] = self.lu.solve(rhs[self.order])
        dp = np.einsum("eij,ej->ei", self.M, np.einsum("eij,ei->ej", self.B, du[self.u_dofs]) + r_p)
        self.u, p = self.u + du, self.p.copy()
        p[self.p_dofs] += dp
        self.p = p
        return float(np.abs(du).max())

    def equilibrium(self, mu):
        """Newton at one mu from the present state; (factorisations, corrections)."""
        self.mu, size, contraction, factorisations = mu, np.inf, np.inf, 0
        for corrections in range(1, 61):
            r_u, r_p, fields = self.linearise()
            if contraction > KEEP:
                self.factor(fields)
                factorisations += 1
            before, size = size, self.correct(r_u, r_p)
            contraction = size / before
            # what the next correction would be
            if size < TOLERANCE or (corrections > 1 and size * contraction < TOLERANCE / 10):
                return factorisations, corrections
        raise RuntimeError(
            f"scikit-fem: no equilibrium at mu = {mu}, last correction {size:.1e} mm"
        )

    def core_rotation(self):
        """Polar rotation of F at the centre, degrees."""
        F = np.eye(2) + grad(self.core.interpolate(self.u))[:, :, 0, 0]
        return float(np.degrees(np.arctan2(F[1, 0] - F[0, 1], F[0, 0] + F[1, 1])))


def sweep(gel):
    """Equilibria at MU from the dry plate, by quadratic extrapolation, with counts.

    (core rotations, factorisations, corrections).
    """
    history, observed, counts = [], [], []
    gel.u, gel.p = np.zeros_like(gel.u), np.zeros_like(gel.p)
    for mu in MU:
        if len(history) > 1:
            weights = ((3, -3, 1), (2, -1))[len(history) == 2]
            gel.u, gel.p = (
                sum(w * before[i] for w, before in zip(weights, reversed(history), strict=True))
                for i in range(2)
            )
        counts.append(gel.equilibrium(mu))
        history = [*history[-2:], (gel.u, gel.p)]
        observed.append(gel.core_rotation())
    return observed, *(int(n) for n in np.sum(counts, axis=0))


def measure(row, runs):
    """Median of ``runs`` sweeps on one mesh after a first one, as a dict.

    Meshing and basis apart.
    """
    begin = time.perf_counter()
    gel, wall, cpu = MixedGel(row), [], []
    setup = time.perf_counter() - begin
    for _ in range(runs + 1):
        begin = time.perf_counter(), time.process_time()
        core, factorisations, corrections = sweep(gel)
        wall.append(time.perf_counter() - begin[0])
        cpu.append(time.process_time() - begin[1])
    median = statistics.median(wall[1:])
    return {
        "solver": f"scikit-fem P{row.order}",
        "version": version("scikit-fem"),
        "mesh": dataclasses.asdict(row) | {"elements": len(gel.u_dofs)},
        "free_dofs": len(gel.free),
        "newton": corrections,
        "factorisations": factorisations,
        "setup_s": setup,
        "compile_s": wall[0] - median,
        "wall_s": median,
        "wall_all_s": wall,
        "cpu_s": statistics.median(cpu[1:]),
        "core_rotation": core,
    }
