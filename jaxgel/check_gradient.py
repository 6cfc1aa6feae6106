"""Taylor test of a case's gradients: what is left of f(x + h d) - f(x) - h f'(x) d must fall as h^2.

A wrong derivative leaves a remainder that falls as h, down to the smallest h. The states are solved anew for every h, so nothing of the
derivative is taken for granted; the gradient is the one that reverse mode gives to every optimiser.

Under a moving hole the slope of an objective has small jumps, where a node enters or leaves a support: the paper's weight function has
a continuous slope there, so its gradients have kinks. A direction that crosses one falls irregularly; steps are therefore short, the rate
is that between the last two, and a family is judged by the median of its directions.
"""

import csv
import dataclasses
import functools
import io

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from tqdm import tqdm

from .cloud import make_cloud
from .discretisation import discretise
from .observables import area_reduction, core_rotation, rotation_angle
from .results import write_atomically
from .sweep import sweep

DIRECTIONS, HALVINGS, STATES = 5, 4, 4
RATE = 1.95  # least rate; theory: 2
ROUND_OFF = 2e-11  # of the objective, or of one degree or 1 if that is more: a remainder below it is that of the linear solves
STEPS = {"angle": 2e-5, "cos": 2e-5, "sin": 2e-5, "exponent": 1e-4, "mu": 0.01, "chi": 0.005}
LENGTH = 1e-4  # first step of lengths over the node spacing
SHARE = 0.2  # first step of Nv over its value: its effect is nearly linear
FILE = "check-grad.csv"

OBJECTIVES = {
    "rotation": lambda path: rotation_angle(path)[-1],
    "core rotation": lambda path: core_rotation(path)[-1],
    "area reduction": lambda path: area_reduction(path)[-1],
    "whole curve": lambda path: jnp.mean(rotation_angle(path) ** 2) / 100 + jnp.mean(area_reduction(path)),
}
"""What is differentiated: three quantities at the last mu, degrees or 1, and a mean over all states of the path."""


@dataclasses.dataclass(frozen=True)
class Row:
    """The Taylor test of one objective along one direction of one family of parameters."""

    objective: str
    """A name of ``OBJECTIVES``."""
    family: str
    """Name of the parameters that vary together, of all holes."""
    direction: int
    """Number of the random direction."""
    slope: float
    """Derivative along the direction, over its first step."""
    steps: tuple
    """h, each half the one before; in units of the first step."""
    remainders: tuple
    """|f(x + h d) - f(x) - h f'(x) d| at each h."""
    rate: float
    """Order with which the remainder falls between the last two steps above round-off; inf where there are none, nan for a nan."""


def check_gradient(case, *, directions=DIRECTIONS, halvings=HALVINGS, states=STATES, seed=0, quiet=True):
    """List of `Row`: every objective that has a value, every family of parameters, every direction, for a `cases.Case`.

    The sweep has ``states`` equally spaced mu between the case's ends; directions are normally distributed with the given ``seed``.
    Raises ValueError for a case that cannot be used and ``ArithmeticError`` where its states are not found.
    """
    plate, d = case.plate, case.discretisation
    cloud = make_cloud(plate, spacing=d.spacing, nodes_per_hole=d.nodes_per_hole)
    mu = np.linspace(*case.sweep.ends, states)
    point = _point(plate, case.gel, mu)

    def judge(tree, names=tuple(OBJECTIVES)):
        placed = cloud.at(plate.at([{name: tree[name][k] for name in hole.theta} for k, hole in enumerate(plate.holes)]))
        model = discretise(placed, basis=d.basis, dmax=d.dmax, method=d.method, quadrature=d.quadrature)
        gel = dataclasses.replace(case.gel, Nv=tree["Nv"], chi=tree["chi"])
        path = sweep(model, gel, mu=tree["mu"], branch=case.sweep.branch)
        return jnp.stack([OBJECTIVES[name](path) for name in names])

    names = tuple(name for name, value in zip(OBJECTIVES, judge(point), strict=True) if np.isfinite(value))
    if not names:
        raise ArithmeticError(f"check-grad: no state at mu = {mu[-1]:g}; choose another --mu-end")
    judge = functools.partial(judge, names=names)  # a quantity without a value would leave nan in the others' derivatives
    values, pullback = jax.vjp(judge, point)
    gradients = [pullback(row)[0] for row in jnp.eye(len(names))]
    random, rows = np.random.default_rng(seed), []
    with tqdm(total=len(point) * directions, unit="direction", disable=True if quiet else None, leave=False) as bar:
        for family in point:
            for number in range(directions):
                towards = _direction(random, family, point, cloud.spacing)
                remainders = _remainders(judge, point, family, towards, values, gradients, halvings)
                found = zip(names, remainders, values, strict=True)
                rows += [_row(name, family, number, one, value, halvings) for name, one, value in found]
                bar.update()
    return sorted(rows, key=lambda row: (list(OBJECTIVES).index(row.objective), list(point).index(row.family), row.direction))


