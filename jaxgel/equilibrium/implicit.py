"""Derivatives of equilibria by all that they depend on, forward and reverse (adjoint).

Invariant: the residual r(x; problem, value of its control) vanishes on the free degrees of freedom.
Differentiated, K dx = -dr at fixed x, with the tangent K of the state itself. Written as a rule for
tangents, it gives forward, reverse and second derivatives alike; a state that nothing asks about
costs no linear solve, and outside of JAX's transformations nothing in reverse.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiled import compiled
from .._compiled import tangents as tangents_of
from .._primitives import primitive
from .._programs import fitted
from .._sizes import padded, rung
from .._tracing import is_traced
from .._types import Array, Float
from ..linalg import BlockPattern, Pattern
from ..mechanics import Equations, Problem, gather, has_pairs, residual, total_energy
from .motions import Motions, edge_cotangents, edge_motions, moved
from .solutions import solutions, states_together

# states that the program of the reverse pass has room for, or the next power of 2 above their
# number
ROOM = 8


def state_tangents(
    x: Float[Array, "k n 2"],
    pressure: Float[Array, "k g"],
    problem: Problem,
    values: Float[Array, " k"],
    shared: Equations,
    shared_dot: Equations,
    values_dot: Float[Array, " k"],
    *,
    pattern: Pattern | BlockPattern | None = None,
) -> Float[Array, "k m 2"]:
    """Tangents of the equilibria ``x`` with ``pressure`` at ``values`` of the control.

    They belong to tangents of its `shared_tangents` and of the values. They are in the sizes of the
    ``shared`` equations. Constrained degrees of freedom move with the nodes of the dry plate, and
    as a control moves the edges. Operators need no tangents: they follow from the model. nan if a
    tangent is singular, and inside ``jax.jit``, where the tangents' ``pattern`` is needed, if it is
    not positive definite.
    """
    shared, dots = (
        q.replace(model=_without_observation_points(q.model)) for q in (shared, shared_dot)
    )
    leaves, structure = jax.tree.flatten(shared)
    map_ = _Changes(
        structure,
        tuple(bool(jnp.issubdtype(jnp.result_type(leaf), jnp.floating)) for leaf in leaves),
    )
    at = fitted(x, "kn", shared.lengths), fitted(pressure, "kg", shared.lengths), values
    motion, rhs = changes.bind(values_dot, *map_.floats(dots), *at, *leaves, map_=map_)
    states = (
        (x, pressure, values, problem)
        if pattern is None
        else (*at, shared.replace(operators=problem.operators))
    )
    leaves, structure = jax.tree.flatten(states)
    correction = solutions.bind(
        fitted(rhs, "kf", states[-1].lengths), *leaves, structure=structure, pattern=pattern
    )
    return moved(motion, fitted(correction, "kf", shared.lengths), shared.free)


def _without_observation_points(model):
    """The model without the outline if only contact would need it.

    No residual depends on points at which states are observed.
    """
    return model if has_pairs(model) else dataclasses.replace(model, outline=None)


# --- the linear map from tangents of the inputs ---------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Changes:
    """Prescribed motions (k, n, 2), and -dr (k, f) by them and the tangents of the inputs.

    Nodes move by F times the motion of the dry ones, which leaves the volume ratios nearly as they
    are: their change is multiplied by the bulk stiffness, and its round-off by that over the
    stiffness of the softest mode. F itself needs no derivative: the tangents of the states do not
    depend on the motion that is prescribed.
    """

    structure: object
    """Tree structure of the problem without its operators."""
    floating: tuple
    """Which of its leaves are of floating type and have a tangent."""

    def __call__(self, *args):
        """Arguments: tangents of the values (k,) and of the floating leaves.

        Then x (k, n, 2), pressure (k, g), values (k,) and leaves.
        """
        (value_dot, *dots), (x, pressure, values, *leaves) = self.split(args)
        count, size = (
            len(x),
            states_together(len(x), jax.tree.unflatten(self.structure, leaves).model),
        )
        states = [
            _in_groups(one, -(-count // size), size) for one in (x, pressure, values, value_dot)
        ]
        return _ungrouped(_mapped(self, states, leaves, dots), count)

    def of_group(self, x, pressure, values, leaves, values_dot, dots):
        """The changes of a few states, all at once."""
        problem = jax.tree.unflatten(self.structure, leaves)
        zeros = [np.zeros(leaf.shape, jax.dtypes.float0) for leaf in leaves]
        problem_dot = self.with_floats(zeros, dots)
        motions = Motions(problem)(x, values, problem_dot.model.nodes)
        motions += edge_motions(problem, problem_dot, values, values_dot)

        def change(x, pressure, value, value_dot, motion):
            return -gather(
                jax.jvp(_Forces(pressure), (x, problem, value), (motion, problem_dot, value_dot))[
                    1
                ],
                problem.free,
            )

        return [motions, jax.vmap(change)(x, pressure, values, values_dot, motions)]

    def split(self, args):
        """The arguments in which it is linear, and the others."""
        count = 1 + sum(self.floating)
        return args[:count], args[count:]

    def floats(self, tree):
        """The floating leaves of a problem."""
        return [leaf for leaf, f in zip(jax.tree.leaves(tree), self.floating, strict=True) if f]

    def with_floats(self, leaves, floats):
        """The problem of the ``leaves``, with ``floats`` in place of the floating ones."""
        floats = iter(floats)
        return jax.tree.unflatten(
            self.structure,
            [next(floats) if f else leaf for leaf, f in zip(leaves, self.floating, strict=True)],
        )


@dataclasses.dataclass(frozen=True)
class _Forces:
    """The residual (n, 2) of a state ``x`` with its ``pressure`` at a value of the control."""

    pressure: object

    def __call__(self, x, problem, value):
        now, mu = problem.at(value)
        return residual(x, now.model, now.gel, mu, now.loads, self.pressure)


@compiled(static=("map_",))
def _mapped(map_, states, leaves, dots):
    """Values of ``map_`` for one group of states after the other.

    Only its arguments are kept for the reverse.
    """
    one = jax.checkpoint(
        lambda x, pressure, mu, mu_dot: map_.of_group(x, pressure, mu, leaves, mu_dot, dots)
    )
    return lax.map(lambda state: one(*state), states)


@compiled(static=("number", "size"))
def _in_groups(values, number, size):
    """The values (k, ...) in groups (number, size, ...), padded with the last one."""
    rest = number * size - len(values)
    return jnp.concatenate(
        [values, jnp.broadcast_to(values[-1:], (rest, *values.shape[1:]))]
    ).reshape(number, size, *values.shape[1:])


@compiled(static=("count",))
def _ungrouped(values, count):
    return [value.reshape(-1, *value.shape[2:])[:count] for value in values]


# --- its reverse ----------------------------------------------------------------------------------


def _transposed(cotangents, args, *, map_):
    """Cotangents of the linear map's arguments, state by state; unused ones are left out."""
    linear, (x, pressure, values, *leaves) = map_.split(args)
    others, wanted = (x, pressure, values, *leaves), tuple(arg is None for arg in linear)
    free = jax.tree.unflatten(map_.structure, leaves).free
    shapes = x.shape, (len(x), len(free))
    given = [
        jnp.zeros(shape) if one is None else one
        for one, shape in zip(cotangents, shapes, strict=True)
    ]
    if is_traced(*given, *others):
        cotangents = [
            one for one, asked in zip(_reversed(map_, given, others), wanted, strict=True) if asked
        ]
    else:
        cotangents = _of_wanted_states(map_, given, others, wanted)
    rest = iter(cotangents)
    return [*(next(rest) if asked else None for asked in wanted), *(None for _ in others)]


