"""The mixed form: the pressure of each volume group as an unknown next to the positions, linearised and condensed.

L(x, p) = network(x) + sum_g V_g [p_g J_g - g*(p_g)] with J_g the volume ratio of the group and J*(p) = dg*/dp the volume ratio at
which the gel carries the pressure p, so every p is feasible. One Newton step, with G_g = d(V_g J_g)/dx and k = dp/dJ at J*(p):

    [network'' + sum p_g S_g    G     ] [dx]   [loads - network' - G p]
    [G^T                       -V / k ] [dp] = [V (J* - J)            ]

Eliminating dp = k (G^T dx / V + J - J*) group by group leaves the condensed tangent K = network'' + sum_g [p S_g + (k/V) G_g G_g^T], which
is the Hessian of the total energy wherever J = J*(p). V_g J_g is quadratic in x, and S_g its second derivative.

A gel in a poor solvent has several volume ratios for one p: it is collapsed or swollen, or between, where k < 0. Where it is not stiff the
law of a group is therefore linearised about the pressure p(J) at the volume ratio J of the positions, `volumes.linearised_about`:

    dp = k G^T dx / V + p(J) - p,    in general  dp = k (G^T dx / V + J - J0) + p(J0) - p

with k and p(J0) at J0, J or J*(p). Both end where p = p(J), on whichever branch J lies; the tangent is the Hessian with every sign of k.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, Chemical, Float
from ..discretisation import Model
from ..materials import LocalGel, gel_in_groups, neo_hookean
from .conditions import gather
from .contact import contact_force
from .energy import network_energy
from .operators import Operators, area_gradients
from .problem import Problem
from .volumes import (
    all_volumes,
    axial_stretch,
    by_block,
    linearised_about,
    pressure_at,
    stiffness_at,
    swelling_of,
    volume_ratios,
)

PAIRS_PER_SUM = 2**16  # node pairs whose forces are added up together: few enough to stay in the processor's cache
ROUND_OFF = 1e-3  # swelling J* - 1 below which the constraint violation is measured absolutely
FINE = 50  # spacings across the plate up to which round-off leaves less than a fifth of Newton's tolerance; it grows with their number
_FIELDS = ("rhs", "gradients", "stiffness", "error", "gap", "residual_norm", "violation", "per_force")


@functools.partial(jax.tree_util.register_dataclass, data_fields=_FIELDS, meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class Linearisation:
    """The mixed form about one state."""

    rhs: Float[Array, "n 2"]
    """Loads less internal forces, kT/v mm."""
    gradients: tuple
    """Per block (c, g, 2, a) gradients G of the groups' volumes V J with respect to the patches' nodes, mm."""
    stiffness: Float[Array, " g"]
    """Bulk stiffness k = dp/dJ at J0, kT/v: J*(p) in stiff groups, J in soft ones."""
    error: Float[Array, " g"]
    """Constraint error J - J0, 0 in soft groups."""
    gap: Float[Array, " g"]
    """Pressure at J0 less p, kT/v, 0 in stiff groups."""
    residual_norm: Float[Array, ""]
    """Norm of the residual on the free degrees of freedom, over that of the network's nodal forces and the loads."""
    violation: Float[Array, ""]
    """Largest |J - J0|, plus gap over Nv, relative to J0 - 1, over what round-off leaves on a cloud as fine as this."""
    per_force: Float[Array, ""]
    """Factor that makes forces relative, 1 / (kT/v mm)."""


@jax.jit
def linearise(problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], mu: Chemical) -> Linearisation:
    """`Linearisation` at positions ``x``, mm, and pressures ``p``, kT/v, at the chemical potential ``mu``, kT."""
    model, gel = problem.model, problem.gel
    gradients, J = volume_gradients(x, model, problem.operators)
    about, gap = linearised_about(p, J, model, gel, mu)
    stiffness = stiffness_at(about, model, gel, mu)
    error = jnp.where(all_volumes(model) > 0, J - about, 0.0)
    network = network_force(x, model, gel, problem.operators)
    touch = contact_force(x, model) if model.contact is not None else 0.0
    rhs = problem.loads - network - touch - nodal_sum(gradients, p, model)
    topology = model.lists.topology
    across = max(topology.plate.width, topology.plate.height) / topology.node_spacing.min()
    off = axial_stretch(model) * jnp.abs(error) + jnp.where(gap == 0, 0.0, jnp.abs(gap) / gel_in_groups(gel).Nv)
    violation = jnp.max(off / (swelling_of(about, model, gel) + ROUND_OFF)) / max(1.0, across / FINE)
    per_force = 1 / (jnp.linalg.norm(network) + jnp.linalg.norm(problem.loads))
    residual_norm = jnp.linalg.norm(gather(rhs, problem.free)) * per_force
    return Linearisation(rhs, gradients, stiffness, error, gap, residual_norm, violation, per_force)


