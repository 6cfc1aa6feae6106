"""Materials that differ from region to region: other gels, and passive elastomers that take no solvent.

An elastomer has the energy per dry volume, in kT/v,

    W(F) = network(F) + elastic(J),   elastic(J) = K/2 (J - 1)^2 - Nv ln J,

free of stress in the dry state, with the shear modulus Nv and, for K well above it, the bulk modulus K. Its ``network`` is the gel's, with
an Nv of its own. ``elastic(J)`` stands in place of ``volumetric(J) - mu (J - 1)``, so that the mixed form is the same: the pressure is
p = K (J - 1) - Nv/J, whose inverse is the root of a quadratic equation, and every J > 0 is feasible.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .._types import Array, Float, Scalar
from .fields import Field, LocalValues, Varying, named_parameters, value

Parameter = Scalar | Float[Array, "*g"]
"""Of an elastomer: a number, or one for each volume group."""

SLACK = 1e-9  # of Nv: a film's pressure that is not below this is taken for it, as none at or above zero exists
FILM_STEPS = 30  # of Newton's method: the first ones of at most a factor e in A
SOFT = 1e-3  # Nv with which functions of the gel are evaluated where there is an elastomer, and their values are not used


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Elastomer:
    """A passive material: a network that takes no solvent; a pytree. Numbers may be traced, and be fields as those of a `Gel`."""

    Nv: Scalar | Field
    """Shear modulus, kT/v: comparable with the Nv of gels."""
    bulk: Scalar | Field
    """Bulk modulus K, kT/v."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Composite:
    """The materials of a plate with ``regions``; a pytree of theirs.

    All gels have the same ``network`` and ``volumetric`` energy: what differs are their parameters.
    """

    matrix: Any
    """The gel outside the regions."""
    regions: tuple[Any, ...]
    """A gel or an `Elastomer` for each region of the plate."""


def matrix_of(gel: Any) -> Any:
    """The gel outside the regions: the ``matrix`` of a `Composite`, else the gel itself."""
    return gel.matrix if isinstance(gel, Composite) else gel


def with_matrix(gel: Any, **changes: Any) -> Any:
    """The gel, or `Composite`, with other parameters outside its regions."""
    own = dataclasses.replace(matrix_of(gel), **changes)
    return dataclasses.replace(gel, matrix=own) if isinstance(gel, Composite) else own


@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True, eq=False)
class Filled:
    """A gel on a model some regions of which are elastomers; a pytree of the parameters of both, see ``mechanics.localised``.

    What it does not have itself is the gel's.
    """

    gel: Any
    """The gel; in elastomers its Nv is theirs."""
    bulk: LocalValues | Varying | Scalar
    """Bulk modulus of the elastomers, kT/v; 0 in the gel. A number at a single place."""

    def __getattr__(self, name: str) -> Any:
        return getattr(object.__getattribute__(self, "gel"), name)

    def tree_flatten_with_keys(self) -> tuple[list, Any]:
        """The parameters with their names, and how to put the gel together again."""
        own = named_parameters(self.gel)
        structure = jax.tree.structure(self.gel, is_leaf=lambda part: part is not self.gel)
        return [(jax.tree_util.GetAttrKey(name), part) for name, part in (own | {"bulk": self.bulk}).items()], structure

    @classmethod
    def tree_unflatten(cls, structure: Any, parts: Any) -> "Filled":
        """The gel of these parameters."""
        *own, bulk = parts
        return cls(jax.tree.unflatten(structure, own), bulk)


