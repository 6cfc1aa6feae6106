"""Total energy of a model as one pure function of the nodal positions, its residual, and the condensed tangent of the mixed form.

Energies are in kT/v times mm^2, forces in kT/v times mm. Index letters as in ``discretisation``; ``g`` is a volume group: a cell
(method "mixed") or a single quadrature point (method "displacement"). Quantities of all groups are one vector, block after block.

The mixed form takes the pressure p of each group as an unknown next to the positions, L(x, p) = network(x) + sum_g V_g [p_g J_g - g*(p_g)],
with J_g the mean volume ratio and J*(p) the volume ratio at which a free gel carries the pressure p. Linearised and with p eliminated
group by group, its tangent is the Hessian of the total energy wherever J_g = J*(p_g).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .linear_solve import analyse
from .material import bulk_stiffness, neo_hookean, volume_ratio_at

CHUNK = 32  # cells whose tangents are added up together: few enough to stay in the cache
ROTATION = np.array([[0.0, 1.0], [-1.0, 0.0]])  # det(a, b) = a . ROTATION b


def deformation_gradients(x, block):
    """Deformation gradients (c, q, 2, 2) at the quadrature points of a block for nodal positions ``x`` (n, 2)."""
    return jnp.einsum("cai,cqaj->cqij", x[block.nodes], block.dphi)


def group_volumes(block, method):
    """Dry volumes (c, g) of a block's volume groups, mm^2; 0 for padding."""
    return jnp.sum(block.weight, axis=1, keepdims=True) if method == "mixed" else block.weight


def volume_ratios(x, model):
    """Mean volume ratios (g,) of all volume groups; 2 for padding."""
    ratios = []
    for block in model.blocks:
        volume, J = group_volumes(block, model.method), jnp.linalg.det(deformation_gradients(x, block))
        if model.method == "mixed":
            J = jnp.sum(block.weight * J, axis=1, keepdims=True) / volume
        ratios.append(jnp.where(volume > 0, J, 2.0).ravel())
    return jnp.concatenate(ratios)


def all_volumes(model):
    """Dry volumes (g,) of all volume groups, mm^2; 0 for padding."""
    return jnp.concatenate([group_volumes(block, model.method).ravel() for block in model.blocks])


def by_block(values, model):
    """Values (g,) of all volume groups as arrays (c, g) per block."""
    shapes = [(len(b.weight), 1) if model.method == "mixed" else b.weight.shape for b in model.blocks]
    cuts = np.cumsum([rows * columns for rows, columns in shapes])[:-1]
    return [part.reshape(shape) for part, shape in zip(jnp.split(values, cuts), shapes, strict=True)]


def total_energy(x, model, gel, mu, loads):
    """Total energy (), kT/v mm^2, at nodal positions ``x`` (n, 2): free energy of the gel less the work of dead ``loads`` (n, 2).

    The weak form of Deng et al. (2020), Eqs. (3) and (10), is its first variation. NaN where a volume ratio is not above 1.
    """
    swelling = jax.vmap(lambda J: gel.volumetric(J, gel) - mu * (J - 1))(volume_ratios(x, model))
    return network_energy(x, model, gel) + jnp.sum(all_volumes(model) * swelling) - jnp.sum(loads * x)


def network_energy(x, model, gel):
    """Energy () of the network alone, kT/v mm^2."""
    density = jax.vmap(jax.vmap(lambda F: gel.network(F, gel)))
    return sum(jnp.sum(block.weight * density(deformation_gradients(x, block))) for block in model.blocks)


residual = jax.grad(total_energy)
"""Residual (n, 2) of the total energy, kT/v mm: zero on the free degrees of freedom at equilibrium."""


def mixed_terms(x, p, model, gel, mu):
    """Constraint error J - J*(p) (g,), bulk stiffness k = dp/dJ at J*(p) (g,), and J*(p) (g,) of all volume groups."""
    star = volume_ratio_at(p, mu, gel)
    error = jnp.where(all_volumes(model) > 0, volume_ratios(x, model) - star, 0.0)
    return error, bulk_stiffness(star, gel), star


def internal_force(x, p, model, gel):
    """Nodal forces (n, 2), kT/v mm, of the network and of given pressures (g,)."""
    volumes = all_volumes(model)
    return jax.grad(lambda x: network_energy(x, model, gel) + jnp.sum(p * volumes * volume_ratios(x, model)))(x)


def network_force(x, model, gel):
    """Nodal forces (n, 2) of the network alone, kT/v mm: the scale against which residuals are judged."""
    return jax.grad(network_energy)(x, model, gel)


# --- tangent -----------------------------------------------------------------------------------------------------------------


