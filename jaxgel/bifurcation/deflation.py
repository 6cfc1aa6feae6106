"""Further equilibria at one value of the control, by deflation."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from .._deprecated import old_arguments
from .._types import Array, Float, Scalar
from ..equilibrium import NEWTON, Correction, State, advanced, dry_state, iterate, starting
from ..mechanics import Problem, condensed_rhs, factorised_tangent, restrict, state_pressure
from .critical import check_untraced

FAR = 1e3  # widths of the plate: an iterate whose nodes lie farther out has diverged


@old_arguments
def find_states_by_deflation(
    problem: Problem,
    value: Scalar,
    *,
    known: Sequence[Float[Array, "n 2"]] | Float[Array, "k n 2"],
    starts: Sequence[Float[Array, "n 2"]] | Float[Array, "s n 2"],
) -> list[State]:
    """Equilibria at one value of the control other than the known ones, a list of `State`.

    Arguments:

    - `problem`: the `Problem`, with its control.
    - `value` (): value of the control, in its unit.
    - `known` (k, n, 2): nodal positions of the known states, mm.
    - `starts` (s, n, 2): nodal positions at which the iterations start, mm.

    The list has at most one state for each start; each state found is deflated too. Newton's method
    is applied to the residual times prod_i (1 + n spacing^2 / |x - x_i|^2), which does not vanish
    at the known states x_i: its step is Newton's own times a factor.

    Raises `ValueError` for a traced problem or value: the states have no derivatives.

    Source: Farrell, Birkisson & Funke (2015), SIAM J. Sci. Comput. 37, A2026.

    See docs/howto/bifurcation.md.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.sweep(problem, [-0.5, -0.45])
    >>> len(find_states_by_deflation(problem, -0.45, known=[], starts=path.x[:1]))
    1
    >>> len(find_states_by_deflation(problem, -0.45, known=path.x[1:], starts=path.x[:1]))
    0
    """
    check_untraced("find_states_by_deflation", problem, value)
    problem = problem.prepared
    others, found, (now, mu) = [np.asarray(x) for x in known], [], problem.at(value)
    for start in starts:
        x = problem.placed(jnp.asarray(start), value)
        pressure = state_pressure(x, now.model, now.gel, mu)
        pressure = jnp.where(jnp.isfinite(pressure), pressure, dry_state(now)[1])
        state = iterate(now, starting(now, mu, x, pressure), _Deflated(others))
        if state.status.ok:
            others.append(np.asarray(state.x))
            found.append(dataclasses.replace(state, value=float(value)))
    return found


@dataclasses.dataclass
class _Deflated(Correction):
    """Newton's corrections, stretched by the deflation of known states."""

    known: list
    most = 60

    def assess(self, problem: Problem, state: State):
        size, solved = NEWTON.assess(state)
        return size if np.abs(
            np.asarray(state.x)
        ).max() < FAR * problem.model.cloud.plate.width else np.nan, solved

    def __call__(self, problem, state):
        made = factorised_tangent(problem, state.x, state.pressure, state.linearisation)
        step, _ = made.solve(
            np.asarray(condensed_rhs(problem, state.linearisation, state.linearisation)),
            refine=False,
        )
        weight = 1 / (state.x.shape[0] * problem.model.cloud.spacing**2)
        slope = 0.0  # of log prod_i (1 + 1 / d_i) along the step, d_i the squared distance
        for other in self.known:
            away = restrict(np.asarray(state.x) - other, problem.free)
            d = weight * away @ away
            slope -= 2 * weight * (away @ step) / (d * (d + 1))
        most = problem.model.cloud.spacing / np.abs(step).max()
        stretch = np.clip(1 / (1 - slope) if slope != 1 else most, -most, most)
        return advanced(
            problem, state, step, state.linearisation, share=float(stretch), limited=False
        )