@compiled(static=("map_",))
def _reversed(map_, cotangents, others):
    """The same by JAX."""
    leaves = others[3:]
    zeros = [
        jnp.zeros(len(others[2])),
        *(jnp.zeros_like(leaf) for leaf in map_.floats(jax.tree.unflatten(map_.structure, leaves))),
    ]
    return jax.vjp(lambda *linear: map_(*linear, *others), *zeros)[1](list(cotangents))


def _of_wanted_states(map_, cotangents, others, wanted):
    """The wanted ones, from the states whose cotangents are not 0."""
    x, pressure, values, *leaves = others
    problem = jax.tree.unflatten(map_.structure, leaves)
    motion, forces = map(np.asarray, cotangents)
    fields = -(problem.free.matrix @ forces.T).T.reshape(x.shape)  # whose work is differentiated
    active = np.flatnonzero(np.any(motion != 0, axis=(1, 2)) | np.any(forces != 0, axis=1))
    room = max(ROOM, rung(len(x), 1))
    size = states_together(room, problem.model) if len(active) > 1 else 1
    numbers = np.full(-(-room // size) * size, room)
    numbers[: len(active)] = active
    states = [padded(np.asarray(part), room) for part in (x, pressure, values, motion, fields)]
    found = _over_states(
        map_, states, numbers, -(-len(active) // size), leaves, wanted=wanted, size=size
    )
    return [found[0][: len(x)], *found[1:]] if wanted[0] else found


@compiled(static=("map_", "wanted", "size"))
def _over_states(map_, states, numbers, steps, leaves, *, wanted, size):
    """Cotangents summed over the states ``numbers``, in ``steps`` of ``size`` each.

    With f = -K^-1 c of a cotangent c of the state, the work f . r(x) is differentiated by all that
    r depends on. A number past the last state is padding.
    """
    x, pressure, values, motion, fields = states
    problem = jax.tree.unflatten(map_.structure, leaves)
    motions, dry = Motions(problem), jax.ShapeDtypeStruct(x.shape[1:], x.dtype)

    def work(floats, x, values, pressure, fields):
        problem = map_.with_floats(leaves, floats)

        def one(x, value, pressure, field):
            now, mu = problem.at(value)
            return jax.jvp(
                lambda x: total_energy(x, now.model, now.gel, mu, now.loads, pressure),
                (x,),
                (field,),
            )[1]

        return jnp.sum(jax.vmap(one)(x, values, pressure, fields))

    def add(step, total):
        number = lax.dynamic_slice_in_dim(numbers, step * size, size)
        real = (number < len(x))[:, None, None]
        state = jnp.where(real[:, 0, 0], number, numbers[0])
        moved, field = (jnp.where(real, one[state], 0.0) for one in (motion, fields))
        floats, forces, by_value = jax.grad(work, (0, 1, 2))(
            map_.floats(problem), x[state], values[state], pressure[state], field
        )
        forces = moved + forces
        (by_dry,) = jax.linear_transpose(lambda dry: motions(x[state], values[state], dry), dry)(
            forces
        )
        if problem.moves_edges:
            by_control, more = edge_cotangents(problem, values[state], forces)
            floats, by_value = (
                jax.tree.map(jnp.add, floats, map_.floats(_zeros_but(problem, by_control))),
                by_value + more,
            )
        sums = jax.tree.map(jnp.add, total[1:], (floats, by_dry))
        return total[0].at[number].set(by_value, mode="drop"), *sums

    zeros = (
        jnp.zeros(len(x)),
        [jnp.zeros_like(leaf) for leaf in map_.floats(problem)],
        jnp.zeros(dry.shape),
    )
    by_value, floats, by_dry = lax.fori_loop(0, steps, add, zeros)
    cotangent = map_.with_floats(leaves, floats)
    model = dataclasses.replace(cotangent.model, nodes=cotangent.model.nodes + by_dry)
    cotangents = by_value, *map_.floats(cotangent.replace(model=model))
    return [one for one, asked in zip(cotangents, wanted, strict=True) if asked]


def _zeros_but(problem, control):
    """Zeros like the problem's numbers, but for those of the ``control``."""
    return jax.tree.map(jnp.zeros_like, problem).replace(control=control)


# --- the primitive --------------------------------------------------------------------------------


def _value(*args, map_, **_):
    return map_(*args)


def _shapes(*args, map_, **_):
    x, _, _, *leaves = map_.split(args)[1]
    free = jax.tree.unflatten(map_.structure, leaves).free
    return [x, x.update(shape=(x.shape[0], len(free)))]


def _jvp(args, tangents, *, map_):
    """The map of the tangents of what it is linear in, and the derivative by the others."""
    found, parts = changes.bind(*args, map_=map_), []
    linear, others = map_.split(args)
    dots, _ = map_.split(tangents)
    if any(dot is not None for dot in dots):
        dots = [
            jnp.zeros_like(arg) if dot is None else dot
            for arg, dot in zip(linear, dots, strict=True)
        ]
        parts.append(changes.bind(*dots, *others, map_=map_))
    moving = [None] * len(linear) + list(map_.split(tangents)[1])
    if any(dot is not None for dot in moving):
        parts.append(tangents_of(map_, args, moving, found))
    return found, [sum(of) if of else None for of in zip(*parts, strict=True)] if parts else [
        None
    ] * len(found)


def _batched(args, axes, *, map_, **_):
    return jax.vmap(map_, axes)(*args), [0, 0]


changes = primitive(
    "equilibrium_changes",
    value=_value,
    traced=_value,
    shapes=_shapes,
    jvp=_jvp,
    transpose=_transposed,
    batch=_batched,
    several=True,
)
"""`_Changes` of their arguments."""
