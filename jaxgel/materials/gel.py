"""The gel: its free energy, what follows from it by differentiation, and its homogeneous states.

Plane strain with respect to the dry state: ``F`` (2, 2) is the in-plane total deformation gradient,
F33 = 1, J = det F. In generalised plane strain F33 is the axial stretch and J = F33 det F. Energies
and stresses are per dry volume (Cauchy stress: per current area) in kT/v, the chemical potential
``mu`` is in kT. The energy has two parts,

    W(F, mu) = network(F, gel) + volumetric(J, gel) - mu (J - 1),

so that a mixed method can take the second at its own volume ratio. ``pressure`` is p = d
volumetric / dJ - mu, positive in tension: the Cauchy stress is (dnetwork/dF) F^T / J + p I. Every
function is pure, for one state; those of the scalars J, p and mu also take arrays. Sources: Deng et
al. (2020), Eqs. (1)-(9) and (59); Hong, Liu & Suo (2009).
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from .._compiled import compiled
from .._types import Array, Float, Scalar
from .checks import check_number
from .fields import Field, elementwise
from .mixing import flory_rehner
from .swelling import Numbers


def neo_hookean(F: Float[Array, "2 2"], gel: Any, axial: Scalar = 1.0) -> Float[Array, ""]:
    """Network energy of Gaussian chains, Nv/2 (I - 3), in kT/v, with I = F:F + ``axial``^2.

    In plane strain this is Nv/2 (F:F - 2).
    """
    return gel.Nv / 2 * (jnp.sum(F**2) + (axial**2 - 3))


@runtime_checkable
class LocalGel(Protocol):
    """A gel on a model, with local values in place of its fields, see ``mechanics.localised``.

    A registered dataclass, such as `Gel`, those in `responsive`, or a user's own.
    """

    @property
    def Nv(self) -> Any:
        """Chains per dry volume times solvent molecule volume ()."""
        ...

    @property
    def network(self) -> Callable:
        """Network energy (F (2, 2), gel) -> (), kT/v."""
        ...

    @property
    def volumetric(self) -> Callable:
        """Energy of mixing (J (), gel) -> (), kT/v."""
        ...


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Gel:
    """A neutral gel with an energy of its network and one of mixing; the user makes it. A pytree.

    Its data are `Nv` and `chi`, which may be traced; `check_gel` validates them. Either may be a
    field over the dry plate, see `fields`: a function of the position (2,), mm, to one number. An
    own energy is two plain functions of (F, gel) and (J, gel). Define them once, at module level: a
    new function object compiles anew. A gel with more parameters is any registered dataclass with
    `Nv`, `network`, `volumetric` and its own, as those in `responsive`.
    """

    Nv: Scalar | Field = 1e-3
    """Chains per dry volume times solvent molecule volume (); dry shear modulus in kT/v."""
    chi: Scalar | Field = 1e-4
    """Flory's parameter of mixing () < 2; 0 in an athermal solvent, negative in a better one."""
    network: Callable = dataclasses.field(
        default=neo_hookean, kw_only=True, metadata={"static": True}
    )
    """Energy (F (2, 2), gel) -> (), kT/v: `neo_hookean`, `Gent(Jm)`, `ArrudaBoyce(N)`, or own."""
    volumetric: Callable = dataclasses.field(
        default=flory_rehner, kw_only=True, metadata={"static": True}
    )
    """Energy of mixing (J (), gel) -> (), kT/v: `flory_rehner` or a user's own."""


@dataclasses.dataclass(frozen=True)
class Gent:
    """Network energy of Gent (1996), chains of finite length; a value of `Gel.network`.

    -Nv Jm/2 ln(1 - (I-3)/Jm), with I - 3 < `Jm`; NaN beyond.
    """

    Jm: float
    """Largest I - 3, dimensionless."""

    def __post_init__(self) -> None:
        check_number("Jm", self.Jm, lambda v: 0 < v < math.inf, "a finite number > 0")

    def __call__(self, F: Float[Array, "2 2"], gel: Any, axial: Scalar = 1.0) -> Float[Array, ""]:
        return -gel.Nv * self.Jm / 2 * jnp.log1p(-(jnp.sum(F**2) + (axial**2 - 3)) / self.Jm)


