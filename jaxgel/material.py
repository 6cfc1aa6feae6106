"""The gel: its free energy, what follows from it by differentiation, and its homogeneous states.

Plane strain with respect to the dry state: ``F`` (2, 2) is the in-plane total deformation gradient, F33 = 1, J = det F. Energies
and stresses are per dry volume (Cauchy stress: per current area) in kT/v, the chemical potential ``mu`` is in kT. The energy has
two parts,

    W(F, mu) = network(F, gel) + volumetric(J, gel) - mu (J - 1),

so that a mixed method can take the second at its own volume ratio. ``pressure`` is p = d volumetric / dJ - mu, positive in
tension: the Cauchy stress is (dnetwork/dF) F^T / J + p I. Every function is pure, for one state; those of the scalars J, p and
mu also take arrays. Sources: Deng et al. (2020), Eqs. (1)-(9) and (59); Hong, Liu & Suo (2009).
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

SMALLEST_SWELLING, LARGEST_SWELLING = 1e-14, 1e8  # bounds of J - 1 in the search for a volume ratio
_MOST_STEPS = 100  # 52 bisections take the whole interval of ln(J - 1) to round-off


def neo_hookean(F, gel):
    """Network energy of Gaussian chains, Nv/2 (I - 3), in kT/v; with F33 = 1 this is Nv/2 (F:F - 2)."""
    return gel.Nv / 2 * (jnp.sum(F**2) - 2)


def flory_huggins(J, chi):
    """Energy of mixing polymer and solvent, -(J-1) ln(J/(J-1)) - chi/J, in kT/v per dry volume; J > 1.

    ln(J/(J-1)) = log1p(1/(J-1)) is accurate for every J, both next to the dry state and far from it.
    """
    return -(J - 1) * jnp.log1p(1 / (J - 1)) - chi / J


def flory_rehner(J, gel):
    """The part of the Flory-Rehner energy that depends on J alone: mixing, and -Nv ln J of the network; Eq. (1)."""
    return flory_huggins(J, gel.chi) - gel.Nv * jnp.log(J)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Gel:
    """A gel; a pytree whose data are ``Nv`` and ``chi``, so both may be traced. ``check_gel`` validates.

    ``network`` is ``neo_hookean``, ``Gent(Jm)``, ``ArrudaBoyce(N)`` or a user's own; an own energy is two plain functions of (F, gel)
    and (J, gel). Define them once, at module level: a new function object compiles anew. A gel with more parameters is any
    registered dataclass with these four attributes and its own.
    """

    Nv: Any = 1e-3  # chains per dry volume times solvent molecule volume (); the shear modulus of the dry network in kT/v
    chi: Any = 1e-4  # enthalpy of mixing, Flory's parameter ()
    network: Callable = dataclasses.field(default=neo_hookean, kw_only=True, metadata={"static": True})  # (F (2, 2), gel) -> ()
    volumetric: Callable = dataclasses.field(default=flory_rehner, kw_only=True, metadata={"static": True})  # (J (), gel) -> ()


@dataclasses.dataclass(frozen=True)
class Gent:
    """Network energy of Gent (1996), -Nv Jm/2 ln(1 - (I-3)/Jm): chains of finite length; I - 3 < ``Jm``, NaN beyond."""

    Jm: float  # the largest I - 3 ()

    def __post_init__(self):
        _check("Jm", self.Jm, lambda v: 0 < v < math.inf, "a finite number > 0")

    def __call__(self, F, gel):
        return -gel.Nv * self.Jm / 2 * jnp.log1p(-(jnp.sum(F**2) - 2) / self.Jm)


@dataclasses.dataclass(frozen=True)
class ArrudaBoyce:
    """Network energy of Arruda & Boyce (1993), five terms in I/N, for chains of ``N`` links.

    Scaled to the initial shear modulus Nv whatever ``N``, so that the dry network is free of stress together with -Nv ln J.
    """

    N: float  # links per chain ()

    def __post_init__(self):
        _check("N", self.N, lambda v: 0 < v < math.inf, "a finite number > 0")

    def __call__(self, F, gel):
        invariant = jnp.sum(F**2) + 1
        terms = [c / self.N**i for i, c in enumerate((1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750))]
        initial = 2 * sum(c * (i + 1) * 3**i for i, c in enumerate(terms))
        return gel.Nv / initial * sum(c * (invariant ** (i + 1) - 3 ** (i + 1)) for i, c in enumerate(terms))


def check_gel(gel, mu=None):
    """Raise ValueError, one line, unless Nv > 0, 0 < chi < 2 and ``mu`` (number or array, if given) is finite; traced values pass."""
    _check("Nv", gel.Nv, lambda v: 0 < v < math.inf, "a finite number > 0")
    _check("chi", gel.chi, lambda v: 0 < v < 2, "a number in (0, 2), bounds excluded")
    if mu is not None and not any(isinstance(value, Tracer) for value in jax.tree.leaves(mu)):
        for value in np.ravel(np.asarray(mu, dtype=object)):
            _check("mu", value, math.isfinite, "a finite number (chemical potential in kT)")


def free_energy(F, mu, gel):
    """Free energy () per dry volume, in kT/v, at the deformation gradient ``F`` (2, 2); NaN unless det F > 1.

    The Legendre transform of Eq. (1) with 1 + vC = J; Eq. (5) is this divided by J_mu, see ``paper_free_energy``.
    """
    J = _det(F)
    return gel.network(F, gel) + gel.volumetric(J, gel) - mu * (J - 1)


def cauchy_stress(F, mu, gel, pressure=None):
    """In-plane Cauchy stress (2, 2), in kT/v, at ``F`` (2, 2); ``pressure`` () replaces ``osmotic(J, mu, gel)`` if given.

    A mixed method passes its own pressure. The stress out of plane does not follow from an energy of the in-plane ``F``.
    """
    J = _det(F)
    pressure = osmotic(J, mu, gel) if pressure is None else pressure
    return jax.grad(gel.network)(F, gel) @ F.T / J + pressure * jnp.eye(2)


def osmotic(J, mu, gel):
    """Pressure p = d volumetric / dJ - ``mu``, in kT/v, at the volume ratio ``J`` (...) > 1."""
    return _elementwise(jax.grad(gel.volumetric), J, gel) - mu


def bulk_stiffness(J, gel):
    """dp/dJ, in kT/v, at the volume ratio ``J`` (...) > 1; about 1/(J-1), so 1e3 to 1e5 times Nv over most of a sweep."""
    return _elementwise(jax.grad(jax.grad(gel.volumetric)), J, gel)


def _volume_only(J, gel):
    return gel.volumetric(J, gel)


def _free(J, gel):
    return gel.network(jnp.sqrt(J) * jnp.eye(2), gel) + gel.volumetric(J, gel)


def _uniaxial(J, gel):
    return gel.network(jnp.diag(jnp.stack([jnp.ones_like(J), J])), gel) + gel.volumetric(J, gel)


@jax.jit
def volume_ratio_at(p, mu, gel):
    """Volume ratio J (...) > 1 at which ``osmotic(J, mu, gel)`` equals ``p`` (...): the inverse of ``osmotic``. Finite for every p.

    The pressure grows from -inf at J = 1 to ``largest_pressure``: -mu at J = inf for 2 chi < (1 + sqrt(Nv))^2, else the maximum at
    the spinodal, where dp/dJ = 0. The root between, on the side of the dry state, is returned; there dp/dJ > 0. For a larger p it
    is the J of the largest pressure, at most 1 + LARGEST_SWELLING, and for p + mu below about -31 it is 1 + SMALLEST_SWELLING; the
    derivatives are then 0. Of a user's ``volumetric`` the first increasing part is inverted.

    >>> volume_ratio_at(-0.1, -0.5, Gel(Nv=1e-3, chi=0.1)).round(6)
    Array(1.32168, dtype=float64)
    """
    return _elementwise(functools.partial(_volume_ratio, _volume_only), jnp.asarray(p, float) + mu, gel)[0]


@jax.jit
def free_swelling(mu, gel):
    """In-plane stretch l (...) of the gel that swells freely at ``mu`` (...): dW/dl = 0 at F = diag(l, l, 1); Eq. (6) with S = 0.

    The root that is connected with the dry state (see ``volume_ratio_at``); NaN from ``largest_mu`` on.

    >>> free_swelling(-0.1688, Gel(Nv=1e-3, chi=1e-5)).round(4)
    Array(1.451, dtype=float64)
    """
    return jnp.sqrt(_volume_ratio_or_nan(_free, mu, gel))


@jax.jit
def uniaxial_swelling(mu, gel):
    """Stretch l2 (...) of the gel that swells along x2 only, at ``mu`` (...): dW/dl2 = 0 at F = diag(1, l2, 1); Eq. (59).

    Exists for every mu with a neo-Hookean network and chi <= 1/2, up to l2 = LARGEST_SWELLING; NaN where no root is connected with
    the dry state.
    """
    return _volume_ratio_or_nan(_uniaxial, mu, gel)


@jax.jit
def largest_mu(gel):
    """Supremum () of the chemical potentials, in kT, that have a ``free_swelling`` connected with the dry state.

    Nv for the default energy with 2 chi < (1 + sqrt(Nv))^2, else the value at the spinodal, where the swelling would jump; a huge
    number for networks that lock, such as ``Gent``. First derivatives only. A plate whose edges are held can be taken beyond; only its
    free-swelling stretch does not exist there.
    """
    return _largest_slope(_free, gel)


@jax.jit
def largest_pressure(mu, gel):
    """Supremum (...) of the pressures, in kT/v, that the gel can carry at ``mu`` (...): see ``volume_ratio_at``."""
    return _largest_slope(_volume_only, gel) - jnp.asarray(mu, float)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
@functools.partial(jax.jit, static_argnums=0)
def _volume_ratio(energy, target, gel):
    """The first J () from the dry state on at which d energy(J, gel)/dJ = ``target`` (), by Newton's method in u = ln(J - 1), and if it is.

    The search is on the branch of ``_branch_end``, where the slope g(u) = d energy/dJ increases; a ``target`` outside its range
    gives the nearer end and False. For the Flory-Rehner gel g starts as u + constant and is concave (0 < chi < 2, Nv < 2), so the iterates
    rise to the root from the left. In general ``below`` and ``above`` bracket it, and a Newton step that leaves the bracket or is
    not at most half the last step is replaced by bisection.
    """
    ends = least, end = jnp.stack([jnp.log(SMALLEST_SWELLING), _branch_end(energy, gel)])
    lowest, highest = jax.vmap(lambda u: _slopes(energy, u, gel)[0])(ends)

    def body(state):
        u, below, above, last, _, steps = state
        slope, stiffness = _slopes(energy, u, gel)
        left = slope < target
        below, above = jnp.where(left, u, below), jnp.where(left, above, u)
        newton = (target - slope) / (stiffness * jnp.exp(u))
        accepted = (u + newton > below) & (u + newton < above) & (2 * jnp.abs(newton) <= last)
        u_next = jnp.where(slope == target, u, jnp.where(accepted, u + newton, (below + above) / 2))
        step = jnp.abs(u_next - u)
        error = jnp.where(accepted | (slope == target), 100 * step**2, above - below)  # Newton's next step is about its square
        return u_next, below, above, step, error, steps + 1

    def going(state):
        u, _, _, _, error, steps = state
        return (error * jnp.exp(u) > 4e-15 * jnp.maximum(jnp.exp(u), 1.0)) & (steps < _MOST_STEPS)  # the resolution of u, or of J

    start = jnp.clip(jnp.minimum(target - 3, -2.0), least, end)  # g(u) < u + 1 + chi: left of the root
    start = jnp.where(target >= highest, end, start)
    infinity = jnp.full_like(start, jnp.inf)
    state = (start, least, end, infinity, infinity, 0)
    return 1 + jnp.exp(jax.lax.while_loop(going, body, state)[0]), (lowest < target) & (target < highest)


@_volume_ratio.defjvp
def _volume_ratio_jvp(energy, primals, tangents):
    """g(J, gel) = target gives g_J dJ + g_gel dgel = dtarget; 0 where J is an end of the branch and solves nothing."""
    target, gel = primals
    J, solved = _volume_ratio(energy, target, gel)
    stiffness = jax.grad(jax.grad(energy))(J, gel)
    _, from_gel = jax.jvp(lambda gel: jax.grad(energy)(J, gel), (gel,), (tangents[1],))
    J_dot = jnp.where(solved, (tangents[0] - from_gel) / jnp.where(solved, stiffness, 1.0), 0.0)
    return (J, solved), (J_dot, np.zeros(solved.shape, jax.dtypes.float0))


def _branch_end(energy, gel):
    """End of the branch: the u = ln(J - 1) up to which the slope of ``energy`` increases from the dry state on.

    That is its first maximum, the end of the domain of the energy, or the bound of the search. It is found by scanning, and
    scanning again the last interval; the first scan has steps of 0.1 and may miss a fold that is narrower.
    """

    def increasing(u):
        return jnp.isfinite(energy(1 + jnp.exp(u), gel)) & (_slopes(energy, u, gel)[1] > 0)

    def scan(_, interval):
        u = jnp.linspace(interval[0], interval[1], 512)
        falls = ~jax.vmap(increasing)(u)
        first = jnp.argmax(falls)
        return jnp.where(jnp.any(falls), jnp.stack([u[jnp.maximum(first - 1, 0)], u[first]]), interval[1])

    gel = jax.lax.stop_gradient(gel)
    whole = jnp.array([math.log(SMALLEST_SWELLING), math.log(LARGEST_SWELLING)])
    return jax.lax.fori_loop(0, 4, scan, whole)[0]


def _slopes(energy, u, gel):
    """First and second derivative of ``energy`` with respect to J at J = 1 + exp(u)."""
    return jax.value_and_grad(jax.grad(energy))(1 + jnp.exp(u), gel)


def _largest_slope(energy, gel):
    """Supremum () of d energy/dJ on the branch of ``_branch_end``; its J is held, so first derivatives are right, second ones not."""
    return _slopes(energy, _branch_end(energy, gel), gel)[0]


def _volume_ratio_or_nan(energy, target, gel):
    J, solved = _elementwise(functools.partial(_volume_ratio, energy), jnp.asarray(target, float), gel)
    return jnp.where(solved, J, jnp.nan)


def paper_free_energy(F_prime, mu, gel):
    """Free energy (), in kT/v per volume of the freely swollen state C_mu, at F = F_mu F'; Eq. (5). W / J_mu, without a constant."""
    stretch = free_swelling(mu, gel)
    return free_energy(stretch * F_prime, mu, gel) / stretch**2