def node_pairs(lists):
    """Node pairs (p, 2), i <= j, that share a cell, and per block the pair (c, t) of each entry a <= b of a cell's node list."""
    if "pairs" not in lists.cache:
        n = len(lists.topology.node_vertices)
        keys = []
        for cells in lists.cells:
            real = lists.support[cells] > 0
            width = int(real.sum(axis=1).max())
            a, b = np.triu_indices(width)
            nodes = lists.nodes[cells].astype(np.int64)
            keys.append(np.where(real[:, a] & real[:, b], nodes[:, a] * n + nodes[:, b], n * n))
        unique = np.unique(np.concatenate([key.ravel() for key in keys]))
        unique = unique[unique < n * n]
        slots = tuple(np.searchsorted(unique, key).astype(np.int32) for key in keys)  # padding: one past the end, dropped
        lists.cache["pairs"] = np.stack([unique // n, unique % n], axis=1), slots
    return lists.cache["pairs"]


def tangent_pattern(lists, free):
    """``linear_solve.Pattern`` of the tangent for the free degrees of freedom (f,); kept with the lists."""
    key = ("pattern", free.tobytes())
    if key not in lists.cache:
        lists.cache[key] = analyse(node_pairs(lists)[0], len(lists.topology.node_vertices), free)
    return lists.cache[key]


def tangent_constants(model):
    """What the tangents of a model have in common: the Laplacian by node pairs (p, 1, 1); per block the matrices (c, a, a)
    S_ab = sum_q w (dphi_a1 dphi_b2 - dphi_a2 dphi_b1), with sum_q w_q J_q = x_1^T S x_2; and the slots of ``node_pairs``."""
    pairs, slots = node_pairs(model.lists)
    return _tangent_constants(jnp.zeros((len(pairs), 1, 1)), tuple((b.dphi, b.weight) for b in model.blocks), slots)


@jax.jit
def _tangent_constants(total, blocks, slots):

    def laplacian(block):
        return jnp.einsum("q,qai,qbi->ab", block[1], block[0], block[0])[:, :, None, None]

    def crossed(block):
        return jnp.einsum("q,qai,ij,qbj->ab", block[1], block[0], ROTATION, block[0])

    for arrays, slot in zip(blocks, slots, strict=True):
        total = _add_cells(total, laplacian, arrays, slot, arrays[0].shape[2])
    return total, tuple(lax.map(crossed, arrays, batch_size=CHUNK) for arrays in blocks), tuple(map(jnp.asarray, slots))


def tangent(x, p, stiffness, model, gel, constants):
    """Condensed tangent of the mixed form by node pairs (p, 2, 2), kT/v; the Hessian of ``total_energy`` where J = J*(p).

    ``p`` and ``stiffness`` dp/dJ are (g,); ``constants`` come from ``tangent_constants``. K = network + sum_g p S_g + (k/V) G_g G_g^T
    with G_g the gradient of V_g J_g.
    """
    laplacian, crossed, slots = constants
    quadratic = gel.network is neo_hookean
    total = gel.Nv * laplacian * jnp.eye(2) if quadratic else jnp.zeros((len(laplacian), 2, 2))

    def cell(arrays):
        x, dphi, weight, p, k_over_V, S = arrays
        F = jnp.einsum("ai,qaj->qij", x, dphi)
        G = jnp.einsum("q,ik,qkl,jl,qaj->qai", weight, ROTATION, F, ROTATION, dphi)  # w_q dJ_q/dx: cof F = R F R^T
        if model.method == "mixed":
            G, geometric = jnp.sum(G, axis=0, keepdims=True), p[0] * S
        else:
            geometric = jnp.einsum("q,qai,ij,qbj->ab", weight * p, dphi, ROTATION, dphi)
        K = jnp.einsum("g,gai,gbk->abik", k_over_V, G, G) + geometric[:, :, None, None] * ROTATION
        if not quadratic:
            A = jax.vmap(jax.hessian(lambda F: gel.network(F, gel)))(F)
            K += jnp.einsum("q,qijkl,qaj,qbl->abik", weight, A, dphi, dphi)
        return K

    volumes = all_volumes(model)
    k_over_V = jnp.where(volumes > 0, stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0)
    groups = (by_block(p, model), by_block(k_over_V, model))
    for block, pressure, k_over_V, S, slot in zip(model.blocks, *groups, crossed, slots, strict=True):
        total = _add_cells(total, cell, (x[block.nodes], block.dphi, block.weight, pressure, k_over_V, S), slot, S.shape[1])
    return total


def _add_cells(total, cell, arrays, slots, n):
    """``total`` (p, ...) plus the upper entries of the cell matrices ``cell(arrays[c])`` (n, n, ...) at their ``slots`` (c, t)."""
    a, b = np.triu_indices(n)

    def add(total, chunk):
        arrays, slots = chunk
        return total.at[slots].add(jax.vmap(cell)(arrays)[:, a, b], mode="drop"), None

    whole = len(slots) // CHUNK * CHUNK
    head = jax.tree.map(lambda v: v[:whole].reshape(whole // CHUNK, CHUNK, *v.shape[1:]), (arrays, slots))
    total, _ = lax.scan(add, total, head)
    return add(total, jax.tree.map(lambda v: v[whole:], (arrays, slots)))[0]