@jax.jit
def condensed_rhs(problem: Problem, linearisation: Linearisation, factorised_at: Linearisation) -> Float[Array, " f"]:
    """Right-hand side of the condensed Newton step; gradients and stiffness are those of the factorised tangent."""
    pressure = factorised_at.stiffness * linearisation.error + linearisation.gap
    forces = linearisation.rhs - nodal_sum(factorised_at.gradients, pressure, problem.model)
    return gather(forces, problem.free)


def pressure_step(dx: Float[Array, "n 2"], linearisation: Linearisation, factorised_at: Linearisation, model: Model) -> Float[Array, " g"]:
    """Step of the pressures, kT/v, that belongs to the step ``dx`` of the positions."""
    volumes = all_volumes(model)
    parts = [jnp.einsum("cgia,cai->cg", G, dx[b.nodes]).ravel() for G, b in zip(factorised_at.gradients, model.blocks, strict=True)]
    change = jnp.concatenate(parts) / jnp.where(volumes > 0, volumes, 1.0)
    return factorised_at.stiffness * (change + linearisation.error) + linearisation.gap


@jax.jit
def state_pressure(x: Float[Array, "n 2"], model: Model, gel: LocalGel, mu: Chemical) -> Float[Array, " g"]:
    """Pressure of the volume groups at their volume ratios, kT/v: the p of an equilibrium at ``x``."""
    return pressure_at(volume_ratios(x, model), model, gel, mu)


def volume_gradients(x: Float[Array, "n 2"], model: Model, operators: Operators) -> tuple[tuple, Float[Array, " g"]]:
    """Per block the gradients (c, g, 2, a) of the groups' volumes V J, mm, and the volume ratios J of all groups; 2 for padding."""
    gradients, content = [], []
    for block, forms in zip(model.blocks, operators.area_forms, strict=True):
        G, contents = area_gradients(forms, x, block.nodes)
        gradients.append(G)
        content.append(contents.ravel())
    volumes = all_volumes(model)
    return tuple(gradients), jnp.where(volumes > 0, jnp.concatenate(content) / jnp.where(volumes > 0, volumes, 1.0), 2.0)


def nodal_sum(gradients: tuple, p: Float[Array, " g"], model: Model) -> Float[Array, "n 2"]:
    """sum_g p_g G_g (n, 2), of the ``gradients`` (c, g, 2, a) of each block."""
    total = jnp.zeros((model.n_nodes, 2))
    for block, G, pressure in zip(model.blocks, gradients, by_block(p, model), strict=True):
        total = total.at[block.nodes].add(jnp.einsum("cg,cgia->cai", pressure, G))
    return total


def network_force(x: Float[Array, "n 2"], model: Model, gel: LocalGel, operators: Operators) -> Float[Array, "n 2"]:
    """Nodal forces (n, 2) of the network, kT/v mm."""
    if gel.network is not neo_hookean:
        return jax.grad(network_energy)(x, model, gel)

    def add(total, first, size):
        pairs, stiffness = (lax.dynamic_slice_in_dim(v, first, size) for v in (operators.pairs, operators.network))
        i, j, entries = pairs[:, 0], pairs[:, 1], stiffness[:, None]
        return total.at[i].add(entries * x[j]).at[j].add(jnp.where((i != j)[:, None], entries * x[i], 0.0))

    whole, rest = divmod(len(operators.pairs), PAIRS_PER_SUM)
    total = jnp.zeros_like(x)
    if whole:
        total = lax.fori_loop(0, whole, lambda k, total: add(total, k * PAIRS_PER_SUM, PAIRS_PER_SUM), total)
    return add(total, whole * PAIRS_PER_SUM, rest)