def by_material(
    of_gel: Callable[[Any, Any], Array], of_elastomer: Callable[[Any, Any, Any], Array], x: Float[Array, " g"], dry: float, gel: Any
) -> Float[Array, " g"]:
    """``of_gel(x, gel)`` in gels and ``of_elastomer(x, Nv, K)`` in elastomers; ``dry`` is an ``x`` that both can take."""
    if not isinstance(gel, Filled):
        return of_gel(x, gel)
    bulk, Nv = value(gel.bulk), value(gel.Nv)
    passive = bulk > 0
    swelling = dataclasses.replace(gel.gel, Nv=Varying(jnp.where(passive, SOFT, Nv)))
    values = of_elastomer(jnp.where(passive, x, dry), jnp.where(passive, Nv, SOFT), jnp.where(passive, bulk, 1.0))
    return jnp.where(passive, values, of_gel(jnp.where(passive, dry, x), swelling))


def takes_solvent(gel: Any) -> Any:
    """Whether the gel takes solvent at each of its places: nowhere in elastomers."""
    return value(gel.bulk) == 0 if isinstance(gel, Filled) else True


def elastic_energy(J: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Energy (...) of an elastomer besides its network's, kT/v, at the volume ratio ``J`` (...) > 0."""
    return K / 2 * (J - 1) ** 2 - Nv * jnp.log(J)


def elastic_pressure(J: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Its pressure (...), kT/v, at the volume ratio ``J`` (...) > 0."""
    return K * (J - 1) - Nv / J


def elastic_stiffness(J: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Its stiffness dp/dJ (...), kT/v, at the volume ratio ``J`` (...) > 0."""
    return K + Nv / J**2


def elastic_volume_ratio(p: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Volume ratio J (...) at which it carries the pressure ``p`` (...), kT/v: K J^2 - (K + p) J - Nv = 0."""
    half = (K + p) / (2 * K)
    root = jnp.sqrt(half**2 + Nv / K)
    return jnp.where(half > 0, half + root, Nv / K / jnp.where(half > 0, 1.0, root - half))  # without cancellation


def elastic_film_stretch(A: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Stretch l3 (...) of the thickness of an elastomer film at the areal stretch ``A`` (...): (Nv + K A^2) l3^2 - K A l3 - Nv = 0."""
    a, b = Nv + K * A**2, K * A
    return (b + jnp.sqrt(b**2 + 4 * a * Nv)) / (2 * a)


def elastic_film_energy(A: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """w(A) (...) of an elastomer film, kT/v, see ``film``."""
    thickness = elastic_film_stretch(A, Nv, K)
    return Nv / 2 * (thickness**2 - 1) + elastic_energy(A * thickness, Nv, K)


def elastic_film_pressure(A: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Its pressure dw/dA (...), kT/v: -Nv l3^2 / A."""
    return -Nv * elastic_film_stretch(A, Nv, K) ** 2 / A


def elastic_film_stiffness(A: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Its stiffness d2w/dA2 (...), kT/v."""
    return jax.jvp(lambda A: elastic_film_pressure(A, Nv, K), (A,), (jnp.ones_like(A),))[1]


def elastic_film_stretch_at(p: Float[Array, "*g"], Nv: Parameter, K: Parameter) -> Float[Array, "*g"]:
    """Areal stretch A (...) at which an elastomer film has the pressure ``p`` (...) < 0: the inverse of `elastic_film_pressure`.

    It grows with A from J = 1/2 on, where the film is compressed to A = (4 + K/Nv)^(-1/2); a lower pressure gives that A. Newton's method
    in ln A for ln(-p), whose slope is between -3 and -1, from p = -Nv/A^3 of the incompressible film.
    """
    least = -jnp.log(4 + K / Nv) / 2
    wanted = jnp.log(-jnp.minimum(p, -SLACK * Nv))

    def step(_, u):
        found, slope = jax.jvp(lambda u: jnp.log(-elastic_film_pressure(jnp.exp(u), Nv, K)), (u,), (jnp.ones_like(u),))
        return jnp.maximum(u - jnp.clip((found - wanted) / slope, -1.0, 1.0), least)

    u = jax.lax.stop_gradient(jax.lax.fori_loop(0, FILM_STEPS, step, jnp.maximum((jnp.log(Nv) - wanted) / 3, least)))
    return jnp.exp(step(0, step(0, u)))  # two steps more for two derivatives
