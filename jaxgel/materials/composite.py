"""Materials that differ by region: other gels, and passive elastomers without solvent.

An elastomer has the energy per dry volume, in kT/v,

    W(F) = network(F) + elastic(J),   elastic(J) = K/2 (J - 1)^2 - Nv ln J,

free of stress in the dry state, with the shear modulus Nv and, for K well above it, the bulk
modulus K. Its ``network`` is the gel's, with an Nv of its own. ``elastic(J)`` stands in place of
``volumetric(J) - mu (J - 1)``, so that the mixed form is the same; every J > 0 is feasible.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .._types import Array, Bool, Float, Scalar
from .fields import Field, LocalValues, named_parameters


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Elastomer:
    """A passive material: a network that takes no solvent; the user makes it for a `Composite`.

    A pytree. Its numbers may be traced, and may be fields as those of a `Gel`.
    """

    Nv: Scalar | Field
    """Shear modulus, kT/v; comparable with the Nv of gels."""
    bulk: Scalar | Field
    """Bulk modulus K, kT/v."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Composite:
    """Materials of a plate with `regions`; the user makes it. A pytree of theirs.

    All gels have the same `network` and `volumetric` energy: they differ in their parameters.
    """

    matrix: Any
    """The gel outside the regions."""
    regions: tuple[Any, ...]
    """A gel or an `Elastomer` for each region of the plate, in their order."""


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
    """A gel on a model with elastomer regions; a pytree of both, see ``mechanics.localised``.

    It has the parameters of both. Its ``volumetric`` energy is `filled_energy`; what it does not
    have itself is the gel's.
    """

    gel: Any
    """The gel; in elastomers its Nv is theirs."""
    bulk: LocalValues | Array | Scalar
    """Bulk modulus of the elastomers, kT/v; 0 in the gel. A number at a single place."""

    @property
    def volumetric(self) -> Callable:
        """Energy besides the network's at the volume ratio J, as that of a gel."""
        return filled_energy

    def __getattr__(self, name: str) -> Any:
        return getattr(object.__getattribute__(self, "gel"), name)

    def tree_flatten_with_keys(self) -> tuple[list, Any]:
        """The parameters with their names, and how to put the gel together again."""
        own = named_parameters(self.gel)
        structure = jax.tree.structure(self.gel, is_leaf=lambda part: part is not self.gel)
        return [
            (jax.tree_util.GetAttrKey(name), part)
            for name, part in (own | {"bulk": self.bulk}).items()
        ], structure

    @classmethod
    def tree_unflatten(cls, structure: Any, parts: Any) -> "Filled":
        """The gel of these parameters."""
        *own, bulk = parts
        return cls(jax.tree.unflatten(structure, own), bulk)


def filled_energy(J: Float[Array, ""], filled: Filled) -> Float[Array, ""]:
    """Energy (), kT/v, at ``J`` () without network and mu: volumetric(J), elastic(J).

    ``J`` is the volume ratio; elastic(J) is that of an elastomer.
    """
    passive = filled.bulk > 0
    elastic = filled.bulk / 2 * (J - 1) ** 2 - filled.Nv * jnp.log(J)
    return jnp.where(
        passive, elastic, filled.gel.volumetric(jnp.where(passive, 2.0, J), filled.gel)
    )


def takes_solvent(gel: Any) -> Bool[Array, "..."]:
    """Whether the gel takes solvent, at each of its places: nowhere in elastomers."""
    return (gel.bulk if isinstance(gel, Filled) else jnp.zeros(())) == 0
