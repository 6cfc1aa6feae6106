"""Volume ratio at a pressure, free and uniaxial swelling, and the phase of a gel."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._tracing import everywhere
from .._types import Array, Bool, Float, Int, Scalar
from .composite import Filled, takes_solvent
from .fields import elementwise
from .mixing import flory_rehner, good_solvent

Numbers = Float[Array, "..."] | Scalar

SMALLEST_SWELLING, LARGEST_SWELLING = 1e-14, 1e8  # bounds of J - 1 in the search for a volume ratio
COLLAPSED, UNSTABLE, SWOLLEN = 0, 1, 2  # phases of a gel, see `phase_of`
_HALVINGS = 45  # of an interval of 0.1: to round-off
_MOST_STEPS = 100  # 52 bisections take the whole interval of ln(J - 1) to round-off


def _volume_only(J, gel):
    return gel.volumetric(J, gel)


def _volume_less(J, gel, stiffness):
    return gel.volumetric(J, gel) - stiffness * J**2 / 2


def _free(J, gel):
    return gel.network(jnp.sqrt(J) * jnp.eye(2), gel) + gel.volumetric(J, gel)


def _free_held(J, gel, axial):
    return gel.network(jnp.sqrt(J / axial) * jnp.eye(2), gel, axial) + gel.volumetric(J, gel)


def _isotropic(J, gel):
    return gel.network(jnp.cbrt(J) * jnp.eye(2), gel, jnp.cbrt(J)) + gel.volumetric(J, gel)


def _uniaxial(J, gel):
    return gel.network(jnp.diag(jnp.stack([jnp.ones_like(J), J])), gel) + gel.volumetric(J, gel)


@compiled()
def volume_ratio_at(
    p: Numbers, mu: Numbers, gel: Any, largest: Numbers | None = None
) -> Float[Array, "..."]:
    """Volume ratio J (...) > 1 of the osmotic pressure ``p`` (...): inverse of ``osmotic``.

    ``osmotic(J, mu, gel)`` equals it; finite for every p. The pressure grows from -inf at J = 1 to
    -mu at J = inf for 2 chi < (1 + sqrt(Nv))^2, else to the maximum at the spinodal, where
    dp/dJ = 0. The root between, on the side of the dry state, is returned; there dp/dJ > 0. For a
    larger p it is the J of the largest pressure, at most 1 + LARGEST_SWELLING, and for p + mu below
    about -31 it is 1 + SMALLEST_SWELLING; the derivatives are then those of that J, 0 with respect
    to p and mu. Of another ``volumetric`` the first increasing part is inverted: of two phases the
    shrunken one. ``largest`` (...) is the J at which that ends if it is known. An elastomer has a
    J > 0 for every p.

    >>> from jaxgel.materials import Gel
    >>> volume_ratio_at(-0.1, -0.5, Gel(Nv=1e-3, chi=0.1)).round(6)
    Array(1.32168, dtype=float64)
    """
    # one for each gel
    ends = (
        branch_ends(_volume_only, gel, rises=rises_always(gel))
        if largest is None
        else jnp.asarray(largest, float)
    )
    return first_root(_volume_only, p + takes_solvent(gel) * mu, ends, gel)


@compiled()
def free_swelling(mu: Numbers, gel: Any, axial: Scalar | None = None) -> Float[Array, "..."]:
    """In-plane stretch l (...) of a freely swelling gel in plane strain, at F = diag(l, l, 1).

    Arguments:

    - `mu` (...): chemical potential, kT.
    - `gel`: a `Gel` or another.
    - `axial` (): prescribed stretch out of plane, at diag(l, l, axial); 1 by default.

    Returns the root of dW/dl = 0 that is connected with the dry state (see `volume_ratio_at`); NaN
    beyond it, from the limit of stability or mu = Nv on.

    Source: Deng et al. (2020), Eq. (6) with S = 0.

    >>> from jaxgel.materials import Gel
    >>> free_swelling(-0.1688, Gel(Nv=1e-3, chi=1e-5)).round(4)
    Array(1.451, dtype=float64)
    """
    if axial is None:
        return jnp.sqrt(_volume_ratio_or_nan(_free, mu, gel))
    return jnp.sqrt(_volume_ratio_or_nan(_free_held, mu, gel, axial) / axial)


@compiled()
def isotropic_swelling(mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """Free-swelling stretch l (...) at ``mu`` (...) in three directions; NaN if there is none.

    A free film has the same stretch. The root that is connected with the dry state, J = l^3 (see
    ``volume_ratio_at``).
    """
    return jnp.cbrt(_volume_ratio_or_nan(_isotropic, mu, gel))


@compiled()
def uniaxial_swelling(mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """Stretch l2 (...) of a gel that swells along x2 only, at F = diag(1, l2, 1).

    Arguments:

    - `mu` (...): chemical potential, kT.
    - `gel`: a `Gel` or another.

    Returns the root of dW/dl2 = 0 that is connected with the dry state; NaN if there is none. With
    a neo-Hookean network and chi <= 1/2 it exists for every mu, up to l2 = LARGEST_SWELLING.

    Source: Deng et al. (2020), Eq. (59).

    >>> from jaxgel.materials import Gel
    >>> uniaxial_swelling(-0.1688, Gel(Nv=1e-3, chi=1e-5)).round(4)
    Array(2.1001, dtype=float64)
    """
    return _volume_ratio_or_nan(_uniaxial, mu, gel)


@compiled()
def stiff_until(stiffness: Numbers, gel: Any) -> Float[Array, "..."]:
    """J (...) up to which the pressure grows by more than ``stiffness`` (...), kT/v, with J.

    The volume ratio, from the dry state on. With 0 the first spinodal of the gel, up to which
    ``volume_ratio_at`` inverts its pressure. 1 + LARGEST_SWELLING if that has no end. Without
    derivatives.
    """
    rises = rises_always(gel) & jnp.all(jnp.asarray(stiffness) <= 0)
    return branch_ends(_volume_less, gel, jnp.asarray(stiffness, float), rises=rises)


@compiled()
def phase_of(J: Numbers, gel: Any) -> Int[Array, "..."]:
    """Phase (...) of the gel at ``J`` (...) > 1: 0 collapsed, 1 unstable, 2 swollen.

    Collapsed up to the first spinodal of the volume ratio; swollen beyond it where the pressure
    grows with J again; between, where it falls, the gel is unstable unless it is held. A gel
    without a spinodal has one phase, 0.

    >>> from jaxgel.materials import Gel
    >>> phase_of(jnp.array([1.5, 10.0, 100.0]), Gel(Nv=0.01, chi=0.9)).tolist()
    [0, 1, 2]
    """
    grows = elementwise(jax.grad(jax.grad(_volume_only)), J, gel) > 0
    return jnp.where(
        jnp.asarray(J) < stiff_until(0.0, gel), COLLAPSED, jnp.where(grows, SWOLLEN, UNSTABLE)
    )


def rises_always(gel: Any) -> Bool[Array, ""] | bool:
    """Whether the slope of ``volumetric`` is known to be monotone at all places of the gel.

    It is in good solvents and elastomers.
    """
    of_solvent = gel.gel.volumetric if isinstance(gel, Filled) else gel.volumetric
    return of_solvent is flory_rehner and _no_spinodal(gel)


@compiled()
def _no_spinodal(gel):
    return jnp.all(good_solvent(gel.Nv, gel.chi) | ~takes_solvent(gel))


def least_volume_ratio(gel: Any) -> Float[Array, "..."]:
    """Infimum (...) of the volume ratios that the gel can have: 1, and 0 in elastomers."""
    return jnp.where(takes_solvent(gel), 1.0, 0.0)


def branch_ends(
    energy: Callable, gel: Any, *others: Any, rises: Bool[Array, ""] | bool
) -> Float[Array, "..."]:
    """J (...) up to which the slope of ``energy(J, gel, *others)`` rises; no derivatives.

    It is the value at every place, from the dry state on. It is the bound of the search, without
    looking, if the slope is known to meet no target twice, ``rises``, and in elastomers.
    """
    of = jax.lax.stop_gradient((gel, *others))
    places = jnp.zeros(jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves(of))))
    bound = jnp.full(places.shape, 1 + LARGEST_SWELLING)

    def scanned():
        ends = elementwise(lambda _, *of: 1 + jnp.exp(_branch_end(energy, of)), places, *of)
        return jnp.where(takes_solvent(gel), ends, bound)

    return scanned() if rises is False else jax.lax.cond(everywhere(rises), lambda: bound, scanned)


def first_root(
    energy: Callable,
    target: Numbers,
    end: Float[Array, "..."],
    gel: Any,
    *others: Any,
    least: Float[Array, "..."] | None = None,
) -> Float[Array, "..."]:
    """J (...) at which the slope of ``energy(J, gel, *others)`` is ``target``, at every place.

    The branch goes from ``least`` up to ``end``. By default ``least`` is `least_volume_ratio`. A
    target beyond the slopes of the branch gives its nearer end.
    """

    def of_place(target, least, end, *of):
        return _volume_ratio(energy, target, of, least, end)[0]

    least = least_volume_ratio(gel) if least is None else least
    return elementwise(of_place, target, *jax.lax.stop_gradient((least, end)), gel, *others)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
@compiled(static=("energy",))
def _volume_ratio(energy, target, of, least, end):
    """First J () above ``least`` () with d energy(J, *of)/dJ = ``target`` (), and whether found.

    The unknown of Newton's method is u = ln(J - least). The search is on the branch up to J =
    ``end``, see ``_branch_end``, where the slope g(u) = d energy/dJ increases; a ``target`` outside
    its range gives the nearer end and False. For the Flory-Rehner gel g starts as u + constant and
    is concave (0 <= chi < 2, Nv < 2), so the iterates rise to the root from the left; in elastomers
    they start from the dry state. In general ``below`` and ``above`` bracket the root, and a Newton
    step that leaves the bracket or is not at most half the last step is replaced by bisection.
    """
    ends = lowest_u, end = jnp.log(jnp.stack([jnp.asarray(SMALLEST_SWELLING), end - least]))
    lowest, highest = jax.vmap(lambda u: _slopes(energy, least, u, of)[0])(ends)

    def body(state):
        u, below, above, last, _, steps = state
        slope, stiffness = _slopes(energy, least, u, of)
        left = slope < target
        below, above = jnp.where(left, u, below), jnp.where(left, above, u)
        newton = (target - slope) / (stiffness * jnp.exp(u))
        # a step too small for u too
        accepted = (u + newton >= below) & (u + newton <= above) & (2 * jnp.abs(newton) <= last)
        u_next = jnp.where(accepted, u + newton, (below + above) / 2)
        step = jnp.abs(u_next - u)
        # Newton's next step is about its square
        error = jnp.where(accepted, 100 * step**2, above - below)
        return u_next, below, above, step, error, steps + 1

    def going(state):
        u, _, _, _, error, steps = state
        # the resolution of u, or of J
        return (error * jnp.exp(u) > 4e-15 * jnp.maximum(jnp.exp(u), least)) & (steps < _MOST_STEPS)

    left = jnp.minimum(target - 3, -2.0)  # of the root: g(u) < u + 1 + chi
    start = jnp.clip(
        jnp.where(least < 1, jnp.log(jnp.maximum(1 - least, SMALLEST_SWELLING)), left),
        lowest_u,
        end,
    )
    start = jnp.where(target >= highest, end, start)
    infinity = jnp.full_like(start, jnp.inf)
    state = (start, lowest_u, end, infinity, infinity, 0)
    return least + jnp.exp(jax.lax.while_loop(going, body, state)[0]), (lowest < target) & (
        target < highest
    )


@_volume_ratio.defjvp
def _volume_ratio_jvp(energy, primals, tangents):
    """g(J, *of) = target gives g_J dJ + g_of dof = dtarget.

    Beyond the branch J is its last point, a spinodal, where g_J = 0 gives g_JJ dJ + g_Jof dof = 0;
    the ends of the search are constants.
    """
    _target, of, least, _ = primals
    J, solved = _volume_ratio(energy, *primals)
    slope, stiffness, change = (_nth_derivative(energy, n) for n in (1, 2, 3))
    from_gel, at_spinodal = (
        jax.jvp(lambda of, g=g: g(J, *of), (of,), (tangents[1],))[1] for g in (slope, stiffness)
    )
    spinodal = ~solved & (least + 2 * SMALLEST_SWELLING < J) & (J < 1 + LARGEST_SWELLING / 2)
    of_end = jnp.where(spinodal, -at_spinodal / jnp.where(spinodal, change(J, *of), 1.0), 0.0)
    J_dot = jnp.where(
        solved, (tangents[0] - from_gel) / jnp.where(solved, stiffness(J, *of), 1.0), of_end
    )
    return (J, solved), (J_dot, np.zeros(solved.shape, jax.dtypes.float0))


def _nth_derivative(function, n):
    return function if n == 0 else jax.grad(_nth_derivative(function, n - 1))


def _branch_end(energy, of):
    """End of the branch: u = ln(J - 1) up to which the slope of ``energy`` increases.

    The increase begins at the dry state. That is its first maximum, the end of the domain of the
    energy, or the bound of the search. It is found by scanning with steps of 0.1, which may miss a
    fold that is narrower, and by bisection of the last interval.
    """

    def increasing(u):
        return jnp.isfinite(energy(1 + jnp.exp(u), *of)) & (_slopes(energy, 1.0, u, of)[1] > 0)

    def halved(_, interval):
        middle = jnp.mean(interval)
        return jnp.where(increasing(middle), interval.at[0].set(middle), interval.at[1].set(middle))

    of = jax.lax.stop_gradient(of)
    u = jnp.linspace(math.log(SMALLEST_SWELLING), math.log(LARGEST_SWELLING), 512)
    falls = ~jax.vmap(increasing)(u)
    first = jnp.argmax(falls)
    interval = jnp.stack([u[jnp.maximum(first - 1, 0)], u[first]])
    return jnp.where(jnp.any(falls), jax.lax.fori_loop(0, _HALVINGS, halved, interval)[0], u[-1])


def _slopes(energy, least, u, of):
    """First and second derivative of ``energy`` with respect to J at J = least + exp(u)."""
    return jax.value_and_grad(jax.grad(energy))(least + jnp.exp(u), *of)


def _volume_ratio_or_nan(energy, target, *of):
    def of_place(target, *of):
        J, solved = _volume_ratio(
            energy, target, of, jnp.ones(()), 1 + jnp.exp(_branch_end(energy, of))
        )
        return jnp.where(solved, J, jnp.nan)

    return elementwise(of_place, target, *of)
