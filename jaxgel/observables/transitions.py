"""Phases of a gel in a poor solvent: where it is collapsed and where swollen."""

import jax
import jax.numpy as jnp

from .._types import Array, Float, Int
from ..continuation import Path
from ..materials import film_volume_ratio, gel_in_groups, phase_of, takes_solvent
from ..mechanics import Problem, all_volumes, axial_stretch, carries_volume, is_film, volume_ratios
from .states import of_path

NO_GEL = -1  # phase of what has none: elastomers, held moments of the volume ratio, padding


@of_path
def phases(path: Path) -> Int[Array, "k g"]:
    """Phase (k, g) of every volume group: 0 collapsed, 2 swollen, 1 between, where dp/dJ < 0, see `materials.phase_of`.

    `NO_GEL` where a group carries no gel. In a good solvent all others are 0. A group that changes its phase from one state to the next
    does so within a step: between neighbouring states that are both 0 or 2 the gel has jumped.
    """
    return _phases(jnp.asarray(path.x), jnp.asarray(path.value), path.problem)


@of_path
def swollen_share(path: Path) -> Float[Array, " k"]:
    """Share (k,) of the gel's dry volume that is swollen, beyond the first spinodal and stable, of 1."""
    found = phases(path)
    volumes = jnp.where(found[0] == NO_GEL, 0.0, all_volumes(path.model))
    return jnp.sum(jnp.where(found == 2, volumes, 0.0), axis=1) / jnp.sum(volumes)


@jax.jit
def _phases(x: Float[Array, "k n 2"], values: Float[Array, " k"], problem: Problem) -> Int[Array, "k g"]:
    model = problem.model
    swells = carries_volume(model) & (all_volumes(model) > 0) & takes_solvent(gel_in_groups(problem.gel))

    def one(x, value):
        now, mu = problem.at(value)
        there = gel_in_groups(now.gel)
        J = jnp.where(swells, volume_ratios(x, model), 2.0)
        J = film_volume_ratio(J, mu, there) if is_film(model) else axial_stretch(model) * J
        return jnp.where(swells, phase_of(J, there), NO_GEL)

    return jax.vmap(one)(x, values)