def paper_stress(G, mu, gel, stretch=None):
    """Second Piola-Kirchhoff stress S (2, 2), in kT/v, in the reference C_mu; Eq. (6), for the default energy.

    ``G`` (2, 2) = F'^T F' is the in-plane right Cauchy-Green tensor; G33 = 1, since F_mu = diag(l, l, 1) has J_mu = l^2.
    ``stretch`` () is l = ``free_swelling(mu, gel)`` where it is known.
    """
    B, _, _ = _paper_coefficients(G, mu, gel, stretch)
    return gel.Nv * jnp.eye(2) + B * _inverse(G).T


def paper_tangent(G, mu, gel, stretch=None):
    """Tangent D_ijkl = 2 dS_ij/dG_kl (2, 2, 2, 2), in kT/v, at ``G`` (2, 2); Eqs. (8)-(9). Arguments as of ``paper_stress``."""
    B, C, J = _paper_coefficients(G, mu, gel, stretch)
    inverse = _inverse(G)
    return 2 * B / J**2 * _cofactor_derivative() + C * jnp.einsum("ji,lk->ijkl", inverse, inverse)


def voigt(D):
    """Matrix (3, 3) of a tangent (2, 2, 2, 2) in the order 11, 22, 12, components as they are: for strains with 2 E_12 in third place."""
    rows, columns = jnp.array([0, 1, 0]), jnp.array([0, 1, 1])
    return D[rows[:, None], columns[:, None], rows[None, :], columns[None, :]]