def failures(rows):
    """(objective, family) of all whose median rate is below ``RATE``."""
    rates = {}
    for row in rows:
        rates.setdefault((row.objective, row.family), []).append(row.rate)
    return [pair for pair, found in rates.items() if not np.median(found) >= RATE]  # nan is none


def write_table(rows, folder):
    """The rows as ``check-grad.csv`` in a folder: one line per row, the remainders in the order of their steps."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    steps = rows[0].steps
    writer.writerow(["objective", "family", "direction", "slope", *(f"remainder at h = {h:g}" for h in steps), "rate"])
    for row in rows:
        remainders = [repr(r) for r in row.remainders]
        writer.writerow([row.objective, row.family, row.direction, repr(row.slope), *remainders, f"{row.rate:.4f}"])
    write_atomically(folder / FILE, lambda stream: stream.write(text.getvalue().encode()))


def _point(plate, gel, mu):
    """Family -> its values: hole parameters {hole: value} by name, then Nv, chi and mu."""
    families = {}
    for k, hole in enumerate(plate.holes):
        for name, value in hole.theta.items():
            families.setdefault(name, {})[k] = jnp.asarray(value, dtype=float)
    return families | {"Nv": jnp.asarray(gel.Nv, dtype=float), "chi": jnp.asarray(gel.chi, dtype=float), "mu": jnp.asarray(mu)}


def _direction(random, family, point, spacing):
    """A random direction, a tree as the family's values, whose length is the first step."""
    flat, unravel = ravel_pytree(point[family])
    normal = random.normal(size=flat.shape)
    normal /= np.linalg.norm(normal)
    if family == "chi":
        normal = np.abs(normal)  # chi is above 0 and may be near it
    size = np.abs(np.asarray(flat)) * SHARE if family == "Nv" else STEPS.get(family, LENGTH * spacing)
    return unravel(jnp.asarray(normal * size * np.sqrt(len(flat)) * random.uniform(0.5, 1.0)))


def _remainders(judge, point, family, towards, values, gradients, halvings):
    """(slope, remainders) of each objective along one direction of a family."""
    slopes = [float(np.vdot(ravel_pytree(g[family])[0], ravel_pytree(towards)[0])) for g in gradients]
    found = [[] for _ in slopes]
    for h in _steps(halvings):
        moved = judge(point | {family: jax.tree.map(lambda x, d, h=h: x + h * d, point[family], towards)})
        for remainders, slope, change in zip(found, slopes, moved - values, strict=True):
            remainders.append(abs(float(change) - h * slope))
    return list(zip(slopes, found, strict=True))


def _steps(halvings):
    return tuple(0.5**k for k in range(halvings + 1))


def _row(name, family, number, found, value, halvings):
    slope, remainders = found
    above = np.array(remainders) > ROUND_OFF * max(abs(float(value)), 1.0)
    last = int(np.argmin(above)) if not above.all() else len(above)  # steps before the first one in round-off
    rate = float(np.log2(remainders[last - 2] / remainders[last - 1])) if last > 1 else np.inf
    rate = rate if np.all(np.isfinite(remainders)) else np.nan
    return Row(name, family, number, slope, _steps(halvings), tuple(remainders), rate)
