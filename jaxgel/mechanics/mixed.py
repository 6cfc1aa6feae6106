"""The mixed form: the pressure of each volume group as an unknown next to the positions, linearised and condensed.

L(x, p) = network(x) + sum_g V_g [p_g J_g - g*(p_g)] with J_g the mean volume ratio of the group and J*(p) = dg*/dp the volume ratio at
which the gel carries the pressure p, so every p is feasible. One Newton step, with G_g = d(V_g J_g)/dx and k = dp/dJ at J*(p):

    [network'' + sum p_g S_g    G     ] [dx]   [loads - network' - G p]
    [G^T                       -V / k ] [dp] = [V (J* - J)            ]

Eliminating dp = k (G^T dx / V + J - J*) group by group leaves the condensed tangent K = network'' + sum_g [p S_g + (k/V) G_g G_g^T], which
is the Hessian of the total energy wherever J = J*(p). In the plane V J = x_1^T S x_2 with a constant antisymmetric matrix S per cell, so
for a neo-Hookean network and one pressure per cell the quadrature points are not needed after the setup.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..materials import bulk_stiffness, neo_hookean, osmotic, volume_ratio_at
from .contact import contact_force
from .energy import all_volumes, by_block, deformation_gradients, network_energy, volume_ratios

TOGETHER = 1024  # cells whose volume gradients, or pairs of nodes, are made together, for the same reason
PAIRS = 2**16  # pairs of nodes whose forces are added up together, likewise
ROTATION = np.array([[0.0, 1.0], [-1.0, 0.0]])  # det(a, b) = a . ROTATION b; cof F = R F R^T
ROUND_OFF = 1e-3  # swelling J* - 1 below which the constraint is judged absolutely


@functools.partial(jax.tree_util.register_dataclass, data_fields=["rhs", "gradients", "stiffness", "error"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Linearisation:
    """The mixed form about one state."""

    rhs: jax.Array
    """(n, 2) loads less internal forces, kT/v mm."""
    gradients: tuple
    """Per block (c, g, a, 2) gradients G of the groups' volumes V J with respect to the cells' nodes, mm."""
    stiffness: jax.Array
    """(g,) bulk stiffness k = dp/dJ at J*(p), kT/v."""
    error: jax.Array
    """(g,) constraint error J - J*(p)."""


def state_pressure(x, model, gel, mu):
    """Pressure (g,) of the volume groups at their volume ratios, kT/v: the p of an equilibrium at ``x`` (n, 2)."""
    return osmotic(volume_ratios(x, model), mu, gel)


def volume_terms(x, model, gel, fixed):
    """What the volumes give the tangent at an equilibrium ``x`` (n, 2): gradients as in `Linearisation`, and k / V (g,), 0 for padding."""
    gradients, J = _volume_gradients(x, model, fixed)
    volumes = all_volumes(model)
    return gradients, jnp.where(volumes > 0, bulk_stiffness(J, gel) / jnp.where(volumes > 0, volumes, 1.0), 0.0)


def linearise(x, p, model, gel, mu, loads, fixed):
    """``Linearisation`` at positions ``x`` (n, 2) and pressures ``p`` (g,), and two measures of the distance from equilibrium.

    The measures are the norm of the network's forces (the scale of residuals) and the largest |J - J*| relative to J* - 1.
    """
    gradients, J = _volume_gradients(x, model, fixed)
    star = volume_ratio_at(p, mu, gel)
    error = jnp.where(all_volumes(model) > 0, J - star, 0.0)
    network = _network_force(x, model, gel, fixed)
    touch = contact_force(x, model) if model.contact is not None else 0.0
    rhs = loads - network - touch - _nodal_sum(gradients, p, model)
    measures = jnp.linalg.norm(network), jnp.max(jnp.abs(error) / (star - 1 + ROUND_OFF))
    return Linearisation(rhs, gradients, bulk_stiffness(star, gel), error), measures


def condensed_rhs(now, basis, model):
    """Right-hand side (n, 2) of the condensed step with the gradients and stiffness of ``basis``: those of the factorised tangent."""
    return now.rhs - _nodal_sum(basis.gradients, basis.stiffness * now.error, model)


def volume_product(v, p, basis, model, fixed):
    """Product (n, 2) of the volume's share of the tangent about ``basis``, sum_g [p S_g + (k/V) G_g G_g^T], with ``v`` (n, 2)."""
    changes, volumes = _volume_gradients(v, model, fixed)[0], all_volumes(model)
    rates = [jnp.einsum("cgai,cai->cg", G, v[b.nodes]).ravel() for G, b in zip(basis.gradients, model.blocks, strict=True)]
    rates = basis.stiffness * jnp.concatenate(rates) / jnp.where(volumes > 0, volumes, 1.0)
    pairs = zip(changes, basis.gradients, by_block(p, model), by_block(rates, model), strict=True)
    weighted = [jnp.einsum("cg,cgai->cai", p, change) + jnp.einsum("cg,cgai->cai", rate, G) for change, G, p, rate in pairs]
    return _at_nodes(weighted, model)


