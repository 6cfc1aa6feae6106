"""The condensed tangent of a state: assembled, and as products with vectors.

With nodal fields as complex numbers z = v_1 + i v_2 the condensed tangent of `mixed` is, for a neo-Hookean network,

    K z = (N - i P) z + sum_g (k_g / V_g) G_g Re(conj(G_g) . z),    P = sum_g p_g S_g

with the Laplacian N of the network, the area forms S_g of the volume groups and the gradients G_g of their volumes. The terms of the
bulk stiffness stay factors: their sum, rounded, would limit how exactly a system can be solved. The sparse matrices of a
`TangentOperator` cost as much as two products by `tangent_product`; each further product then costs a sixth of one. Other tangents
(other networks, contact, large models) have none.
"""

import copy
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jax import lax

from .._programs import program
from .._threads import ONE_THREAD
from .._types import Array, Float
from ..linalg import Factor, factor
from ..materials import elementwise, gel_at_points, neo_hookean, network_at
from .conditions import gather, scatter
from .contact import contact_force, contact_tangents
from .equations import Equations
from .mixed import Linearisation, network_energy_and_force, nodal_sum, pressure_change, volume_gradients
from .operators import add_matrices, area_form_sum
from .pairs import contact_pairs, node_pairs
from .patchwise import added_over_patches
from .problem import Problem
from .volumes import all_volumes, bare, by_block, deformation_gradients, stiffness_at

STATES_TOGETHER = 4  # states whose volume gradients are computed together


def tangent(problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation) -> Float[np.ndarray, "p 2 2"]:
    """Condensed tangent K by node pairs, kT/v, about the ``linearisation`` at ``x`` and ``p``, see `mixed`; NumPy.

    With contact the pairs of `contact_pairs` follow.
    """
    blocks, lists = np.asarray(_tangent(problem, x, p, linearisation)), problem.model.lists
    cells = blocks[: len(node_pairs(lists)[0])]
    if problem.model.contact is None:
        return cells
    first = len(blocks) - problem.operators.contact_room
    return np.concatenate([cells, blocks[first : first + len(contact_pairs(lists, problem.model.dmax)[0])]])


@program(x="n", p="g")
def _tangent(problem, x, p, linearisation):
    """The tangent with room for more pairs after those that share a cell, and after the others."""
    model, gel, operators = problem.model, problem.gel, problem.operators
    quadratic, network = gel.network is neo_hookean, network_at(gel, model.axial_stretch)
    total = jnp.zeros((len(operators.pairs), 4))
    if quadratic:
        total += operators.network[:, None] * jnp.eye(2).ravel()

    def add(total, block, p, forms, k_over_V, G, gel, slot):
        S = area_form_sum(p, forms)
        H = k_over_V[:, :, None, None] * G
        outer, zero = jnp.einsum("cgia,cgkb->cabik", H, G), jnp.zeros_like(S)
        K = outer.reshape(*S.shape, 4) + jnp.stack([zero, S, -S, zero], axis=-1)
        if not quadratic:
            A = elementwise(jax.hessian(network), deformation_gradients(x, block), gel, signature="(i,j)->(i,j,k,l)")
            K += jnp.einsum("cq,cqijkl,cqaj,cqbl->cabik", block.weight, A, block.dphi, block.dphi).reshape(K.shape)
        return add_matrices(total, K, slot)

    volumes = all_volumes(model)
    k_over_V = jnp.where(volumes > 0, linearisation.stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0)
    groups = by_block(p, model), by_block(k_over_V, model), operators.area_forms, linearisation.gradients, operators.slots
    for number, (block, pressure, k_over_V, forms, G, slot) in enumerate(zip(model.blocks, *groups, strict=True)):
        shape = block.weight.shape
        there = None if quadratic else jax.tree.map(lambda v, shape=shape: jnp.broadcast_to(v, shape), gel_at_points(gel, number))
        arrays = bare(block), pressure, forms, k_over_V, G, there, slot
        total = added_over_patches(total, add, arrays, block.count)
    total = total.reshape(-1, 2, 2)
    if model.contact is None:
        return total
    total = jnp.concatenate([total, jnp.zeros((operators.contact_room, 2, 2))])
    for blocks, slot in zip(contact_tangents(x, model), operators.contact_slots, strict=True):
        total = add_matrices(total, blocks, slot)
    return total


@program(x="n", p="g", v="f", returns="f")
def tangent_product(
    problem: Equations, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation, v: Float[Array, " f"]
) -> Float[Array, " f"]:
    """Product (f,) of the `tangent` with a vector ``v`` of the free degrees of freedom, which costs as much as a linearisation.

    The gradients of the volumes are linear in the positions, so that S_g v is that of the field v.
    """
    model, field = problem.model, scatter(v, problem.free)
    moved, _ = volume_gradients(field, model, problem.operators)
    p_step = pressure_change(field, linearisation, model)
    forces = jax.jvp(lambda x: network_energy_and_force(x, model, problem.gel, problem.operators)[1], (x,), (field,))[1]
    forces += nodal_sum(moved, p, model) + nodal_sum(linearisation.gradients, p_step, model)
    if model.contact is not None:
        forces += jax.jvp(lambda x: contact_force(x, model), (x,), (field,))[1]
    return gather(forces, problem.free)


