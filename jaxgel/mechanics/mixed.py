"""Mixed form: pressures of volume groups as unknowns, linearised and condensed.

L(x, p) = network(x) + sum_g V_g [p_g J_g - g*(p_g)] with J_g the volume ratio of the group and
J*(p) = dg*/dp the volume ratio at which the gel carries the pressure p, so every p is feasible. One
Newton step, with G_g = d(V_g J_g)/dx and k = dp/dJ at J*(p):

    [network'' + sum p_g S_g    G     ] [dx]   [loads - network' - G p]
    [G^T                       -V / k ] [dp] = [V (J* - J)            ]

Eliminating dp = k (G^T dx / V + J - J*) group by group leaves the condensed tangent K = network'' +
sum_g [p S_g + (k/V) G_g G_g^T], which is the Hessian of the total energy wherever J = J*(p). V_g
J_g is quadratic in x, and S_g its second derivative.

A gel in a poor solvent has several volume ratios for one p: it is collapsed or swollen, or between,
where k < 0. If it is not stiff the law of a group is therefore linearised about the pressure p(J)
at the volume ratio J of the positions, `volumes.linearised_about`:

    dp = k G^T dx / V + p(J) - p,    in general  dp = k (G^T dx / V + J - J0) + p(J0) - p

with k and p(J0) at J0, J or J*(p). Both end where p = p(J), on whichever branch J lies; the tangent
is the Hessian with every sign of k.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jax import lax

from .._programs import fitted, program
from .._sizes import MANY, resized
from .._types import Array, Chemical, Float
from ..discretisation import Body, Model
from ..materials import LocalGel, elementwise, gel_at_points, gel_in_groups, neo_hookean, network_at
from .conditions import gather
from .contact import contact_energy, contact_force
from .energy import network_energy
from .equations import Equations
from .operators import Operators, area_gradients
from .patchwise import added_over_patches
from .volumes import (
    all_volumes,
    axial_stretch,
    by_block,
    linearised_about,
    of_groups,
    pressure_at,
    ratios_of,
    stiffness_at,
    swelling_of,
    volume_energy,
    volume_ratios,
)

# node pairs whose forces are added up together: few enough to stay in the processor's cache
PAIRS_PER_SUM = MANY
ROUND_OFF = 1e-3  # swelling J* - 1 below which the constraint violation is measured absolutely
# spacings across the plate up to which round-off leaves less than a fifth of Newton's tolerance; it
# grows with their number
FINE = 50
_FIELDS = (
    "energy",
    "rhs",
    "gradients",
    "ratios",
    "stiffness",
    "error",
    "gap",
    "residual_norm",
    "violation",
    "per_force",
)


@functools.partial(jax.tree_util.register_dataclass, data_fields=_FIELDS, meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class Linearisation:
    """The mixed form about one state, in the sizes of the ``shared`` equations."""

    energy: Float[Array, ""]
    """The `total_energy` at the positions, kT/v mm^2."""
    rhs: Float[Array, "n 2"]
    """Loads less internal forces, kT/v mm."""
    gradients: tuple
    """Per block gradients G (c, g, 2, a) of the groups' volumes V J by nodal positions, mm."""
    ratios: Float[Array, " g"]
    """Volume ratios J of the groups; 2 for padding."""
    stiffness: Float[Array, " g"]
    """Bulk stiffness k = dp/dJ at J0, kT/v: J*(p) in stiff groups, J in soft ones."""
    error: Float[Array, " g"]
    """Constraint error J - J0, 0 in soft groups."""
    gap: Float[Array, " g"]
    """Pressure at J0 less p, kT/v, 0 in stiff groups."""
    residual_norm: Float[Array, ""]
    """Norm of the free residual over that of the network's nodal forces and the loads."""
    violation: Float[Array, ""]
    """Largest |J - J0| plus gap over Nv, relative to J0 - 1, over its round-off.

    What round-off leaves on a cloud as fine as this.
    """
    per_force: Float[Array, ""]
    """Factor that makes forces relative, 1 / (kT/v mm)."""

    def cut(self, model: Model) -> "Linearisation":
        """The same in the sizes of a model."""
        shapes = [
            (len(b.nodes), G.shape[1], 2, b.nodes.shape[1])
            for G, b in zip(self.gradients, model.blocks, strict=True)
        ]
        groups = {
            name: fitted(getattr(self, name), "g", model.lengths)
            for name in ("ratios", "stiffness", "error", "gap")
        }
        gradients = tuple(map(resized, self.gradients, shapes))
        return dataclasses.replace(
            self, rhs=fitted(self.rhs, "n", model.lengths), gradients=gradients, **groups
        )


