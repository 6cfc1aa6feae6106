"""Whether this installation computes what it should: versions, float64, threads, and an audit of the compiled kernels.

A released jaxlib sums float64 numbers wrongly beyond 16,384 rows, silently. So each kernel is compiled for several numbers of points and
compared with the same points evaluated one operation at a time, without compilation.
"""

import dataclasses
import functools
import platform
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_info

from . import material, mixed
from .cloud import make_cloud
from .contact import pair_energy
from .discretisation import discretise
from .energy import residual, total_energy
from .samples import sample
from .shape_functions import shape_functions
from .workers import usable_cores

SIZES = (1, 7, 1000, 16_385, 32_769)
DISTINCT = 1000  # points evaluated without compilation; more are repetitions of these
AGREEMENT = 1e-9  # largest difference over the largest value: round-off stays below 1e-11, a wrong program is wrong in the first digits
GELS = {
    "neo-Hookean": material.Gel(Nv=1e-3, chi=0.2),
    "Gent": material.Gel(Nv=1e-3, chi=0.2, network=material.Gent(30.0)),
    "Arruda-Boyce": material.Gel(Nv=1e-3, chi=0.2, network=material.ArrudaBoyce(8.0)),
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

    Nearly all the time goes into compiling, which several kernels do at once. ``names`` chooses among the kernels.
    """
    tasks = {name: functools.partial(_at_points, name, sizes, *kernel) for name, kernel in point_kernels().items()}
    tasks |= {name: functools.partial(_on_sheets, name, sizes, kernel) for name, kernel in model_kernels().items()}
    tasks = [tasks[name] for name in names or tasks]
    with ThreadPoolExecutor(usable_cores()) as pool:
        yield from pool.map(lambda task: task(), tasks)


def _at_points(name, sizes, function, arguments):
    with jax.disable_jit():
        expected = jax.vmap(function)(*arguments)
    compiled = jax.jit(jax.vmap(function))
    return _worst(name, {n: _difference(compiled(*_repeated(arguments, n)), _repeated(expected, n)) for n in sizes})


def _worst(name, differences):
    worst = max(differences, key=lambda n: np.inf if np.isnan(differences[n]) else differences[n])
    return Finding(name, differences[worst], worst)


def _difference(found, expected):
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    return max(float(jnp.max(jnp.abs(a - b)) / (jnp.max(jnp.abs(b)) + 1e-300)) for a, b in pairs)


def _repeated(values, n):
    return jax.tree.map(lambda v: v[np.arange(n) % DISTINCT], values)


# --- kernels of a point ------------------------------------------------------------------------------------------------------


def point_kernels():
    """Name -> (function of one point, its arguments for ``DISTINCT`` points)."""
    rng = np.random.default_rng(5)
    F = jnp.asarray(1.3 * np.eye(2) + rng.uniform(-0.2, 0.2, (DISTINCT, 2, 2)))
    mu, J = jnp.asarray(rng.uniform(-5, -0.5, DISTINCT)), jnp.asarray(1 + 10 ** rng.uniform(-4, 0.5, DISTINCT))
    gel, G = GELS["neo-Hookean"], jnp.einsum("pki,pkj->pij", F, F)
    grid = np.stack(np.meshgrid(*2 * [np.arange(-2.0, 3.0)]), axis=-1).reshape(-1, 2)
    nodes = jnp.asarray(grid + rng.uniform(-0.2, 0.2, (DISTINCT, 25, 2)))
    x, matrix = jnp.asarray(rng.uniform(-0.5, 0.5, (DISTINCT, 2))), jnp.asarray(rng.normal(size=(4, 2)))

    def phi(**options):
        return lambda x, nodes: shape_functions(x, nodes, 2.95, **options).real

    def derivatives(gel):
        def energy(F, mu):
            return material.free_energy(F, mu, gel)

        return lambda F, mu: (energy(F, mu), jax.grad(energy)(F, mu), jax.hessian(energy)(F, mu))

    return {
        "matrix times row, summed": (lambda r: jnp.sum(matrix @ r), (x,)),
        **{f"free energy, stress, tangent: {name}": (derivatives(gel), (F, mu)) for name, gel in GELS.items()},
        "Cauchy stress": (lambda F, mu: material.cauchy_stress(F, mu, gel), (F, mu)),
        "free swelling, paper's stress and tangent": (
            lambda G, mu: (material.free_swelling(mu, gel), material.paper_stress(G, mu, gel), material.paper_tangent(G, mu, gel)),
            (G, mu),
        ),
        "pressure, bulk stiffness": (lambda J, mu: (material.osmotic(J, mu, gel), material.bulk_stiffness(J, gel)), (J, mu)),
        "volume ratio at a pressure": (lambda p, mu: material.volume_ratio_at(p, mu, gel), (0.1 * x[:, 0], mu)),
        "shape functions, quadratic, and their gradients": (
            lambda x, nodes: (phi(kind="imls")(x, nodes), jax.jacfwd(phi(kind="imls"))(x, nodes)),
            (x, nodes),
        ),
        "shape functions, complex": (phi(kind="iicvmls", basis="linear"), (x, nodes)),
        "contact": (lambda d: (pair_energy(d, 0.6), jax.grad(pair_energy)(d, 0.6), jax.hessian(pair_energy)(d, 0.6)), (x,)),
    }


# --- kernels of a model ------------------------------------------------------------------------------------------------------


def model_kernels():
    """Name -> function of what `_sheet` gives; all results are sums over cells."""
    gel, loads = GELS["neo-Hookean"], jnp.zeros(())

    def energy(model, fixed, x, p, mu):  # noqa: ARG001
        return total_energy(x, model, gel, mu, loads), residual(x, model, gel, mu, loads)

    def newton(model, fixed, x, p, mu):
        now, _ = mixed.linearise(x, p, model, gel, mu, loads, fixed)
        return now.rhs, mixed.condensed_rhs(now, now, model), mixed.tangent(x, p, now, model, gel, fixed)

    return {"energy and residual": energy, "Newton's right-hand side and tangent": newton}


def _on_sheets(name, sizes, function):
    """A kernel on cells that repeat themselves, compiled, against the same with each cell there once but weighted, not compiled."""
    compiled, differences = jax.jit(function), {}
    for n in sizes:
        once = _sheet(n, repeat=False)
        with jax.disable_jit():
            expected = function(*once)
        differences[n] = _difference(compiled(*_sheet(n, repeat=True)), expected)
    return _worst(name, differences)


def _sheet(n, *, repeat):
    """Model, its constants, positions, pressures and mu of a sheet with ``n`` quadrature points, or a few more to fill a cell.

    Its cells are those of a small square one after another, again and again; without ``repeat`` each is there once with so many times
    its volume.
    """
    model, x, p, mu = _square()
    (block,), (slots,) = model.blocks, mixed.node_pairs(model.lists)[1]
    each, count = block.weight.shape
    number = np.arange(-(-n // count)) % each
    if repeat:
        block, slots, p = jax.tree.map(lambda v: v[number], (block, slots, p))
    else:
        block = dataclasses.replace(block, weight=block.weight * np.bincount(number, minlength=each)[:, None])
    return dataclasses.replace(model, blocks=(block,)), mixed.constants_of(model.lists, (block,), (slots,)), x, p, mu


@functools.cache
def _square():
    """Model of the unit square, positions (n, 2) of a deformed state, pressures (g,) near those of equilibrium, and mu."""
    model = discretise(make_cloud(sample("square")), basis="linear")
    nodes, mu = model.cloud.nodes, jnp.asarray(-1.0)
    x = 1.1 * nodes + 0.02 * jnp.sin(5 * nodes[:, ::-1])
    return model, x, mixed.state_pressure(x, model, GELS["neo-Hookean"], mu) + 1e-3, mu
