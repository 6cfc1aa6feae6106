"""Tangents of many states of one model, multiplied with vectors without being assembled.

With nodal fields as complex numbers z = v_1 + i v_2 the condensed tangent of ``mixed`` is, for a neo-Hookean network and one pressure
per cell,

    K z = (N - i P) z + sum_g (k_g / V_g) G_g Re(conj(G_g) . z),    P = sum_g p_g S_g

with the Laplacian N of the network, the matrices S_g of the cells' volumes and the gradients G_g of these. Of a state there are only P, a
sum of matrices that the model has once, and G. The terms of the bulk stiffness stay factors: their sum, rounded, would limit how exactly
a system can be solved.
"""

import copy

import jax
import numpy as np
import scipy.sparse as sp
from jax import lax

from ..materials import neo_hookean
from .mixed import volume_terms

TOGETHER = 4  # states whose tangents are made together


def has_products(model, gel):
    """Whether `Products` knows the tangents of the model with this gel."""
    return model.method == "mixed" and gel.network is neo_hookean and model.contact is None


class Products:
    """The tangents of a ``model`` and ``gel``, see `has_products`, with ``fixed``, the ``mixed.Constants`` of the model.

    ``crossed`` are ``mixed.crossed_entries`` of these. Vectors have the ``free`` degrees of freedom, see ``constraints``.
    """

    def __init__(self, model, gel, fixed, crossed, free):
        self._inputs, self._free, self._n_nodes = (model, gel, fixed), free, model.n_nodes
        n, (i, j) = model.n_nodes, np.asarray(fixed.pairs).T
        self._upper = sp.csr_matrix((np.zeros(len(i), complex), j, np.searchsorted(i, np.arange(n + 1))), (n, n))
        nodes = [np.asarray(block.nodes) for block in model.blocks]
        ends = np.append(0, np.cumsum(np.concatenate([np.full(*some.shape) for some in nodes])))
        lists = np.concatenate([some.ravel() for some in nodes])
        self._volumes = sp.csr_matrix((np.zeros(len(lists), complex), lists, ends), (len(ends) - 1, n))
        self._by_pairs = _by_pairs(model.lists, fixed, crossed)
        self._network = float(gel.Nv) * np.where(i == j, 0.5, 1.0) * np.asarray(fixed.laplacian)

    def at(self, x, pressure):
        """Yield the functions that multiply a vector (f,) with the tangents of the states ``x`` (k, n, 2) with ``pressure`` (k, g)."""
        together = min(TOGETHER, len(x))
        groups = [np.arange(first, min(first + together, len(x))) for first in range(0, len(x), together)]
        coming = _terms(x[np.resize(groups[0], together)], *self._inputs)  # one number of states, one program
        for number, group in enumerate(groups):
            made = coming
            if number + 1 < len(groups):
                coming = _terms(x[np.resize(groups[number + 1], together)], *self._inputs)  # while the caller is at those of this group
            gradients, stiffness = jax.tree.map(np.asarray, made)
            coupling = self._by_pairs @ pressure[group].T
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
            z = self._spread(v)
            mirrored = z.conj()
            return self._reduced(upper @ z + (below @ mirrored).conj() + back @ (stiffness * (volumes @ mirrored).real))

        return product

    def _spread(self, v):
        """Complex nodal field (n,) of a vector (f,)."""
        full = np.zeros(2 * self._n_nodes + 2)  # the last ones are the padding of degrees of freedom that move together
        full[self._free.T] = v
        return full[:-2].view(complex)

    def _reduced(self, z):
        """Vector (f,) of a complex nodal field (n,) of forces."""
        forces = np.append(z.view(float), 0.0)[self._free]
        return forces if forces.ndim == 1 else forces.sum(axis=1)


@jax.jit
def _terms(x, model, gel, fixed):
    """``mixed.volume_terms`` of several states."""
    return lax.map(lambda x: volume_terms(x, model, gel, fixed), x)


def _by_pairs(lists, fixed, crossed):
    """The sparse matrix (p, c) that takes the pressures of the cells, block after block, to the entries of P at the node pairs."""
    if "places by pairs" not in lists.cache:
        slots, n = [np.asarray(slot) for slot in fixed.slots], len(fixed.pairs)
        flat, counts = np.concatenate([slot.ravel() for slot in slots]), np.concatenate([np.sum(slot < n, axis=1) for slot in slots])
        real = np.flatnonzero(flat < n)  # the others are padding
        lists.cache["places by pairs"] = real, flat[real], np.append(0, np.cumsum(counts)).astype(np.int32)
    real, rows, ends = lists.cache["places by pairs"]
    entries = np.concatenate([np.asarray(part).ravel() for part in crossed])
    return sp.csc_matrix((entries[real], rows, ends), (len(fixed.pairs), len(ends) - 1))