def factorised_tangent(problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation) -> Factor:
    """Factor of the `tangent`; raises `linalg.SingularTangent`."""
    return factor(problem.pattern, tangent(problem, x, p, linearisation))


# --- sparse products -----------------------------------------------------------------------------------------------------------


def is_sparse(problem: Problem) -> bool:
    """Whether `TangentOperator` multiplies by sparse matrices."""
    model = problem.model
    own = problem.gel.network is neo_hookean and model.contact is None and model.lists.unknowns is None
    return own and not problem.changes.stiffness and len(problem.free) <= ONE_THREAD


class TangentOperator:
    """Products with the tangents of states of one problem, which are not assembled.

    >>> import jaxgel, numpy as np
    >>> model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.sample("square"), spacing=0.25), basis="linear")
    >>> path = jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1)), [-1.0])
    >>> problem = path.problem.prepared
    >>> (product,) = TangentOperator(problem).at(path.x, path.pressure, path.mu)
    >>> product(np.zeros(len(problem.free))).any()
    np.False_
    """

    def __init__(self, problem: Problem) -> None:
        model = problem.model
        self._problem, self._fields = problem, problem.free.matrix
        self._forces = self._fields.T.tocsr()
        n, (i, j) = model.n_nodes, node_pairs(model.lists)[0].T
        self._upper = sp.csr_matrix((np.zeros(len(i), complex), j, np.searchsorted(i, np.arange(n + 1))), (n, n))
        nodes = [np.repeat(block.nodes, block.n_groups, axis=0) for block in model.blocks]
        ends = np.append(0, np.cumsum(np.concatenate([np.full(*some.shape) for some in nodes])))
        lists = np.concatenate([some.ravel() for some in nodes])
        self._volumes = sp.csr_matrix((np.zeros(len(lists), complex), lists, ends), (len(ends) - 1, n))
        self._network = np.where(i == j, 0.5, 1.0) * problem.network

    def at(self, x: Float[Array, "k n 2"], pressure: Float[Array, "k g"], values: Float[Array, " k"]) -> Iterator[Callable]:
        """Yield for each state the function that multiplies a vector (f,) of the free degrees of freedom with its tangent, kT/v."""
        together = min(STATES_TOGETHER, len(x))
        groups = [np.arange(first, min(first + together, len(x))) for first in range(0, len(x), together)]
        first = np.resize(groups[0], together)
        coming = _state_terms(self._problem, x[first], pressure[first], values[first])  # one number of states, one program
        for number, group in enumerate(groups):
            terms = coming
            if number + 1 < len(groups):  # computed while the caller works with the states of this group
                following = np.resize(groups[number + 1], together)
                coming = _state_terms(self._problem, x[following], pressure[following], values[following])
            gradients, stiffness, couplings = jax.tree.map(np.asarray, terms)
            shapes = [block.nodes.shape for block in self._problem.model.blocks]
            gradients = [np.ascontiguousarray(part[:, :c, :, :a]) for part, (c, a) in zip(gradients, shapes, strict=True)]
            couplings = couplings[:, : len(self._network)]
            for k in range(len(group)):
                yield self._product(couplings[k], stiffness[k], *(part[k] for part in gradients))

    def _product(self, coupling, stiffness, *gradients):
        """Product of one state with its entries (p,) of P, k / V (g,) and gradients per block (c, g, a, 2)."""
        upper, volumes = copy.copy(self._upper), copy.copy(self._volumes)  # the constructor would check the indices once more
        upper.data = self._network.astype(complex)
        upper.data.imag = -coupling  # N - i P is this and its adjoint
        volumes.data = np.concatenate([part.ravel() for part in gradients]).view(complex)
        below, back = upper.T, volumes.T

        def product(v):
            z = (self._fields @ v).view(complex)
            mirrored = z.conj()
            forces = upper @ z + (below @ mirrored).conj() + back @ (stiffness * (volumes @ mirrored).real)
            return self._forces @ forces.view(float)

        return product


@program(x="kn", pressure="kg", returns=(None, "kg", None))
def _state_terms(problem, x, pressure, values):
    """Per block the gradients (k, c, g, a, 2) of the volumes of several states ``x`` (k, n, 2), k / V (k, g), 0 for padding, and the
    entries (k, p) of P at the node pairs.
    """
    model, operators = problem.model, problem.operators
    volumes = all_volumes(model)

    def of_state(state):
        x, pressure, value = state
        gradients, J = volume_gradients(x, model, operators)
        now, mu = problem.at(value)
        stiffness = stiffness_at(J, model, now.gel, mu)
        stiffness = jnp.where(volumes > 0, stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0)
        total = jnp.zeros(len(operators.pairs))
        parts = zip(model.blocks, by_block(pressure, model), operators.area_forms, operators.slots, strict=True)
        for block, p, forms, slot in parts:
            total = added_over_patches(total, _add_area_forms, (p, forms, slot), block.count)
        return [G.swapaxes(2, 3) for G in gradients], stiffness, total

    return lax.map(of_state, (x, pressure, values))


def _add_area_forms(total, p, forms, slot):
    return add_matrices(total, area_form_sum(p, forms), slot)