@program(x="n", p="g", mu="g", inside=True)
def linearise(
    problem: Equations, x: Float[Array, "n 2"], p: Float[Array, " g"], mu: Chemical
) -> Linearisation:
    """`Linearisation` at ``x``, mm, and pressures ``p``, kT/v, at ``mu``, kT.

    That is the chemical potential; x are positions.
    """
    model, gel = problem.model, problem.gel
    gradients, J = volume_gradients(x, model, problem.operators)
    about, gap = linearised_about(p, J, model, gel, mu)
    stiffness = stiffness_at(about, model, gel, mu)
    error = jnp.where(all_volumes(model) > 0, J - about, 0.0)
    stored, network = network_energy_and_force(x, model, gel, problem.operators)
    contact, touch = jax.value_and_grad(contact_energy)(x, model)
    energy = stored + volume_energy(J, model, gel, mu) + contact - jnp.sum(problem.loads * x)
    rhs = problem.loads - network - touch - nodal_sum(gradients, p, model)
    off = axial_stretch(model) * jnp.abs(error) + jnp.where(
        gap == 0, 0.0, jnp.abs(gap) / gel_in_groups(gel).Nv
    )
    violation = jnp.max(off / (swelling_of(about, model, gel) + ROUND_OFF)) / jnp.maximum(
        1.0, model.across / FINE
    )
    per_force = 1 / (jnp.linalg.norm(network) + jnp.linalg.norm(problem.loads))
    residual_norm = jnp.linalg.norm(gather(rhs, problem.free)) * per_force
    return Linearisation(
        energy, rhs, gradients, J, stiffness, error, gap, residual_norm, violation, per_force
    )


@program(returns="f", inside=True)
def condensed_rhs(
    problem: Equations, linearisation: Linearisation, factorised_at: Linearisation
) -> Float[Array, " f"]:
    """Right-hand side of the condensed Newton step.

    Gradients and stiffness are those of the factorised tangent.
    """
    pressure = factorised_at.stiffness * linearisation.error + linearisation.gap
    forces = linearisation.rhs - nodal_sum(factorised_at.gradients, pressure, problem.model)
    return gather(forces, problem.free)


def pressure_step(
    dx: Float[Array, "n 2"], linearisation: Linearisation, factorised_at: Linearisation, model: Body
) -> Float[Array, " g"]:
    """Step of the pressures, kT/v, that belongs to the step ``dx`` of the positions."""
    return (
        pressure_change(dx, factorised_at, model)
        + factorised_at.stiffness * linearisation.error
        + linearisation.gap
    )


def pressure_change(
    dx: Float[Array, "n 2"], linearisation: Linearisation, model: Body
) -> Float[Array, " g"]:
    """Change k G^T dx / V of the pressures, kT/v, by ``dx``.

    They carry the volume ratios.
    """
    volumes = all_volumes(model)
    parts = [
        jnp.einsum("cgia,cai->cg", G, dx[b.nodes])
        for G, b in zip(linearisation.gradients, model.blocks, strict=True)
    ]
    return linearisation.stiffness * of_groups(parts, model) / jnp.where(volumes > 0, volumes, 1.0)


