"""A swollen gel as a mixed finite-element problem (NGSolve).

For ``ngsolve_sweep.py`` and ``finite_elements.py``. Displacement u of order k on curved triangles,
pressure p discontinuous of order k-1 and condensed element by element. The stationary point of
L(u, p) = int Nv/2 (F:F - 2) + p (J - 1) - g*(p) is sought, where g* is the Legendre transform of
the mixing energy, so that the volume ratio J*(p) > 1 is feasible for every p (see
``volume_ratio``). Lengths in mm, energies in kT/v times mm^2, mu in kT.
"""

import functools

import jax
import netgen.meshing
import netgen.occ as occ
import ngsolve as ng
import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from jaxgel import Circle, Ellipse, Fourier

SIDES = (("left", "right"), ("bottom", "top"))
# mm, of the displacement; leaves a residual near 1e-13 of the network's nodal forces, no looser
# than jaxgel
TOLERANCE = 1e-10
SPLINE = 256  # points of the periodic cubic spline that stands for a Fourier outline
KEEP = 0.1  # a factorisation is kept while each correction is below this fraction of the one before


def plate_mesh(plate, order, size, hole, grading=0.3, corner=None, folds=0):
    """Triangles of a ``jaxgel.Plate`` with edges up to ``size`` mm long.

    They are up to ``hole`` mm on the outlines and ``corner`` mm at their corners. Regions of the
    plate are domains with the names "region0", "region1" ..., their outlines as fine as the holes'.
    With ``folds`` = n the lower left part, 1/2^n of either side, is meshed and then mirrored n
    times each way, so that the mesh has the mirror lines of the plate to round-off. The boundaries
    are "x" and "y", the walls by their normal but for free edges, and "hole".
    """
    left, bottom = -plate.width / 2, -plate.height / 2
    face = (
        occ.MoveTo(left, bottom).Rectangle(plate.width / 2**folds, plate.height / 2**folds).Face()
    )
    for outline in map(_face, plate.holes):
        outline.edges.maxh, outline.edges.name = hole, "hole"
        outline.vertices.maxh = corner or hole
        face = face - outline
    parts = []
    for number, region in enumerate(map(_face, plate.regions)):
        region.edges.maxh = hole
        region = region * face
        region.faces.name = f"region{number}"
        face = face - region
        parts.append(region)
    face = occ.Glue([face, *parts]) if parts else face
    mesh = occ.OCCGeometry(face, dim=2).GenerateMesh(maxh=size, grading=grading)
    for n in range(folds, 0, -1):
        for start, length, axis in (
            (left, plate.width, (1, 0, 0)),
            (bottom, plate.height, (0, 1, 0)),
        ):
            point = netgen.meshing.Pnt(*(np.array(axis) * (start + length / 2**n)))
            mesh = mesh.Mirror(point, netgen.meshing.Vec(*axis))
    walls = [mesh.AddRegion(name, 1) for name in "xy"]
    for edge in mesh.Elements1D():
        points = np.array([mesh[vertex].p[:2] for vertex in edge.vertices])
        for axis in np.flatnonzero(np.abs(np.abs(points) + [left, bottom]).max(axis=0) < 1e-9):
            if plate.edges[SIDES[axis][int(points[0, axis] > 0)]] != "free":
                edge.index = walls[axis]
    mesh = ng.Mesh(mesh)
    if folds:
        _curve(mesh, plate, order)  # a mirrored mesh has lost its geometry
    else:
        mesh.Curve(order)
    return mesh


def _face(hole):
    if isinstance(hole, Fourier):
        points = np.asarray(jax.vmap(hole.point)(np.arange(SPLINE) / SPLINE))
        return occ.Face(
            occ.Wire(
                [
                    occ.SplineInterpolation(
                        [(*map(float, point), 0) for point in points], periodic=True
                    )
                ]
            )
        )
    plane = (
        occ.WorkPlane()
        .MoveTo(*map(float, hole.centre))
        .Rotate(np.degrees(float(getattr(hole, "angle", 0))))
    )
    if isinstance(hole, Circle):
        return plane.Circle(float(hole.radius)).Face()
    if isinstance(hole, Ellipse):
        return plane.Ellipse(*map(float, hole.semi_axes)).Face()
    return plane.RectangleC(*map(float, hole.sides)).Face()


def _curve(mesh, plate, order):
    """Move the chords of circles onto them by interpolation of order k, as ``Curve`` does."""
    move = ng.CF((0, 0))
    for hole in plate.holes:
        if isinstance(hole, Circle):
            arm, radius = (
                ng.CF((ng.x, ng.y)) - ng.CF(tuple(map(float, hole.centre))),
                float(hole.radius),
            )
            move += ng.IfPos(radius * (1 + 1e-6) - ng.Norm(arm), radius / ng.Norm(arm) - 1, 0) * arm
    deformation = ng.GridFunction(ng.VectorH1(mesh, order=order))
    deformation.Set(move, definedon=mesh.Boundaries("hole"), dual=True)
    mesh.SetDeformation(deformation)