def _paper_coefficients(G, mu, gel, stretch):
    """B of Eq. (6), C of Eq. (8) = J' dB/dJ' - 2 B, and J'."""
    if gel.network is not neo_hookean or gel.volumetric is not flory_rehner:
        raise ValueError("gel: Eqs. (6)-(9) hold for the Flory-Rehner energy only; differentiate free_energy for another")
    stretch = free_swelling(mu, gel) if stretch is None else stretch
    Jm, J = stretch**2, jnp.sqrt(_det(G))
    logarithm = -J * jnp.log1p(1 / (Jm * J - 1))  # J' ln(1 - 1/(J_mu J'))
    mixing = gel.chi / (Jm**2 * J)
    B = (1 - gel.Nv) / Jm + logarithm + mixing - mu * J
    C = -2 * (1 - gel.Nv) / Jm + J / (Jm * J - 1) - logarithm + mu * J - 3 * mixing
    return B, C, J


def _cofactor_derivative():
    """Q_ijkl (2, 2, 2, 2) of Eq. (9) with G33 = 1: dcof(G)_ij/dG_kl of cof(G)_ij = e_ik e_jl G_kl, with G_12 and G_21 varied together."""
    e = jnp.array([[0.0, 1.0], [-1.0, 0.0]])
    return (jnp.einsum("ik,jl->ijkl", e, e) + jnp.einsum("il,jk->ijkl", e, e)) / 2


def _det(A):
    return A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]


def _inverse(A):
    return jnp.array([[A[1, 1], -A[0, 1]], [-A[1, 0], A[0, 0]]]) / _det(A)


def _elementwise(function, x, gel):
    """``function(x (), gel)`` at every element of ``x`` (...)."""
    gel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), gel)
    return jnp.vectorize(lambda x: function(x, gel))(jnp.asarray(x, float))


def _check(name, value, accepted, text):
    if isinstance(value, Tracer):
        return
    try:
        number = math.nan if isinstance(value, str) or np.ndim(value) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not accepted(number):
        shown = repr(value) if math.isnan(number) and not isinstance(value, np.generic | jax.Array) else f"{number:g}"
        raise ValueError(f"{name}: {shown} is not accepted, it must be {text}")
