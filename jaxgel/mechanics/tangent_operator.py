"""Products K v with the tangents of states, for all who multiply: eigenvalues, adjoint systems, critical points.

With nodal fields as complex numbers z = v_1 + i v_2 the condensed tangent of `mixed` is, for a neo-Hookean network and one pressure per
cell,

    K z = (N - i P) z + sum_g (k_g / V_g) G_g Re(conj(G_g) . z),    P = sum_g p_g S_g

with the Laplacian N of the network, the area forms S_g of the cells and the gradients G_g of their volumes. A state has only P, a sum of
matrices that the model has once, and G. The terms of the bulk stiffness stay factors: their sum, rounded, would limit how exactly a system
can be solved. Other tangents (other networks, contact, large models) are multiplied by a derivative of the residual.
"""

import copy
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jax import lax

from .._memo import once_per_owner
from .._threads import ONE_THREAD
from .._types import Array, Float, Scalar
from ..materials import bulk_stiffness, neo_hookean
from .dofs import gather, scatter
from .energy import all_volumes, residual
from .mixed import volume_gradients
from .operators import area_form_entries
from .pairs import node_pairs
from .problem import Problem

STATES_TOGETHER = 4  # states whose volume gradients are computed together


class TangentOperator:
    """Products with the tangents of states of one problem, which are not assembled.

    >>> import jaxgel, numpy as np
    >>> from jaxgel.mechanics import prepare
    >>> model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.sample("square"), spacing=0.25), basis="linear")
    >>> path = jaxgel.sweep(model, jaxgel.Gel(1e-3, 0.1), mu=[-1.0])
    >>> problem = prepare(model, path.gel)
    >>> (product,) = TangentOperator(problem).at(path.x, path.pressure, path.mu)
    >>> product(np.zeros(len(problem.free))).any()
    np.False_
    """

    def __init__(self, problem: Problem, entries: list | None = None):
        """``entries`` are the `operators.area_form_entries`, where they are known already."""
        self.problem = problem
        self._sparse = (
            _Sparse(problem, area_form_entries(problem.operators) if entries is None else entries) if is_sparse(problem) else None
        )

    def at(self, x: Float[Array, "k n 2"], pressure: Float[Array, "k g"], mu: Float[Array, " k"]) -> Iterator[Callable]:
        """Yield for each state the function that multiplies a vector (f,) of the free degrees of freedom with its tangent, kT/v."""
        if self._sparse is not None:
            yield from self._sparse.at(x, pressure)
            return
        for state in zip(x, pressure, mu, strict=True):
            yield lambda v, state=state: np.asarray(tangent_product(self.problem, *state, v))


def is_sparse(problem: Problem) -> bool:
    """Whether `TangentOperator` multiplies by sparse matrices."""
    model = problem.model
    own = model.method == "mixed" and problem.gel.network is neo_hookean and model.contact is None
    return own and len(problem.free) <= ONE_THREAD


@jax.jit
def tangent_product(problem: Problem, x: Float[Array, "n 2"], pressure: Float[Array, " g"], mu: Scalar, v: Float[Array, " f"]) -> jax.Array:
    """Product (f,) of the Hessian of the total energy with ``v``, by a derivative of the residual; traceable."""

    def force(x):
        return residual(x, problem.model, problem.gel, mu, problem.loads, pressure)

    return gather(jax.jvp(force, (x,), (scatter(v, x.shape, problem.free),))[1], problem.free)


