"""Swelling in time by finite elements (NGSolve), for ``swelling.py``.

Displacement of order k, pressure discontinuous of order k - 1, chemical potential continuous of
order k - 1, which is prescribed where the boundary is wetted: the whole of holes and free edges.
The equations are those of jaxgel, the volume ratio is J*(p + mu) as in ``ngsolve_gel``; SDIRK2 with
the mobility of the stage.
"""

import ngsolve as ng
import numpy as np
from ngsolve_gel import cofactor, volume_ratio
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

GAMMA = 1 - 1 / np.sqrt(2)
STEPS = 8  # of Newton's method for the volume ratio
HIGHEST = -0.002  # of mu + p in iterates, kT
TOLERANCE = 1e-9  # of a correction, mm and kT


class Swelling:
    """A mesh of ``ngsolve_gel.plate_mesh`` with a gel in equilibrium at ``start``, kT."""

    def __init__(self, mesh, gel, order, start):
        wet = "|".join(sorted(set(mesh.GetBoundaries()) - {"x", "y"}))
        displacement = ng.VectorH1(mesh, order=order, dirichletx="x", dirichlety="y")
        space = (
            displacement
            * ng.L2(mesh, order=order - 1)
            * ng.H1(mesh, order=order - 1, dirichlet=wet)
        )
        self.mesh, self.space, self.wet, self.tau = mesh, space, wet, ng.Parameter(0.0)
        self.state, self.old, self.first, self.edge = (ng.GridFunction(space) for _ in range(4))
        numbers = np.arange(space.ndof)
        self.prescribed = numbers[
            (numbers >= space.Range(2).start) & ~np.array(list(space.FreeDofs()))
        ]
        self.share = ng.Parameter(0.0)
        (u, p, mu), (v, q, w) = space.TnT()
        F = ng.Id(2) + ng.Grad(u)
        # iterates of a step over a jump of mu leave the range in which a volume ratio exists
        inside = ng.IfPos(p + mu - HIGHEST, HIGHEST, p + mu)
        J, C = volume_ratio(inside, 0.0, gel, STEPS), cofactor(F)
        before, middle = (
            ng.Det(ng.Id(2) + ng.Grad(one.components[0])) for one in (self.old, self.first)
        )
        flux = (J - 1) / J**2 * ng.InnerProduct(C * ng.Grad(mu), C * ng.Grad(w))
        taken = (ng.Det(F) - before - self.share * (middle - before)) * w
        self.form = ng.BilinearForm(space)
        self.form += (
            ng.InnerProduct(gel.Nv * F + p * C, ng.Grad(v))
            + q * (ng.Det(F) - J)
            - taken
            - self.tau * flux
        ).Compile() * ng.dx
        self.state.components[2].Set(start)
        rest = ng.BitArray(space.FreeDofs())
        rest[space.Range(2)] = False
        self._solve(rest)
        self.free = space.FreeDofs()

    def step(self, dt, bath):
        """One step of length ``dt`` with the ``bath`` (2,) at the ends of its stages."""
        self.old.vec.data = self.state.vec
        self.tau.Set(GAMMA * dt)
        for share, mu in zip((0.0, (1 - GAMMA) / GAMMA), bath, strict=True):
            self.share.Set(share)
            self.edge.components[2].Set(mu, definedon=self.mesh.Boundaries(self.wet))
            self.state.vec.FV().NumPy()[self.prescribed] = self.edge.vec.FV().NumPy()[
                self.prescribed
            ]
            self._solve(self.free)
            self.first.vec.data = self.state.vec

    def _solve(self, free):
        """Newton's method for the ``free`` unknowns."""
        at, residual = np.flatnonzero(list(free)), self.state.vec.CreateVector()
        for _ in range(60):
            self.form.Apply(self.state.vec, residual)
            self.form.AssembleLinearization(self.state.vec)
            rows, columns, values = self.form.mat.COO()
            size = self.space.ndof
            matrix = csc_matrix((values, (rows, columns)), shape=(size, size))[at][:, at]
            change = splu(matrix).solve(residual.FV().NumPy()[at])
            self.state.vec.FV().NumPy()[at] -= change
            if np.abs(change).max() < TOLERANCE:
                return
        raise ArithmeticError("Newton's method did not end")

    def ratio(self):
        """Mean volume ratio."""
        F = ng.Id(2) + ng.Grad(self.state.components[0])
        return ng.Integrate(ng.Det(F), self.mesh) / ng.Integrate(1.0, self.mesh)

    def position(self, X):
        """Where the point ``X`` of the dry plate is, mm."""
        return np.array(X) + self.state.components[0](self.mesh(*X))

    def rotation(self, X):
        """Polar rotation at the point ``X`` of the dry plate, degrees."""
        a, b, c, d = ng.Grad(self.state.components[0])(self.mesh(*X))
        return np.degrees(np.arctan2(c - b, 2 + a + d))
