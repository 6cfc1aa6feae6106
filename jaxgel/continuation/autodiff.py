"""Sweeps inside ``jax.jit`` and ``jax.vmap``, and warnings of states that have no derivative worth the name.

The states are one traced loop; how each of them stands, its inertia, lowest eigenvalue and crossing outlines, is found on the host.
"""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np

from ..equilibrium import Status, dry_state, overlaps, solve_traced
from ..linalg import SingularTangent, extreme_eigenvalues, factor, network_matrix, remember
from ..mechanics import constants, crosses, free_dofs, linearise, outline_loops, state_pressure, tangent, tangent_pattern, total_energy

NEARLY_SINGULAR = 1e-3  # eigenvalue, over the network's stiffness, below which a state's derivatives are flagged


class IllPosedDerivative(UserWarning):
    """A sweep is differentiated at a state without a derivative worth the name: nearly singular, in self-contact, or not reached."""


def is_traced(tree):
    """Whether any leaf of the pytree is a JAX tracer."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def scan_states(model, gel, mu, loads, contact):
    """Equilibria (k, n, 2) and their report at the given mu (k,) as one traced loop; linear extrapolation between states.

    The report is a dict (k,) of mu, status, newton_iterations, residual, negative_pivots, lowest_eigenvalue, switched, apart (whether
    contact is out of reach) and energy, of the pressure (k, g), and of the model's ``mixed.Constants``, fixed.
    Statuses are those of `columns`. The branch that continues the dry state is followed whatever its stability; states that are not
    reached are nan.
    """
    start, pressure = dry_state(model, gel, mu[0])

    def step(carry, mu):
        (mu_1, x_1, p_1), (mu_2, x_2, p_2), count = carry
        ratio = jnp.where(count > 1, (mu - mu_1) / jnp.where(count > 1, mu_1 - mu_2, 1.0), 0.0)
        x, p, report = solve_traced(model, gel, mu, loads, x_1 + ratio * (x_1 - x_2), p_1 + ratio * (p_1 - p_2))
        report |= _judged(model, gel, mu, loads, x, p, report["status"], contact)
        x = jnp.where(report["status"] == Status.CROSSED, jnp.nan, x)
        return ((mu, x, p), (mu_1, x_1, p_1), count + 1), (x, report)

    _, (x, report) = jax.lax.scan(step, ((mu[0], start, pressure),) * 2 + (0,), mu)
    report |= dict(zip(("energy", "pressure"), energies_and_pressures(x, model, gel, mu, loads), strict=True))
    return x, dict(report, mu=mu, fixed=constants(model), **dict.fromkeys(("switched", "apart"), jnp.zeros(mu.shape, dtype=bool)))


def columns(path, mu, apart, fixed, contact):
    """States (k, n, 2) and report, those of ``scan_states``, of a path that was asked for the ``mu`` (k,); nan where it did not get.

    The statuses of states that have no good derivative say so.
    """
    missing = len(mu) - len(path)

    def pad(values, fill):  # in NumPy: nothing is compiled
        return jnp.asarray(np.concatenate([values, np.full((missing, *np.shape(values)[1:]), fill)]))

    return pad(path.x, jnp.nan), dict(
        mu=jnp.asarray(mu),
        status=pad(_flagged(path, contact), int(path.stop)),
        newton_iterations=pad(path.newton_iterations, 0),
        residual=pad(path.residual, jnp.nan),
        negative_pivots=pad(path.negative_pivots, -1),
        lowest_eigenvalue=pad(path.lowest_eigenvalue, jnp.nan),
        switched=pad(path.switched, False),
        apart=pad(apart, True),
        fixed=fixed,
        energy=pad(path.energy, jnp.nan),
        pressure=pad(path.pressure, jnp.nan),
    )


def _flagged(path, contact):
    """Statuses (k,), as integers, of the states of a path that is differentiated: also those that have no good derivative."""
    near = np.abs(path.lowest_eigenvalue) < NEARLY_SINGULAR
    crossed = [contact != "on" and overlaps(path.model, x) for x in path.x]
    return np.where(crossed, Status.SELF_CONTACT, np.where(near, Status.NEARLY_SINGULAR, np.array(path.status, dtype=int)))


def warn(report, branch):
    """Warn (``IllPosedDerivative``) of every state whose derivative is ill-posed; inside jit when the program runs."""
    asked = {name: report[name] for name in ("mu", "status", "negative_pivots")}
    if is_traced(asked):
        jax.debug.callback(functools.partial(_warn, branch=branch), **asked)
    else:
        _warn(**asked, branch="symmetric")  # a sweep outside jit has tried to leave an unstable branch


def _warn(mu, status, negative_pivots, branch):
    status, unstable = np.asarray(status), (np.asarray(negative_pivots) > 0) & (branch == "stable")
    texts = [(Status(int(s)).text, status == s) for s in np.unique(status[status != Status.CONVERGED])]
    texts.append(("the state is unstable, and inside jit or vmap no branch is left", unstable & (status == Status.CONVERGED)))
    for text, where in texts:
        if np.any(where):
            at = ", ".join(f"{value:.6g}" for value in np.asarray(mu)[where])
            warnings.warn(f"sweep: ill-posed derivative at mu = {at}: {text}", IllPosedDerivative, stacklevel=3)


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, None, None, 0, None))
def energies_and_pressures(x, model, gel, mu, loads):
    """Total energy (k,) and pressures (k, g) of the states ``x`` (k, n, 2) at ``mu`` (k,), in one program."""
    return total_energy(x, model, gel, mu, loads), state_pressure(x, model, gel, mu)


def _judged(model, gel, mu, loads, x, p, status, contact):
    """Status, negative_pivots and lowest_eigenvalue of one traced state (n, 2), by a factor of its own tangent on the host."""
    topology, fixed = model.lists.topology, constants(model)
    pattern = tangent_pattern(model.lists, free_dofs(topology), model.contact, model.solver)
    apart = tangent_pattern(model.lists, free_dofs(topology), solver=model.solver)
    pairs = tangent(x, p, linearise(x, p, model, gel, mu, loads, fixed)[0], model, gel, fixed)
    judge = functools.partial(_judge, pattern, apart, topology.plate, contact)
    shapes = tuple(jax.ShapeDtypeStruct((), dtype) for dtype in (status.dtype, int, float))
    arrays = status, x, pairs, gel.Nv * fixed.laplacian, outline_loops(x, model)
    found = jax.pure_callback(judge, shapes, *arrays, vmap_method="sequential")
    return dict(zip(("status", "negative_pivots", "lowest_eigenvalue"), found, strict=True))


def _judge(pattern, apart, plate, contact, status, x, pairs, network, loops):
    """``_judged`` on the host; the factor serves the derivatives of the state, see ``linear_solve.solve_near``."""
    if status != Status.CONVERGED:
        return status, np.asarray(-1), np.asarray(np.nan)
    try:
        made = factor(pattern, pairs)
        remember(made, x)
        lowest, nearest = extreme_eigenvalues(made, network_matrix(apart, network))
        negative = made.negative_pivots
    except SingularTangent:
        negative, lowest, nearest = -1, 0.0, 0.0
    if crosses([np.asarray(loop) for loop in loops], plate):
        status = np.asarray(Status.SELF_CONTACT if contact != "on" else Status.CROSSED, dtype=status.dtype)
    elif abs(nearest) < NEARLY_SINGULAR:
        status = np.asarray(Status.NEARLY_SINGULAR, dtype=status.dtype)
    return status, np.asarray(negative), np.asarray(lowest)
