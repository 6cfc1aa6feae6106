"""Solutions of K dx = b with the tangents K of many states, one JAX primitive and its rules.

They are found on the host, with the factors that the sweep left behind (`linalg.solve_near`), by products or one compiled assembly per
state. They lie between compiled programs, not in one.
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._primitives import primitive
from .._threads import ONE_THREAD, few_threads, usable_threads
from ..discretisation import Body
from ..linalg import RECENT_FACTORS, SingularTangent, solve_near
from ..mechanics import TangentOperator, gather, hessian_product, is_sparse, linearise, scatter, tangent
from .derivatives import Tangent, remade

STATES_TOGETHER = 4  # states that are differentiated together: per cell one product of small matrices; more would leave the cache
BYTES_TOGETHER = 2**28  # most that their positions gathered cell by cell may fill


def states_together(count: int, model: Body) -> int:
    """Number of states, of ``count``, that are differentiated together."""
    return min(count, STATES_TOGETHER, max(1, BYTES_TOGETHER // (16 * sum(block.nodes.size for block in model.blocks))))


@dataclasses.dataclass(frozen=True)
class _Products:
    """Products like ``v`` (k, f) or (k, f, r) of the tangents with ``v``, of the leaves that `solutions` has."""

    structure: object
    """Tree structure of the leaves."""

    def __call__(self, v, *leaves):
        x, pressure, values, problem = jax.tree.unflatten(self.structure, leaves)

        def product(state):
            v, x, pressure, value = state
            field, (now, mu) = scatter(v, problem.free), problem.at(value)
            return gather(hessian_product(x, field, now.model, now.gel, mu, now.loads, pressure), problem.free)

        def of_all(v):
            return lax.map(product, (v, x, pressure, values), batch_size=states_together(len(x), problem.model))

        return of_all(v) if v.ndim == 2 else jax.vmap(of_all, 2, 2)(v)


def _pairs(problem, x, pressure, value):
    """The tangent (p, 2, 2) at the state ``x`` (n, 2) with ``pressure`` (g,), by the programs of the sweep."""
    problem, mu = problem.at(value)
    now = linearise(problem, x, pressure, mu)
    return tangent(problem, x, pressure, now)


def _solutions_jvp(primals, tangents, *, structure):
    """K x = b gives K dx = db - dK x, the latter by the energy, whose arguments the leaves are."""
    (rhs, *leaves), (change, *dots) = primals, tangents
    solution = solutions.bind(rhs, *leaves, structure=structure)
    moving = tuple(i + 1 for i, dot in enumerate(dots) if dot is not None)
    if moving:
        moved = remade(Tangent(_Products(structure), moving), solution, *leaves, *(dots[i - 1] for i in moving))
        change = -moved if change is None else change - moved
    return solution, change if change is None else solutions.bind(change, *leaves, structure=structure)


def _solutions_transpose(cotangent, args, *, structure):
    """Tangents are symmetric."""
    found = None if cotangent is None else solutions.bind(cotangent, *args[1:], structure=structure)
    return [found, *(None for _ in args[1:])]


def _solved(rhs, *leaves, structure):
    """On the host, with values; 0 for 0 at no cost.

    Where the sweep has left factors of these very states they solve. Tangents with sparse products are not assembled, unless no recent
    factor will do; other small ones are solved side by side in threads.
    """
    x, pressure, values, problem = jax.tree.unflatten(structure, leaves)
    pattern = problem.pattern
    rhs, x, pressure, values = map(np.asarray, (rhs, x, pressure, values))
    wanted, solutions = np.flatnonzero(np.any(rhs != 0, axis=tuple(range(1, rhs.ndim)))), np.zeros(rhs.shape)
    wanted = np.array([k for k in wanted if not _solved_exactly(solutions, k, pattern, x[k], pressure[k], rhs[k])], dtype=int)

    def solve(k, product=None):
        pairs = functools.cache(lambda: _pairs(problem, x[k], pressure[k], values[k]))
        solutions[k] = _solve_columns(pattern, x[k], rhs[k], product or pattern.matrix(pairs()).__matmul__, pairs)

    with few_threads(pattern.size):
        if is_sparse(problem) and len(wanted):
            products = TangentOperator(problem).at(x[wanted], pressure[wanted], values[wanted])
            for k, product in zip(wanted, products, strict=True):
                solve(k, product)
        else:
            with ThreadPoolExecutor(usable_threads() if pattern.size <= ONE_THREAD else 1) as pool:
                list(pool.map(solve, wanted))
    return jax.device_put(solutions)


def _solved_exactly(solutions, k, pattern, x, pressure, rhs):
    """Whether the sweep has left the factor of this very tangent and it has solved: then ``solutions[k]`` are set."""
    made = RECENT_FACTORS.exact(pattern, x, pressure)
    try:
        solutions[k] = rhs if made is None else _columnwise(made.inverse, rhs)
    except SingularTangent:
        return False
    return made is not None


def _refuse(*_, **__):
    raise ValueError("derivatives of a sweep: are not available inside jax.jit; take them outside")


def _solve_columns(pattern, x, rhs, product, pairs):
    """Solutions as the right-hand sides (f,) or (f, r) by `solve_near`, each as accurate as if it were alone; 0 for 0."""
    return _columnwise(lambda b: solve_near(pattern, x, b, product, pairs), np.asarray(rhs))


def _columnwise(solve, rhs):
    """Solutions as the right-hand sides (f,) or (f, r), one by one; 0 for 0."""
    columns = rhs.reshape(len(rhs), -1).T
    return np.stack([solve(b) if np.any(b != 0) else b for b in columns], axis=1).reshape(rhs.shape)


def _solved_batch(args, axes, *, structure):
    """Right-hand sides (b, k, f) for the same states are columns."""
    (rhs, *states), (axis, *others) = args, axes
    if any(other is not None for other in others):
        _refuse()
    columns = jnp.moveaxis(rhs, axis, -1)
    found = solutions.bind(columns.reshape(*columns.shape[:2], -1), *states, structure=structure)
    return found.reshape(columns.shape), columns.ndim - 1


solutions = primitive(
    "equilibrium_solutions",
    value=_solved,
    traced=_refuse,
    shapes=lambda rhs, *_, **__: rhs,
    jvp=_solutions_jvp,
    transpose=_solutions_transpose,
    batch=_solved_batch,
    several=False,
)
"""Solutions as the right-hand sides (k, f) or (k, f, r) for the tangents of the states that the other arguments describe: the leaves of
(x (k, n, 2), pressure (k, g), values (k,) of the control, `Problem`) with the tree ``structure``."""
