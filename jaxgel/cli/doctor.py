"""Whether this installation computes what it should: versions, float64, threads, and an audit of the compiled kernels.

A released jaxlib sums float64 numbers wrongly beyond 16,384 rows, silently. So each kernel is compiled for several numbers of points and
compared with the same points evaluated one operation at a time by NumPy, without compilation.
"""

import contextlib
import dataclasses
import functools
import gc
import platform
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from threadpoolctl import threadpool_info

from .._threads import usable_cores
from ..discretisation import CellBlock, Connectivity, Model, shape_functions
from ..materials import (
    ArrudaBoyce,
    Gel,
    Gent,
    bulk_stiffness,
    cauchy_stress,
    free_energy,
    free_swelling,
    osmotic,
    paper_stress,
    paper_tangent,
    volume_ratio_at,
)
from ..mechanics import pair_energy, total_energy
from .uncompiled import plain
from .versions import in_one_part

SIZES = (1, 7, 1000, 16_385, 32_769)
DISTINCT = 1000  # points that differ; more are repetitions of these
AGREEMENT = 1e-9  # largest difference over the largest value: round-off stays below 1e-11, a wrong program is wrong in the first digits
GELS = {
    "neo-Hookean": Gel(Nv=1e-3, chi=0.2),
    "Gent": Gel(Nv=1e-3, chi=0.2, network=Gent(30.0)),
    "Arruda-Boyce": Gel(Nv=1e-3, chi=0.2, network=ArrudaBoyce(8.0)),
}


def describe():
    """Lines that say what is installed and how it runs."""
    packages = ("jaxgel", "jax", "jaxlib", "numpy", "scipy", "shapely", "matplotlib", "optax")
    pools = {f"{pool.get('internal_api', pool['user_api'])} {pool['num_threads']}" for pool in threadpool_info()}
    return [
        f"Python {platform.python_version()} on {platform.platform()}",
        ", ".join(f"{name} {version(name)}" for name in packages),
        f"float64: {'on' if jnp.zeros(()).dtype == jnp.float64 else 'OFF: something switched jax_enable_x64 off'}",
        f"device: {jax.devices()[0].platform}; {usable_cores()} cores; threads: {', '.join(sorted(pools))}",
    ]


@dataclasses.dataclass(frozen=True)
class Finding:
    """A kernel's largest differences."""

    name: str
    """What was compiled."""
    difference: float
    """Largest difference over the largest value, at the worst number of points; nan where a value is not finite."""
    points: int
    """That number of points."""

    @property
    def ok(self):
        """Whether compiled and not compiled agree."""
        return self.difference < AGREEMENT


def audit(sizes=SIZES, names=None):
    """A `Finding` for every kernel, one after another: the compiled one at so many points against the same one operation by operation.

    Compiling and running release Python's lock, tracing does not: this thread traces and lowers one program after another, others, one
    for each core, compile and run them. With JAX's compilation cache compiling is done once. ``names`` chooses among the kernels.
    """
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # none of these programs takes long, but there are many
    kernels = {name: functools.partial(_on_sheets, kernel) for name, kernel in model_kernels().items()}
    kernels |= {name: functools.partial(_at_points, *kernel) for name, kernel in point_kernels().items()}
    begun = []
    with ThreadPoolExecutor(usable_cores()) as pool, _no_garbage_collection():
        for name in names or kernels:
            program, arguments, expected = kernels[name]()
            begun.append((name, expected, [pool.submit(_run, program.lower(*arguments(n)), arguments(n)) for n in sizes]))
        for name, expected, results in begun:
            yield _worst(name, {n: _difference(found.result(), expected(n)) for n, found in zip(sizes, results, strict=True)})


def _run(lowered, arguments):
    return lowered.compile()(*arguments)