@dataclasses.dataclass(frozen=True)
class ArrudaBoyce:
    """Network energy of Arruda & Boyce (1993), five terms in I/N; a value of `Gel.network`.

    It is scaled to the initial shear modulus Nv for every `N`, so that the dry network is free of
    stress together with -Nv ln J.
    """

    N: float
    """Links per chain, dimensionless."""

    def __post_init__(self) -> None:
        check_number("N", self.N, lambda v: 0 < v < math.inf, "a finite number > 0")

    def __call__(self, F: Float[Array, "2 2"], gel: Any, axial: Scalar = 1.0) -> Float[Array, ""]:
        invariant = jnp.sum(F**2) + axial**2
        terms = [
            c / self.N**i for i, c in enumerate((1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750))
        ]
        initial = 2 * sum(c * (i + 1) * 3**i for i, c in enumerate(terms))
        return (
            gel.Nv
            / initial
            * sum(c * (invariant ** (i + 1) - 3 ** (i + 1)) for i, c in enumerate(terms))
        )


def network_at(gel: Any, axial: Scalar | None = None) -> Callable[..., Any]:
    """Network energy of the gel (F (2, 2), gel) -> () at the stretch ``axial``; None: plane strain.

    That is the stretch out of plane.
    """
    return gel.network if axial is None else lambda F, gel: gel.network(F, gel, axial)


def check_network(gel: Any) -> None:
    """Raise ValueError unless the gel's network is ``neo_hookean``, as a film needs.

    The energy of others is no sum over the directions.
    """
    if gel.network is not neo_hookean:
        raise ValueError(
            f"network: {gel.network!r} is not accepted in plane stress, it must be neo_hookean"
        )


def check_stretched_network(gel: Any) -> None:
    """Raise ValueError unless the network's energy is known at any stretch out of plane.

    The networks of this module are.
    """
    if not (gel.network is neo_hookean or isinstance(gel.network, Gent | ArrudaBoyce)):
        known = "neo_hookean, Gent or ArrudaBoyce"
        raise ValueError(
            f"network: {gel.network!r} is not accepted in generalised plane strain, it must be "
            f"{known}"
        )


def free_energy(F: Float[Array, "2 2"], mu: Scalar, gel: Any) -> Float[Array, ""]:
    """Free energy () per dry volume of a gel in plane strain, kT/v.

    Arguments:

    - `F` (2, 2): in-plane deformation gradient from the dry state, dimensionless.
    - `mu` (): chemical potential of the solvent, kT; 0 is the pure solvent.
    - `gel`: a `Gel`, or another with `network` and `volumetric`.

    Returns NaN unless det F > 1: the dry state is singular.

    Source: Deng et al. (2020), the Legendre transform of Eq. (1) with 1 + vC = J; Eq. (5) is this
    divided by J_mu.

    >>> free_energy(1.2 * jnp.eye(2), -0.5, Gel(Nv=1e-3, chi=0.1)).round(6)
    Array(-0.371044, dtype=float64)
    """
    J = _det(F)
    return gel.network(F, gel) + gel.volumetric(J, gel) - mu * (J - 1)


def cauchy_stress(
    F: Float[Array, "2 2"],
    mu: Scalar,
    gel: Any,
    pressure: Scalar | None = None,
    axial: Scalar | None = None,
) -> Float[Array, "2 2"]:
    """In-plane Cauchy stress (2, 2), in kT/v, at ``F`` (2, 2).

    ``pressure`` () replaces ``osmotic(J, mu, gel)`` if given. A mixed method passes its own
    pressure. ``axial`` is the stretch out of plane, 1 if it is None. The stress out of plane does
    not follow from an energy of the in-plane ``F``.
    """
    J = _det(F) if axial is None else _det(F) * axial
    pressure = osmotic(J, mu, gel) if pressure is None else pressure
    return jax.grad(network_at(gel, axial))(F, gel) @ F.T / J + pressure * jnp.eye(2)


@compiled()
def osmotic(J: Numbers, mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """Pressure p = d volumetric / dJ - ``mu``, in kT/v, at the volume ratio ``J`` (...) > 1."""
    return elementwise(jax.grad(gel.volumetric), J, gel) - mu


@compiled()
def bulk_stiffness(J: Numbers, gel: Any) -> Float[Array, "..."]:
    """dp/dJ, in kT/v, at the volume ratio ``J`` (...) > 1.

    About 1/(J-1), so 1e3 to 1e5 times Nv over most of a sweep.
    """
    return elementwise(jax.grad(jax.grad(gel.volumetric)), J, gel)


def _det(A):
    return A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
