"""Further equilibria at one chemical potential, by deflation."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Scalar
from ..discretisation import Model
from ..equilibrium import State, advanced, assess_equilibrium, dry_state, iterate, starting
from ..materials import AnyGel
from ..mechanics import Problem, condensed_rhs, factorised_tangent, prepare, restrict, state_pressure

MAX_ITERATIONS = 60
FAR = 1e3  # widths of the plate: an iterate whose nodes lie farther out has diverged


def find_states_by_deflation(
    model: Model,
    gel: AnyGel,
    *,
    mu: Scalar,
    known: Sequence[Float[Array, "n 2"]] | Float[Array, "k n 2"],
    starts: Sequence[Float[Array, "n 2"]] | Float[Array, "s n 2"],
    loads: Float[Array, "n 2"] | None = None,
) -> list[State]:
    """Equilibria at one mu that are not among the positions ``known``, from the positions ``starts``, mm.

    Newton's method on the residual times prod_i (1 + n spacing^2 / |x - x_i|^2), which does not vanish at the known states (Farrell,
    Birkisson & Funke 2015): its step is Newton's own, stretched. Each state that is found is deflated too.
    """
    problem, others, found = prepare(model, gel, loads), [np.asarray(x) for x in known], []
    for start in starts:
        pressure = state_pressure(jnp.asarray(start), model, problem.gel, mu)
        pressure = jnp.where(jnp.isfinite(pressure), pressure, dry_state(problem)[1])
        state = iterate(problem, starting(problem, mu, jnp.asarray(start), pressure), _Deflated(others))
        if state.status.ok:
            others.append(np.asarray(state.x))
            found.append(state)
    return found


@dataclasses.dataclass
class _Deflated:
    """Newton's corrections, stretched by the deflation of known states."""

    known: list
    factor: object = None

    def assess(self, problem: Problem, state: State):
        size, solved = assess_equilibrium(state)
        return size if np.abs(np.asarray(state.x)).max() < FAR * problem.model.cloud.plate.width else np.nan, solved

    def exhausted(self, state):
        return state.newton_iterations >= MAX_ITERATIONS

    def __call__(self, problem, state):
        self.factor = factorised_tangent(problem, state.x, state.pressure, state.linearisation)
        step, _ = self.factor.solve(np.asarray(condensed_rhs(problem, state.linearisation, state.linearisation)), refine=False)
        weight = 1 / (state.x.shape[0] * problem.model.cloud.spacing**2)
        slope = 0.0  # of log prod_i (1 + 1 / d_i) along the step, d_i the squared distance
        for other in self.known:
            away = restrict(np.asarray(state.x) - other, problem.free)
            d = weight * away @ away
            slope -= 2 * weight * (away @ step) / (d * (d + 1))
        most = problem.model.cloud.spacing / np.abs(step).max()
        stretch = np.clip(1 / (1 - slope) if slope != 1 else most, -most, most)
        return advanced(problem, state, step, state.linearisation, share=float(stretch), limited=False)

    def finish(self, problem, state):
        return dataclasses.replace(state, factor=factorised_tangent(problem, state.x, state.pressure, state.linearisation))