class _Sparse:
    """The products by sparse matrices with a fixed pattern."""

    def __init__(self, problem, entries):
        model, operators = problem.model, problem.operators
        self._problem, self._free, self._n_nodes = problem, np.asarray(operators.free), model.n_nodes
        n, (i, j) = model.n_nodes, np.asarray(operators.pairs).T
        self._upper = sp.csr_matrix((np.zeros(len(i), complex), j, np.searchsorted(i, np.arange(n + 1))), (n, n))
        nodes = [np.asarray(block.nodes) for block in model.blocks]
        ends = np.append(0, np.cumsum(np.concatenate([np.full(*some.shape) for some in nodes])))
        lists = np.concatenate([some.ravel() for some in nodes])
        self._volumes = sp.csr_matrix((np.zeros(len(lists), complex), lists, ends), (len(ends) - 1, n))
        self._by_pairs = _by_pairs(model.lists, operators, entries)
        self._network = float(problem.gel.Nv) * np.where(i == j, 0.5, 1.0) * np.asarray(operators.laplacian)

    def at(self, x, pressure):
        together = min(STATES_TOGETHER, len(x))
        groups = [np.arange(first, min(first + together, len(x))) for first in range(0, len(x), together)]
        coming = _volume_terms(self._problem, x[np.resize(groups[0], together)])  # one number of states, one program
        for number, group in enumerate(groups):
            terms = coming
            if number + 1 < len(groups):  # computed while the caller works with the states of this group
                coming = _volume_terms(self._problem, x[np.resize(groups[number + 1], together)])
            gradients, stiffness = jax.tree.map(np.asarray, terms)
            coupling = self._by_pairs @ np.asarray(pressure[group]).T
            for k in range(len(group)):
                yield self._product(coupling[:, k], stiffness[k], *(part[k] for part in gradients))

    def _product(self, coupling, stiffness, *gradients):
        """Product of one state with its entries (p,) of P, k / V (g,) and gradients per block (c, 1, a, 2)."""
        upper, volumes = copy.copy(self._upper), copy.copy(self._volumes)  # the constructor would check the indices once more
        upper.data = self._network.astype(complex)
        upper.data.imag = -coupling  # N - i P is this and its adjoint
        volumes.data = np.concatenate([part.ravel() for part in gradients]).view(complex)
        below, back = upper.T, volumes.T

        def product(v):
            z = self._complex_field(v)
            mirrored = z.conj()
            return self._forces(upper @ z + (below @ mirrored).conj() + back @ (stiffness * (volumes @ mirrored).real))

        return product

    def _complex_field(self, v):
        """Complex nodal field (n,) of a vector (f,)."""
        full = np.zeros(2 * self._n_nodes + 2)  # the last ones are the padding of degrees of freedom that move together
        full[self._free.T] = v
        return full[:-2].view(complex)

    def _forces(self, z):
        """Vector (f,) of a complex nodal field (n,) of forces."""
        forces = np.append(z.view(float), 0.0)[self._free]
        return forces if forces.ndim == 1 else forces.sum(axis=1)


@jax.jit
def _volume_terms(problem, x):
    """Gradients of the volumes of several states ``x`` (k, n, 2), as in `mixed.Linearisation`, and k / V (k, g), 0 for padding."""

    def of_state(x):
        gradients, J = volume_gradients(x, problem.model, problem.operators)
        volumes = all_volumes(problem.model)
        return gradients, jnp.where(volumes > 0, bulk_stiffness(J, problem.gel) / jnp.where(volumes > 0, volumes, 1.0), 0.0)

    return lax.map(of_state, x)


def _by_pairs(lists, operators, entries):
    """The sparse matrix (p, c) that takes the pressures of the cells, block after block, to the entries of P at the node pairs."""
    real, rows, ends = _entry_positions(lists)
    values = np.concatenate([np.asarray(part).ravel() for part in entries])
    return sp.csc_matrix((values[real], rows, ends), (len(operators.pairs), len(ends) - 1))


@once_per_owner
def _entry_positions(lists):
    """Which entries of the area forms are real, the node pair of each, and where the entries of each cell begin."""
    pairs, slots = node_pairs(lists)
    n = len(pairs)
    flat, counts = np.concatenate([slot.ravel() for slot in slots]), np.concatenate([np.sum(slot < n, axis=1) for slot in slots])
    real = np.flatnonzero(flat < n)  # the others are padding
    return real, flat[real], np.append(0, np.cumsum(counts)).astype(np.int32)