def volume_ratio(p, mu, gel, steps=2):
    """J*(p) > 1 that solves ln(1 - 1/J) + 1/J + chi/J^2 - Nv/J = mu + p, as an NGSolve expression.

    With w = 1 - 1/J and Nv = chi = 0 this is ln w - w = mu + p - 1, so -w is the Lambert W function
    of -exp(mu + p - 1): its series starts the Newton ``steps``. Two give twelve digits below mu +
    p = -0.9, four below -0.2.
    """
    s = mu + p
    z = ng.exp(s - 1)
    w = z * (1 + z * (1 + z * (3 / 2 + z * (8 / 3 + z * (125 / 24 + z * 54 / 5)))))
    for _ in range(steps):
        value = ng.log(w) + (1 - w) * (1 - gel.Nv) + gel.chi * (1 - w) ** 2 - s
        w = w - value / (1 / w - (1 - gel.Nv) - 2 * gel.chi * (1 - w))
    return 1 / (1 - w)


class MixedGel:
    """One mesh of a plate with its state (u, p), residual, tangent and factorisation."""

    def __init__(self, plate, mesh, order, steps=2):
        self.plate, self.mesh, self.order, self.mu, gel = (
            plate,
            mesh,
            order,
            ng.Parameter(0.0),
            plate.gel,
        )
        displacement = ng.VectorH1(mesh, order=order, dirichletx="x", dirichlety="y")
        space = displacement * ng.L2(mesh, order=order - 1)
        self.free_dofs, self.n_displacement = sum(displacement.FreeDofs()), displacement.ndof
        self.state = ng.GridFunction(space)
        self.u, self.p = self.state.components
        # the default would be a denser rule
        self.dx = ng.dx(intrules={ng.TRIG: ng.IntegrationRule(ng.TRIG, 2 * order - 1)})
        (du, dp), (v, q) = space.TnT()
        grad_u, grad_v = ng.Grad(du), ng.Grad(v)
        self.F = ng.Id(2) + ng.Grad(self.u)
        C = cofactor(self.F)
        self.J, self.compliance = (part.Compile() for part in self.volumes(gel, steps))
        # One term per line, because NGSolve evaluates every factor of an integrand once for each
        # pair of components.
        self.tangent = ng.BilinearForm(space, condense=True)
        self.tangent += (
            gel.Nv * ng.InnerProduct(grad_u, grad_v)
            + self.p * ng.InnerProduct(cofactor(grad_u), grad_v)
        ) * self.dx
        self.tangent += (dp * ng.InnerProduct(C, grad_v) + q * ng.InnerProduct(C, grad_u)) * self.dx
        self.tangent += -self.compliance * dp * q * self.dx
        self.residual = ng.LinearForm(space)
        self.residual += ng.InnerProduct((gel.Nv * self.F + self.p * C).Compile(), grad_v) * self.dx
        self.residual += q * (ng.Det(self.F) - self.J).Compile() * self.dx
        self.step = self.state.vec.CreateVector()
        self.inverse, self.free = None, space.FreeDofs(True)
        # where extrema of the deformed line y = 0 are sought, mm
        self.midline = np.linspace(-0.5, 0.5, 1001) * plate.width

    def volumes(self, gel, steps):
        """J*(p) and dJ*/dp."""
        J = volume_ratio(self.p, self.mu, gel, steps)
        return J, 1 / (1 / (J**2 * (J - 1)) - 2 * gel.chi / J**3 + gel.Nv / J**2)

    @functools.cached_property
    def mass(self):
        """Mass matrix of unit density, as a form."""
        (u, _), (v, _) = self.state.space.TnT()
        return ng.BilinearForm(u * v * self.dx, condense=False).Assemble()

    def factor(self):
        self.tangent.Assemble()
        if self.inverse is None:
            # LDL^T without pivoting
            self.inverse = self.tangent.mat.Inverse(self.free, inverse="sparsecholesky")
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
            # what the next correction would be
            if size < TOLERANCE or (corrections > 1 and size * contraction < TOLERANCE / 10):
                return factorisations, corrections
        raise RuntimeError(f"NGSolve: no equilibrium at mu = {mu}, last correction {size:.1e} mm")

    def follow(self, mus):
        """Equilibria at each of ``mus`` in turn from the present state, extrapolated; yields mu."""
        history, state = [], self.state.vec.FV().NumPy()
        for mu in mus:
            if len(history) > 1:
                state[:] = BarycentricInterpolator(
                    [at for at, _ in history], [before for _, before in history]
                )(mu)
            self.equilibrium(mu)
            history = [*history[-2:], (mu, state.copy())]
            yield mu

    def points(self, x, y):
        """Points of the mesh (m,) at the dry coordinates ``x`` and ``y`` (m,), mm."""
        return self.mesh(x, y)

    def core_rotation(self):
        """Polar rotation of F at the plate's core, degrees."""
        F11, F12, F21, F22 = self.F(
            self.points(*np.array(self.plate.core or (0.0, 0.0))[:, None])
        ).ravel()
        return float(np.degrees(np.arctan2(F21 - F12, F11 + F22)))

    def midline_rotation(self):
        """Angle to the x axis of the line from the midline's lowest to its highest point, degrees.

        The midline is the deformed line y = 0.
        """
        x = self.midline
        y = self.u(self.points(x, 0 * x))[:, 1]
        run, rise = self._extremum(x[y.argmax()]) - self._extremum(x[y.argmin()])
        return float(np.degrees(np.arctan(rise / run)))

    def _extremum(self, x, reach=0.05, degree=4):
        """Point (2,) of the deformed midline extremal in y within ``reach`` of x, mm.

        A polynomial is fitted to the line there.
        """
        t = np.cos(np.pi * np.arange(2 * degree + 1) / (2 * degree))
        dry = np.stack([x + reach * t, 0 * t], axis=1)
        line = np.polynomial.chebyshev.Chebyshev.fit
        along, height = (
            line(t, column, degree, domain=[-1, 1])
            for column in (dry + self.u(self.points(*dry.T))).T
        )
        roots = height.deriv().roots()
        root = roots[np.abs(roots).argmin()].real
        return np.array([along(root), height(root)])

    def energy(self):
        """Total free energy of the dry plate (kT/v mm^2)."""
        J, gel = self.J, self.plate.gel
        mixing = -(J - 1) * ng.log(J / (J - 1)) - gel.chi / J - self.mu * (J - 1)
        return float(
            ng.Integrate(
                (gel.Nv / 2 * (ng.InnerProduct(self.F, self.F) - 2 - 2 * ng.log(J)) + mixing)
                * self.dx,
                self.mesh,
            )
        )

    def modes(self, k=3):
        """Number of negative eigenvalues of the condensed tangent, and k modes (k, n) nearest to 0.

        The number is that of negative pivots (Sylvester); the eigenvalues are with respect to the
        mass of unit density. A mode is placed as the state is, and displaces by 1 mm at most.
        """
        self.tangent.Assemble()
        free = np.flatnonzero(self.free)
        tangent, mass = (sparse(form.mat)[free][:, free] for form in (self.tangent, self.mass))
        lu = splu(
            tangent,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options=dict(SymmetricMode=True, Equil=False),
        )
        values, vectors = eigsh(
            tangent,
            k,
            mass,
            sigma=0,
            OPinv=LinearOperator(tangent.shape, lu.solve),
            v0=np.ones(len(free)),
        )
        modes, order = np.zeros((k, len(self.state.vec))), np.argsort(values)
        for mode, vector in zip(modes, vectors[:, order].T, strict=True):
            self.step.FV().NumPy()[:] = 0
            self.step.FV().NumPy()[free] = vector
            self.step.data += self.tangent.harmonic_extension * self.step
            mode[:] = self.step.FV().NumPy()
            mode /= np.abs(mode[: self.n_displacement]).max()
        return int(np.sum(lu.U.diagonal() < 0)), values[order], modes

    def area_reduction(self):
        """Share of the holes' area that the gel has taken.

        The walls keep their place, so it is the area that the gel has gained.
        """
        dry = float(ng.Integrate(ng.CF(1), self.mesh))
        grown = float(ng.Integrate(ng.Det(self.F) * self.dx, self.mesh))
        return (grown - dry) / (self.plate.width * self.plate.height - dry)

    def outlines(self, parts=8):
        """Points of the outlines, dry and deformed (m, 2), and the ratio (m,) of stretches.

        The ratio is normal to tangential, edge by edge.
        """
        rule = ng.IntegrationRule([(t,) for t in np.arange(parts) / parts], [0.0] * parts)
        points = self.mesh.MapToAllElements(rule, self.mesh.Boundaries("hole"))
        dry, u = (ng.CF(values)(points) for values in ((ng.x, ng.y), self.u))
        tangent = ng.specialcf.tangential(2)
        stretch = ng.Norm(tangent + ng.Grad(self.u).Trace() * tangent)
        # without traction the normal is principal
        ratio = ng.BoundaryFromVolumeCF(ng.Det(self.F)) / stretch**2
        return dry, dry + u, ratio(points)[:, 0]


def sparse(matrix):
    """NGSolve's sparse ``matrix`` as SciPy's."""
    rows, columns, values = (np.array(part) for part in matrix.COO())
    return csc_matrix((values, (rows, columns)), shape=(matrix.height, matrix.width))


def cofactor(A):
    """Cofactor matrix of a 2 x 2 expression: the derivative of its determinant."""
    return ng.CF((A[1, 1], -A[1, 0], -A[0, 1], A[0, 0]), dims=(2, 2))
