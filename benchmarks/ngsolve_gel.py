"""The swollen gel of sample 1 as a mixed finite-element problem (NGSolve), for ``ngsolve_sweep.py``.

Displacement u of order k on curved triangles, pressure p discontinuous of order k-1 and condensed element by element. The stationary
point of L(u, p) = int Nv/2 (F:F - 2) + p (J - 1) - g*(p) is sought, where g* is the Legendre transform of the mixing energy, so that
the volume ratio J*(p) > 1 is feasible for every p (see ``volume_ratio``). Lengths in mm, energies in kT/v times mm^2, mu in kT.
"""

import netgen.occ as occ
import ngsolve as ng
import numpy as np

NV, CHI = 1e-3, 1e-4
TOLERANCE = 1e-10  # mm, of the displacement; leaves a residual near 1e-13 of the network's nodal forces, no looser than jaxgel
KEEP = 0.1  # a factorisation is kept while each correction is below this fraction of the one before


def plate_mesh(order, plate, hole, grading):
    """Triangles of sample 1, edges up to ``plate`` mm long and up to ``hole`` mm on the four ellipses (full axes 10 x 8 mm)."""
    face = occ.MoveTo(-11, -11).Rectangle(22, 22).Face()
    face.edges.Min(occ.X).name, face.edges.Max(occ.X).name = "left", "right"
    face.edges.Min(occ.Y).name, face.edges.Max(occ.Y).name = "bottom", "top"
    for cx, cy in ((5, 5), (-5, 5), (-5, -5), (5, -5)):
        ellipse = occ.WorkPlane().MoveTo(cx, cy).Rotate(0 if cx * cy > 0 else 90).Ellipse(5, 4).Face()
        ellipse.edges.maxh = hole
        face = face - ellipse
    mesh = ng.Mesh(occ.OCCGeometry(face, dim=2).GenerateMesh(maxh=plate, grading=grading))
    mesh.Curve(order)
    return mesh


def volume_ratio(p, mu):
    """J*(p) > 1 that solves ln(1 - 1/J) + 1/J + chi/J^2 - Nv/J = mu + p, as an NGSolve expression.

    With w = 1 - 1/J and Nv = chi = 0 this is ln w - w = mu + p - 1, so -w is the Lambert W function of -exp(mu + p - 1): its series
    starts two Newton steps. Twelve digits below mu + p = -0.9.
    """
    s = mu + p
    z = ng.exp(s - 1)
    w = z * (1 + z * (1 + z * (3 / 2 + z * (8 / 3 + z * (125 / 24 + z * 54 / 5)))))
    for _ in range(2):
        value = ng.log(w) + (1 - w) * (1 - NV) + CHI * (1 - w) ** 2 - s
        w = w - value / (1 / w - (1 - NV) - 2 * CHI * (1 - w))
    return 1 / (1 - w)


class MixedGel:
    """One mesh with its state (u, p), residual, tangent and factorisation."""

    def __init__(self, mesh, order):
        self.mesh, self.mu = mesh, ng.Parameter(0.0)
        displacement = ng.VectorH1(mesh, order=order, dirichletx="left|right", dirichlety="bottom|top")
        space = displacement * ng.L2(mesh, order=order - 1)
        self.free_dofs, self.n_displacement = sum(displacement.FreeDofs()), displacement.ndof
        self.state = ng.GridFunction(space)
        self.u, self.p = self.state.components
        self.dx = ng.dx(intrules={ng.TRIG: ng.IntegrationRule(ng.TRIG, 2 * order - 1)})  # the default would be a denser rule
        (du, dp), (v, q) = space.TnT()
        grad_u, grad_v = ng.Grad(du), ng.Grad(v)
        self.F = ng.Id(2) + ng.Grad(self.u)
        C = _cofactor(self.F)
        self.J = volume_ratio(self.p, self.mu).Compile()
        compliance = (1 / (1 / (self.J**2 * (self.J - 1)) - 2 * CHI / self.J**3 + NV / self.J**2)).Compile()  # dJ*/dp
        # One term per line, because NGSolve evaluates every factor of an integrand once for each pair of components.
        self.tangent = ng.BilinearForm(space, condense=True)
        self.tangent += (NV * ng.InnerProduct(grad_u, grad_v) + self.p * ng.InnerProduct(_cofactor(grad_u), grad_v)) * self.dx
        self.tangent += (dp * ng.InnerProduct(C, grad_v) + q * ng.InnerProduct(C, grad_u)) * self.dx
        self.tangent += -compliance * dp * q * self.dx
        self.residual = ng.LinearForm(space)
        self.residual += ng.InnerProduct((NV * self.F + self.p * C).Compile(), grad_v) * self.dx
        self.residual += q * (ng.Det(self.F) - self.J).Compile() * self.dx
        self.step = self.state.vec.CreateVector()
        self.inverse, self.free = None, space.FreeDofs(True)

    def factor(self):
        self.tangent.Assemble()
        if self.inverse is None:
            self.inverse = self.tangent.mat.Inverse(self.free, inverse="sparsecholesky")  # LDL^T without pivoting
        else:
            self.inverse.Update()

    def correct(self):
        """Apply one Newton correction with the factor at hand; its largest displacement in mm."""
        self.residual.Assemble()
        r, step, K = self.residual.vec, self.step, self.tangent
        r.data += K.harmonic_extension_trans * r
        step.data = self.inverse * r
        step.data += K.harmonic_extension * step
        step.data += K.inner_solve * r
        self.state.vec.data -= step
        return float(np.abs(step.FV().NumPy()[: self.n_displacement]).max())

    def equilibrium(self, mu, keep=True):
        """Newton at one mu from the present state; (factorisations, corrections)."""
        self.mu.Set(mu)
        size, contraction, factorisations = np.inf, np.inf, 0
        for corrections in range(1, 61):
            if not (keep and contraction <= KEEP):
                self.factor()
                factorisations += 1
            before, size = size, self.correct()
            contraction = size / before
            if size < TOLERANCE or (corrections > 1 and size * contraction < TOLERANCE / 10):  # what the next correction would be
                return factorisations, corrections
        raise RuntimeError(f"NGSolve: no equilibrium at mu = {mu}, last correction {size:.1e} mm")

    def core_rotation(self):
        """Polar rotation of F at the centre, degrees."""
        F11, F12, F21, F22 = self.F(self.mesh(0, 0))
        return float(np.degrees(np.arctan2(F21 - F12, F11 + F22)))

    def midline_rotation(self):
        """Angle to the x axis of the line from the lowest to the highest point of the deformed midline y = 0, degrees."""
        x = np.linspace(-11, 11, 4001)
        x, y = (np.array(self.u(self.mesh(x, 0 * x))) + np.stack([x, 0 * x], axis=1)).T
        low, high = y.argmin(), y.argmax()
        return float(np.degrees(np.arctan((y[high] - y[low]) / (x[high] - x[low]))))

    def energy(self):
        """Total free energy of the dry plate (kT/v mm^2)."""
        J = self.J
        mixing = -(J - 1) * ng.log(J / (J - 1)) - CHI / J - self.mu * (J - 1)
        return float(ng.Integrate((NV / 2 * (ng.InnerProduct(self.F, self.F) - 2 - 2 * ng.log(J)) + mixing) * self.dx, self.mesh))


def _cofactor(A):
    return ng.CF((A[1, 1], -A[1, 0], -A[0, 1], A[0, 0]), dims=(2, 2))
