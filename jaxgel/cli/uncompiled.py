"""A traced function evaluated one operation at a time with NumPy: what a compiled one is compared with.

Nothing is compiled but the few operations that NumPy has no name for, such as scatters; those are asked of JAX, each on its own.
"""

import jax
import numpy as np
from jax.extend.core import Literal


def plain(function):
    """``function`` of pytrees of arrays, evaluated without compiling it; nan and inf come without warnings."""

    def evaluated(*args):
        traced, shape = jax.make_jaxpr(function, return_shape=True)(*args)
        with np.errstate(all="ignore"):
            values = evaluate(traced, *(np.asarray(leaf) for leaf in jax.tree.leaves(args)))
        return jax.tree.unflatten(jax.tree.structure(shape), values)

    return evaluated


def evaluate(closed, *args):
    """Results, a list of arrays, of a closed jaxpr."""
    jaxpr, values = closed.jaxpr, {}
    values.update(zip(jaxpr.constvars, map(np.asarray, closed.consts), strict=True))
    values.update(zip(jaxpr.invars, args, strict=True))

    def value(v):
        return np.asarray(v.val, dtype=v.aval.dtype) if isinstance(v, Literal) else values[v]

    for equation in jaxpr.eqns:
        name, given, options = equation.primitive.name, [value(v) for v in equation.invars], equation.params
        if name in CONTROL:
            results = CONTROL[name](*given, results=[v.aval for v in equation.outvars], **options)
        elif name in OPERATIONS:
            results = [OPERATIONS[name](*given, **options)]
        else:
            results = equation.primitive.bind(*jax.device_put(given), **options)
            results = results if equation.primitive.multiple_results else [results]
        kinds = [v.aval.dtype for v in equation.outvars]
        values.update(zip(equation.outvars, (np.asarray(r, dtype=k) for r, k in zip(results, kinds, strict=True)), strict=True))
    return [value(v) for v in jaxpr.outvars]


def _scan(*args, jaxpr, length, reverse, results, **_):
    n_rows = sum(arg.ndim > v.aval.ndim for arg, v in zip(args, jaxpr.jaxpr.invars, strict=True))
    n_carry = sum(len(r.shape) == v.aval.ndim for r, v in zip(results, jaxpr.jaxpr.outvars, strict=True))
    n_constants = len(args) - n_rows - n_carry
    constants, carry, rows = args[:n_constants], args[n_constants : n_constants + n_carry], args[n_constants + n_carry :]
    out = []
    for k in reversed(range(length)) if reverse else range(length):
        found = evaluate(jaxpr, *constants, *carry, *(row[k] for row in rows))
        carry = found[:n_carry]
        out.append(found[n_carry:])
    if not out:
        return [*carry, *(np.zeros(r.shape, r.dtype) for r in results[n_carry:])]
    return [*carry, *(np.stack(rows[::-1] if reverse else rows) for rows in zip(*out, strict=True))]


def _while(*args, cond_jaxpr, cond_nconsts, body_jaxpr, body_nconsts, **_):
    of_cond, of_body, state = args[:cond_nconsts], args[cond_nconsts:][:body_nconsts], args[cond_nconsts + body_nconsts :]
    while np.any(evaluate(cond_jaxpr, *of_cond, *state)[0]):
        state = evaluate(body_jaxpr, *of_body, *state)
    return state


CONTROL = {
    "jit": lambda *args, jaxpr, **_: evaluate(jaxpr, *args),
    "custom_jvp_call": lambda *args, call_jaxpr, **_: evaluate(call_jaxpr, *args),
    "cond": lambda which, *args, branches, **_: evaluate(branches[int(which)], *args),
    "scan": _scan,
    "while": _while,
    "split": lambda x, sizes, axis, **_: np.split(x, np.cumsum(sizes)[:-1], axis),
}


def _broadcast(x, *, shape, broadcast_dimensions, **_):
    wide = np.ones(len(shape), dtype=int)
    wide[list(broadcast_dimensions)] = x.shape
    return np.broadcast_to(x.reshape(wide), shape)