def pressure_step(dx, now, basis, model):
    """Step (g,) of the pressures that belongs to the step ``dx`` (n, 2) of the positions."""
    volumes = all_volumes(model)
    parts = [jnp.einsum("cgai,cai->cg", G, dx[b.nodes]).ravel() for G, b in zip(basis.gradients, model.blocks, strict=True)]
    return basis.stiffness * (jnp.concatenate(parts) / jnp.where(volumes > 0, volumes, 1.0) + now.error)


def _volume_gradients(x, model, fixed):
    """Per block the gradients (c, g, a, 2) of the groups' volumes V J, and the volume ratios J (g,) of all groups; 2 for padding."""
    gradients, content = [], []
    for block, S in zip(model.blocks, fixed.crossed, strict=True):
        if model.method == "mixed":
            G, contents = _crossed_gradients(S, x, block.nodes)
            G, contents = G[:, None], contents[:, None]
        else:
            cofactor = jnp.einsum("ik,cqkl,jl->cqij", ROTATION, deformation_gradients(x, block), ROTATION)
            G = jnp.einsum("cq,cqij,cqaj->cqai", block.weight, cofactor, block.dphi)
            contents = 0.5 * jnp.einsum("cgai,cai->cg", G, _local(x, block.nodes))
        gradients.append(G)
        content.append(contents.ravel())
    volumes = all_volumes(model)
    return tuple(gradients), jnp.where(volumes > 0, jnp.concatenate(content) / jnp.where(volumes > 0, volumes, 1.0), 2.0)


def _local(x, nodes):
    """Positions (c, a, 2) of the cells' ``nodes`` (c, a) from the first: without this round-off grows like (x / spacing)^2."""
    return x[nodes] - x[nodes[:, :1]]


def _crossed_gradients(S, x, nodes):
    """Gradients (c, a, 2) of the cells' V J at their ``nodes`` (c, a), and V J (c,), from their matrices S; the last may be made twice."""

    def of(S, nodes):
        local = _local(x, nodes)  # S annihilates translations
        G = jnp.stack([_crossed_product(S, local[..., 1]), -_crossed_product(S, local[..., 0])], axis=-1)
        return G, 0.5 * jnp.sum(G * local, axis=(1, 2))  # V J is quadratic in x

    def add(k, total):
        first = jnp.minimum(k * TOGETHER, len(S) - TOGETHER)
        parts = of(*(lax.dynamic_slice_in_dim(v, first, TOGETHER) for v in (S, jnp.asarray(nodes))))
        return tuple(lax.dynamic_update_slice_in_dim(t, part, first, 0) for t, part in zip(total, parts, strict=True))

    if len(S) <= TOGETHER:
        return of(S, nodes)
    return lax.fori_loop(0, -(-len(S) // TOGETHER), add, (jnp.zeros((*nodes.shape, 2), x.dtype), jnp.zeros(len(S), x.dtype)))


def _crossed_product(S, v):
    """Products (c, a) of the cells' matrices S, see ``Constants.crossed``, with ``v`` (c, a); sums of rows, which XLA vectorises."""
    halves = jnp.sum(S * v[:, None], axis=2)
    if S.shape[1] == S.shape[2]:
        return halves
    first, second = jnp.split(halves, 2, axis=1)
    return jnp.sum(S * jnp.concatenate([second, -first], axis=1)[:, :, None], axis=1)


def _crossed_matrix(S):
    """The matrix (a, a) of one cell from either form of ``Constants.crossed``."""
    if S.shape[0] == S.shape[1]:
        return S
    first, second = jnp.split(S, 2)
    return first.T @ second - second.T @ first


def _nodal_sum(gradients, p, model):
    """sum_g p_g G_g (n, 2)."""
    parts = zip(by_block(p, model), gradients, strict=True)
    return _at_nodes([jnp.einsum("cg,cgai->cai", pressure, G) for pressure, G in parts], model)


def _at_nodes(forces, model):
    """Sum (n, 2) of forces at the nodes of the cells, per block (c, a, 2)."""
    total = jnp.zeros((model.n_nodes, 2))
    for block, force in zip(model.blocks, forces, strict=True):
        total = total.at[block.nodes].add(force)
    return total


def _network_force(x, model, gel, fixed):
    """Nodal forces (n, 2) of the network, kT/v mm."""
    if gel.network is not neo_hookean:
        return jax.grad(network_energy)(x, model, gel)

    def add(total, first, size):
        pairs, laplacian = (lax.dynamic_slice_in_dim(v, first, size) for v in (fixed.pairs, fixed.laplacian))
        i, j, entries = pairs[:, 0], pairs[:, 1], gel.Nv * laplacian[:, None]
        return total.at[i].add(entries * x[j]).at[j].add(jnp.where((i != j)[:, None], entries * x[i], 0.0))

    whole, rest = divmod(len(fixed.pairs), PAIRS)
    total = jnp.zeros_like(x)
    if whole:
        total = lax.fori_loop(0, whole, lambda k, total: add(total, k * PAIRS, PAIRS), total)
    return add(total, whole * PAIRS, rest)