def state_pressure(
    x: Float[Array, "n 2"], model: Body, gel: LocalGel, mu: Chemical
) -> Float[Array, " g"]:
    """Pressures of the volume groups at their volume ratios, kT/v: p of an equilibrium at ``x``."""
    return pressure_at(volume_ratios(x, model), model, gel, mu)


def volume_gradients(
    x: Float[Array, "n 2"], model: Body, operators: Operators
) -> tuple[tuple, Float[Array, " g"]]:
    """Per block gradients (c, g, 2, a) of V J, mm, and volume ratios J of all groups.

    2 for padding.
    """
    gradients, content = [], []
    for block, forms in zip(model.blocks, operators.area_forms, strict=True):
        G, contents = area_gradients(forms, x, block)
        gradients.append(G)
        content.append(contents)
    return tuple(gradients), ratios_of(content, model)


def nodal_sum(gradients: tuple, p: Float[Array, " g"], model: Body) -> Float[Array, "n 2"]:
    """sum_g p_g G_g (n, 2), of the ``gradients`` (c, g, 2, a) of each block."""
    total = jnp.zeros(model.nodes.shape)
    for block, G, pressure in zip(model.blocks, gradients, by_block(p, model), strict=True):
        total = added_over_patches(total, _add_forces, (block.nodes, pressure, G), block.count)
    return total


def _add_forces(total, nodes, pressure, G):
    return total.at[nodes].add(jnp.einsum("cg,cgia->cai", pressure, G))


def condensed_forces(
    problem: Equations, x: Float[Array, "n 2"], value: Chemical
) -> tuple[Float[Array, "n 2"], Float[Array, " g"]]:
    """Internal forces less loads (n, 2), kT/v mm, at a ``value``, and the pressures (g,), kT/v.

    The edges are as at that value of the control. The pressures are those of the volume ratios at
    ``x``, so that the forces are the gradient of the total energy.
    """
    now, mu = problem.at(value)
    x, model = problem.placed(x, value), now.model
    gradients, J = volume_gradients(x, model, now.operators)
    pressure = pressure_at(J, model, now.gel, mu)
    _, network = network_energy_and_force(x, model, now.gel, now.operators)
    return network + contact_force(x, model) + nodal_sum(
        gradients, pressure, model
    ) - now.loads, pressure


def network_energy_and_force(
    x: Float[Array, "n 2"], model: Body, gel: LocalGel, operators: Operators
) -> tuple[Float[Array, ""], Float[Array, "n 2"]]:
    """Energy () of the network, kT/v mm^2, and its nodal forces (n, 2), kT/v mm.

    Quadratic and linear in ``x`` if it is neo-Hookean.
    """
    if gel.network is not neo_hookean:
        return jax.value_and_grad(network_energy)(x, model, gel)
    network, at_rest = network_at(gel, model.axial_stretch), 0.0
    for number, block in enumerate(model.blocks):
        F = jnp.zeros((*block.weight.shape, 2, 2))
        at_rest += jnp.sum(
            block.weight
            * elementwise(network, F, gel_at_points(gel, number), signature="(i,j)->()")
        )

    def add(k, total):
        pairs, stiffness = (
            lax.dynamic_slice_in_dim(v, k * PAIRS_PER_SUM, PAIRS_PER_SUM)
            for v in (operators.pairs, operators.network)
        )
        i, j, entries = pairs[:, 0], pairs[:, 1], stiffness[:, None]
        return (
            total.at[i]
            .add(entries * x[j])
            .at[j]
            .add(jnp.where((i != j)[:, None], entries * x[i], 0.0))
        )

    force = lax.fori_loop(
        0, (operators.count + PAIRS_PER_SUM - 1) // PAIRS_PER_SUM, add, jnp.zeros_like(x)
    )
    return at_rest + 0.5 * jnp.sum((x - x[0]) * force), force