@contextlib.contextmanager
def _no_garbage_collection():
    """It would take a tenth of the audit, going through the many objects of traced programs again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _at_points(function, arguments):
    """The kernel to be compiled, and two functions of a number of points: its arguments, and what its results should be.

    The points repeat themselves, so that those that differ are evaluated once without compiling, for all numbers.
    """
    one = jax.make_jaxpr(function)(*(values[0] for values in arguments))  # traced, and differentiated, once for all numbers of points
    batched = jax.vmap(jaxpr_as_fun(one))
    compiled, distinct = jax.jit(batched, compiler_options=in_one_part()), functools.cache(lambda: plain(batched)(*arguments))
    return compiled, functools.partial(_repeated, arguments), lambda n: _repeated(distinct(), n)


def _worst(name, differences):
    worst = max(differences, key=lambda n: np.inf if np.isnan(differences[n]) else differences[n])
    return Finding(name, differences[worst], worst)


def _difference(found, expected):
    pairs = zip(map(np.asarray, jax.tree.leaves(found)), jax.tree.leaves(expected), strict=True)
    return max(float(np.max(np.abs(a - b)) / (np.max(np.abs(b)) + 1e-300)) for a, b in pairs)


def _repeated(values, n):
    return [v[np.arange(n) % DISTINCT] for v in values]


def point_kernels():
    """Name -> (function of one point, its arguments for ``DISTINCT`` points)."""
    rng = np.random.default_rng(5)
    F = 1.3 * np.eye(2) + rng.uniform(-0.2, 0.2, (DISTINCT, 2, 2))
    mu, J = rng.uniform(-5, -0.5, DISTINCT), 1 + 10 ** rng.uniform(-4, 0.5, DISTINCT)
    gel, G = GELS["neo-Hookean"], np.einsum("pki,pkj->pij", F, F)
    grid = np.stack(np.meshgrid(*2 * [np.arange(-2.0, 3.0)]), axis=-1).reshape(-1, 2)
    nodes = grid + rng.uniform(-0.2, 0.2, (DISTINCT, 25, 2))
    x, matrix = rng.uniform(-0.5, 0.5, (DISTINCT, 2)), rng.normal(size=(4, 2))

    def paper(G, mu):
        stretch = free_swelling(mu, gel)
        return stretch, paper_stress(G, mu, gel, stretch), paper_tangent(G, mu, gel, stretch)

    def with_gradient(x, nodes):
        def phi(x):
            value = shape_functions(x, nodes, 2.95, kind="imls")
            return value, value

        return jax.jacfwd(phi, has_aux=True)(x)

    def derivatives(energy):
        """Value, gradient and Hessian of an energy of its first argument."""

        def gradient(F, *rest):
            value, slope = jax.value_and_grad(energy)(F, *rest)
            return slope, (value, slope)

        return jax.jacfwd(gradient, has_aux=True)

    return {
        "shape functions, quadratic, and their gradients": (with_gradient, (x, nodes)),
        "shape functions, complex": (lambda x, nodes: shape_functions(x, nodes, 2.95, basis="linear"), (x, nodes)),
        **{
            f"free energy, stress, tangent: {name}": (derivatives(functools.partial(free_energy, gel=gel)), (F, mu))
            for name, gel in GELS.items()
        },
        "volume ratio at a pressure": (lambda p, mu: volume_ratio_at(p, mu, gel), (0.1 * x[:, 0], mu)),
        "free swelling, paper's stress and tangent": (paper, (G, mu)),
        "Cauchy stress": (lambda F, mu: cauchy_stress(F, mu, gel), (F, mu)),
        "pressure, bulk stiffness": (lambda J, mu: (osmotic(J, mu, gel), bulk_stiffness(J, gel)), (J, mu)),
        "contact": (derivatives(functools.partial(pair_energy, reach=0.6)), (x,)),
        "matrix times row, summed": (lambda r: jnp.sum(matrix @ r), (x,)),
    }


def model_kernels():
    """Name -> function of what `_sheet` gives; all results are sums over cells."""
    gel, mu = GELS["neo-Hookean"], -1.0

    def energy(model, slots, x, p):  # noqa: ARG001
        return jax.value_and_grad(total_energy)(x, model, gel, mu, jnp.zeros(()))

    def newton(model, slots, x, p):
        fixed = constants_of(model.lists, model.blocks, slots)
        now, _ = linearise(x, p, model, gel, mu, jnp.zeros(()), fixed)
        return condensed_rhs(now, now, model), tangent(x, p, now, model, gel, fixed)

    return {"Newton's right-hand side and tangent": newton, "energy and residual": energy}


def _on_sheets(function):
    """What `_at_points` gives; the cells repeat themselves, or are there once but weighted."""
    compiled, once = jax.jit(function, compiler_options=in_one_part()), plain(jax.jit(function))  # inlined, but traced once for all numbers
    return compiled, functools.partial(_sheet, repeat=True), lambda n: once(*_sheet(n, repeat=False))


def _sheet(n, *, repeat):
    """Model, slots of its cells, positions and pressures of a sheet with ``n`` quadrature points, or a few more to fill a cell.

    Its cells are those of a small square one after another, again and again; without ``repeat`` each is there once with so many times
    its volume.
    """
    model, x, p = _square()
    (block,), (slots,) = model.blocks, node_pairs(model.lists)[1]
    each, count = block.weight.shape
    number = np.arange(-(-n // count)) % each
    if repeat:
        block, slots, p = jax.tree.map(lambda v: v[number], (block, slots, p))
    else:
        block = dataclasses.replace(block, weight=block.weight * np.bincount(number, minlength=each)[:, None])
    return dataclasses.replace(model, blocks=(block,)), (slots,), x, p


@functools.cache
def _square():
    """Model of a square of 36 cells with 20 nodes each, positions (n, 2) of a deformed state, and pressures (g,).

    The gradients are those of moving least squares with a Gaussian weight: exact for linear fields, and made without compiling.
    """
    nodes = np.stack(np.meshgrid(np.arange(7.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
    centres = np.stack(np.meshgrid(np.arange(6) + 0.5, np.arange(6) + 0.5), axis=-1).reshape(-1, 2)
    listed = np.sort(np.argsort(np.linalg.norm(nodes - centres[:, None], axis=2), axis=1, kind="stable")[:, :20], axis=1)
    points = centres[:, None] + 0.5 / np.sqrt(3) * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
    offset = nodes[listed][:, None] - points[:, :, None]  # (c, q, a, 2)
    weight = np.exp(-np.sum(offset**2, axis=-1, keepdims=True))
    offset -= np.sum(weight * offset, axis=2, keepdims=True) / np.sum(weight, axis=2, keepdims=True)
    dphi = np.linalg.solve(np.swapaxes(offset, 2, 3) @ (weight * offset), np.swapaxes(weight * offset, 2, 3))
    block = CellBlock(np.arange(36), listed, np.swapaxes(dphi, 2, 3), np.full((36, 4), 0.25))
    topology = SimpleNamespace(node_vertices=np.arange(49))
    lists = Connectivity(topology, listed, np.ones(listed.shape), (), (np.arange(36),), np.zeros((0, 2)))
    model = Model(None, (block,), None, lists, "linear", 2.95, "mixed", "conforming", "imls")
    return model, 1.1 * nodes + 0.05 * np.sin(nodes[:, ::-1]), 0.2 + 0.05 * np.sin(np.arange(36.0))