def _product(a, b, *, dimension_numbers, **_):
    (summed_a, summed_b), (along_a, along_b) = dimension_numbers
    of_a, of_b = list(range(a.ndim)), [a.ndim + i for i in range(b.ndim)]
    for i, j in zip((*summed_a, *along_a), (*summed_b, *along_b), strict=True):
        of_b[j] = of_a[i]
    both = [of_a[i] for i in along_a]
    rest = [i for i in of_a if i not in {of_a[k] for k in (*summed_a, *along_a)}] + [i for i in of_b if i >= a.ndim]
    return np.einsum(a, of_a, b, of_b, [*both, *rest])


def _pad(x, filling, *, padding_config):
    sizes = [low + n + max(n - 1, 0) * inner + high for n, (low, high, inner) in zip(x.shape, padding_config, strict=True)]
    padded = np.full(sizes, filling, dtype=x.dtype)
    places = [slice(low, size - high, inner + 1) for size, (low, high, inner) in zip(sizes, padding_config, strict=True)]
    padded[tuple(places)] = x
    return padded


def _slice(x, *, start_indices, limit_indices, strides):
    return x[tuple(map(slice, start_indices, limit_indices, strides or [None] * x.ndim))]


def _dynamic_slice(x, *starts, slice_sizes, **_):
    # one that would reach outside is moved inside, as JAX does
    starts = [min(max(int(start), 0), n - size) for start, n, size in zip(starts, x.shape, slice_sizes, strict=True)]
    return x[tuple(slice(start, start + size) for start, size in zip(starts, slice_sizes, strict=True))]


def _extreme(function):
    return lambda x, *, axes, **_: function(x, *axes)


def _elementwise(function):
    return lambda *args, **_: function(*args)


def _reduced(function):
    return lambda x, *, axes, **_: function(x, axis=tuple(axes))


NAMES = {  # of NumPy's functions of whole arrays, where they are not those of JAX's operations
    "add": "add",
    "add_any": "add",
    "and": "bitwise_and",
    "div": "divide",
    "eq": "equal",
    "ge": "greater_equal",
    "gt": "greater",
    "is_finite": "isfinite",
    "le": "less_equal",
    "lt": "less",
    "max": "maximum",
    "min": "minimum",
    "mul": "multiply",
    "ne": "not_equal",
    "neg": "negative",
    "not": "invert",
    "or": "bitwise_or",
    "pow": "power",
    "stop_gradient": "asarray",
    "sub": "subtract",
}
SAME = ("abs", "conj", "cos", "exp", "expm1", "imag", "log", "log1p", "real", "sign", "sin", "sqrt", "square", "tanh")
OPERATIONS = {
    **{name: _elementwise(getattr(np, of_numpy)) for name, of_numpy in (NAMES | dict(zip(SAME, SAME, strict=True))).items()},
    **{
        f"reduce_{name}": _reduced(getattr(np, of_numpy))
        for name, of_numpy in {"sum": "sum", "max": "max", "min": "min", "or": "any"}.items()
    },
    "argmax": _extreme(np.argmax),
    "argmin": _extreme(np.argmin),
    "broadcast_in_dim": _broadcast,
    "complex": _elementwise(lambda a, b: a + 1j * b),
    "concatenate": lambda *args, dimension: np.concatenate(args, axis=dimension),
    "convert_element_type": lambda x, *, new_dtype, **_: x.astype(new_dtype),
    "dot_general": _product,
    "dynamic_slice": _dynamic_slice,
    "integer_pow": lambda x, *, y: x**y,
    "iota": lambda *, shape, dimension, **_: _broadcast(np.arange(shape[dimension]), shape=shape, broadcast_dimensions=(dimension,)),
    "pad": _pad,
    "reshape": lambda x, *, new_sizes, **_: x.reshape(new_sizes),
    "select_n": lambda which, *cases: np.where(which, *cases[::-1]),
    "slice": _slice,
    "squeeze": lambda x, *, dimensions: np.squeeze(x, axis=tuple(dimensions)),
    "stack": lambda *args, axis: np.stack(args, axis),
    "transpose": lambda x, *, permutation: np.transpose(x, permutation),
}
