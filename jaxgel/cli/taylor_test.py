"""Taylor test of a case's gradients: what is left of f(x + h d) - f(x) - h f'(x) d must fall as h^2.

A wrong derivative leaves a remainder that falls as h, down to the smallest h. The states are solved anew for every h, so nothing of the
derivative is taken for granted; the gradient is the one that reverse mode gives to every optimiser.

The moved states are those of the start's branch, found by Newton's method from there: a sweep of a symmetric plate may end on either
mirror image. Under a moving hole the slope of an objective has small jumps, where a node enters or leaves a support: the paper's weight
function has a continuous slope there, so its gradients have kinks. A direction that crosses one falls irregularly, but a wrong
derivative shows in every random direction: steps are short, and a family is judged by the median of its directions.
"""

import csv
import dataclasses
import io
import math
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from tqdm import tqdm

from ..bifurcation import imperfection_load, sweep_by_options
from ..cases import Case
from ..continuation import Path
from ..equilibrium import acting_problem, solve
from ..io import write_atomically
from ..materials import Composite, Elastomer, matrix_of, named_parameters
from ..mechanics import condensed_rhs, factorised_tangent, linearise, prepare, scatter, with_contact
from ..observables import area_reduction, core_rotation, is_flat, rotation_angle

DIRECTIONS, HALVINGS, STATES = 5, 4, 4
RATE = 1.95  # least rate; theory: 2
RATE_ERROR = 0.05  # of a rate that is judged: below 2 - 0.05 = RATE it is not noise
NOISE_VALUES = 9  # values, the last step apart, from which the noise is estimated
STEPS = {"angle": 2e-5, "cos": 2e-5, "sin": 2e-5, "exponent": 1e-4, "mu": 0.01, "chi": 0.005, "stretch": 1e-3}
STEPS |= {"temperature": 0.1, "pH": 0.02, "pKa": 0.02}
LENGTH = 1e-4  # first step of lengths over the node spacing
SHARE = {"Nv": 0.1, "bulk": 0.02, "materials: Nv": 0.02, "salt": 0.05, "acid_fraction": 0.02, "solvent_volume": 0.02, "load": 0.05}
"""First step over the value: the effect of a gel's Nv is nearly linear."""
FILE = "check-grad.csv"
REGIONS, MATERIALS = "regions: ", "materials: "  # what the names of their families begin with
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
    """Name of the parameters that vary together, of all holes, of all ``regions`` or of the ``materials`` of these."""
    direction: int
    """Number of the random direction."""
    slope: float
    """Derivative along the direction, over its first step."""
    steps: tuple
    """h, each half the one before; in units of the first step."""
    remainders: tuple
    """|f(x + h d) - f(x) - h f'(x) d| at each h."""
    rate: float
    """Least order with which it falls from one step to the next above round-off; inf where none is above, nan for a nan."""


def check_gradient(
    case: Case, *, directions: int = DIRECTIONS, halvings: int = HALVINGS, states: int | None = None, seed: int = 0, quiet: bool = True
) -> list[Row]:
    """List of `Row`: every objective that has a value, every family of parameters, every direction, for a `Case`.

    The sweep has ``states`` equally spaced values of its control between the case's ends; None takes those that the case lists, or
    ``STATES``. The control's own parameters, as the mu at which another is driven, are families too.
    Directions are normally distributed with the given ``seed``. The load of an imperfection is that of the start and stays constant.
    Raises ValueError for a case that cannot be used and ``ArithmeticError`` where its states are not found.
    """
    plate, cloud = case.plate, case.discretisation.cloud(case.plate)
    options, driven = case.sweep, case.sweep.control
    values = np.array(options.values) if states is None and options.listed else np.linspace(*options.ends, states or STATES)
    point = _point(plate, case.gel, driven, values, options.at_mu)

    def moved(tree):
        """The model with the holes of a point."""
        holes = [{name: tree[name][k] for name in hole.theta} for k, hole in enumerate(plate.holes)]
        regions = [{name: tree[REGIONS + name][k] for name in region.theta} for k, region in enumerate(plate.regions)]
        return case.discretisation.model(cloud.at(plate.at(holes, regions)))

    def made(tree):
        """Model, gel, nodal loads (n, 2) and control of a point; the start's model where only the gel or the control are others."""
        model = start.model if start and all(tree[name] is point[name] for name in outlines) else moved(tree)
        loads = case.loads.of(model)
        control = options.driver(loads)
        return model, _gel_at(case.gel, tree, driven), loads, control if control is None else dataclasses.replace(control, mu=tree["mu"])

    outlines = [name for name in point if name in _outlines(plate)]
    start = None
    model, gel, loads, _ = made(point)
    push = imperfection_load(model, gel, options, loads=loads)

    def path(tree):
        model, gel, loads, control = made(tree)
        return sweep_by_options(model, gel, options, values=tree[driven], control=control, loads=loads, push=push)

    def read(path, names):
        return jnp.stack([OBJECTIVES[name](path) for name in names])

    start = path(point)
    if len(start) < len(values):
        raise ArithmeticError(f"check-grad: {start.stop_text}; choose another {'--mu-end' if driven == 'mu' else '--to'}")
    names = differentiable(start)
    _, pullback = jax.vjp(lambda tree: read(path(tree), names), point)
    gradients = [pullback(row)[0] for row in jnp.eye(len(names))]

    def evaluate(tree):
        model, gel, loads, control = made(tree)
        model = with_contact(model, gel) if options.contact == "on" else model
        dead = sum(part for part in (push, None if driven == "load" else loads) if part is not None)
        return read(_beside(start, prepare(model, gel, dead + np.zeros((model.n_nodes, 2)), control=control), tree[driven]), names)

    found_at_start = evaluate(point)
    random, rows = np.random.default_rng(seed), []
    with tqdm(total=len(point) * directions, unit="direction", disable=True if quiet else None, leave=False) as bar:
        for family in point:
            floors = _round_off(evaluate, point, family, _direction(random, family, point, cloud.spacing), _steps(halvings)[-1])
            for number in range(directions):
                towards = _direction(random, family, point, cloud.spacing)
                remainders = _remainders(evaluate, point, family, towards, found_at_start, gradients, halvings)
                found = zip(names, remainders, floors, strict=True)
                rows += [_row(name, family, number, one, floor, halvings) for name, one, floor in found]
                bar.update()
    return sorted(rows, key=lambda row: (list(OBJECTIVES).index(row.objective), list(point).index(row.family), row.direction))


def differentiable(path: Path) -> tuple[str, ...]:
    """Names of the objectives that have a value and a derivative at the path's last state; nan would spread to the others'."""
    level = {"rotation"} if is_flat(path.x[-1:], path.model)[0] else set()
    return tuple(name for name, objective in OBJECTIVES.items() if name not in level and np.isfinite(objective(path)))


def failures(rows: list[Row]) -> list[tuple[str, str]]:
    """(objective, family) of all whose median rate is below ``RATE``, of those directions that leave a remainder above round-off."""
    rates = {}
    for row in rows:
        rates.setdefault((row.objective, row.family), []).extend([] if row.rate == np.inf else [row.rate])
    return [pair for pair, found in rates.items() if found and not np.median(found) >= RATE]  # nan is none


def write_table(rows: list[Row], folder: pathlib.Path) -> None:
    """The rows as ``check-grad.csv`` in a folder: one line per row, the remainders in the order of their steps."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    steps = rows[0].steps
    writer.writerow(["objective", "family", "direction", "slope", *(f"remainder at h = {h:g}" for h in steps), "rate"])
    for row in rows:
        remainders = [repr(r) for r in row.remainders]
        writer.writerow([row.objective, row.family, row.direction, repr(row.slope), *remainders, f"{row.rate:.4f}"])
    write_atomically(folder / FILE, lambda stream: stream.write(text.getvalue().encode()))


def _point(plate, gel, driven, values, at_mu):
    """Family -> its values: hole parameters {hole: value} by name, those of regions, then those of the gel, numbers or fields.

    Last come the ``values`` of the control by its name, which no parameter of the gel has then, and mu.
    """
    families = {}
    for prefix, own in (("", plate.holes), (REGIONS, plate.regions)):
        for k, outline in enumerate(own):
            for name, value in outline.theta.items():
                families.setdefault(prefix + name, {})[k] = value
    matrix, materials = matrix_of(gel), gel.regions if isinstance(gel, Composite) else ()
    for k, material in enumerate(materials):
        for name in ("Nv", "bulk") if isinstance(material, Elastomer) else _parameters(matrix, driven):
            families.setdefault(MATERIALS + name, {})[k] = getattr(material, name)
    families |= {name: getattr(matrix, name) for name in _parameters(matrix, driven)}
    families |= {driven: values} | ({} if driven == "mu" else {"mu": at_mu})
    return jax.tree.map(lambda value: jnp.asarray(value, dtype=float), families)


def _outlines(plate):
    """Names of the families that move outlines."""
    return {prefix + name for prefix, own in (("", plate.holes), (REGIONS, plate.regions)) for outline in own for name in outline.theta}


def _parameters(gel, driven):
    """Names of a gel's parameters that are families."""
    return [name for name in named_parameters(gel) if (name in STEPS or name in SHARE) and name != driven]


def _gel_at(gel, tree, driven):
    """The gel or `materials.Composite` with the parameters of a point."""
    if not isinstance(gel, Composite):
        return dataclasses.replace(gel, **{name: tree[name] for name in _parameters(gel, driven)})
    own = {name.removeprefix(MATERIALS): values for name, values in tree.items() if name.startswith(MATERIALS)}
    regions = [
        dataclasses.replace(one, **{name: values[k] for name, values in own.items() if k in values}) for k, one in enumerate(gel.regions)
    ]
    return Composite(_gel_at(gel.matrix, tree, driven), tuple(regions))


def _direction(random, family, point, spacing):
    """A random direction, a tree as the family's values, whose length is the first step."""
    flat, unravel = ravel_pytree(point[family])
    normal = random.normal(size=flat.shape)
    normal /= np.linalg.norm(normal)
    name = family.removeprefix(MATERIALS).removeprefix(REGIONS)
    share = SHARE.get(family, SHARE.get(name))
    size = STEPS.get(name, LENGTH * spacing) if share is None else np.abs(np.asarray(flat)) * share
    return unravel(jnp.asarray(normal * size * np.sqrt(len(flat)) * random.uniform(0.5, 1.0)))


def _remainders(evaluate, point, family, towards, values, gradients, halvings):
    """(slope, remainders) of each objective along one direction of a family."""
    slopes = [float(np.vdot(ravel_pytree(g[family])[0], ravel_pytree(towards)[0])) for g in gradients]
    found = [[] for _ in slopes]
    for h in _steps(halvings):
        for remainders, slope, change in zip(found, slopes, _moved(evaluate, point, family, towards, h) - values, strict=True):
            remainders.append(abs(float(change) - h * slope))
    return list(zip(slopes, found, strict=True))


def _steps(halvings):
    return tuple(0.5**k for k in range(halvings + 1))


def _beside(start, problem, values):
    """The path of a moved problem at ``values`` (k,) of its control, on the branch of the path ``start``; nan where it is not found."""
    moved = problem.model.cloud.nodes - start.model.cloud.nodes
    found = []
    for value, x, pressure in zip(values, start.x, jnp.asarray(start.pressure), strict=True):
        carried = moved @ np.asarray(problem.edge_deformation(value)).T  # where the constrained ones have to be
        found.append(solve(problem, value, x + carried, pressure))
    columns = {"x": [_to_round_off(problem, state) for state in found], "pressure": [state.pressure for state in found]}
    columns["mu"] = [jnp.asarray(problem.at(value)[1]) for value in values]
    columns = {name: jnp.stack(column) for name, column in columns.items()}
    return dataclasses.replace(start, model=problem.model, gel=problem.gel, control=problem.control, value=values, **columns)


def _to_round_off(problem, state):
    """Positions (n, 2) of a `State` after one more correction, which removes what the solver's tolerance left; nan for a failed one."""
    if not state.status.ok:
        return jnp.full_like(state.x, jnp.nan)
    problem = acting_problem(problem, state)
    linearisation = linearise(problem, state.x, state.pressure, state.mu)
    made = factorised_tangent(problem, state.x, state.pressure, linearisation)
    dx = made.solve(np.asarray(condensed_rhs(problem, linearisation, linearisation)))[0]
    return state.x + scatter(dx, state.x.shape, problem.free)


def _round_off(evaluate, point, family, towards, step):
    """Remainders (o,) below which a rate is in doubt by more than ``RATE_ERROR``, from the noise of the objectives along a direction.

    The noise is that of More & Wild (2011), ECNoise: differences of order k of values at equal distances have sqrt((2k)!) / k! times
    their standard deviation, once k is so large that the function itself drops out. A remainder is made of two values and known to
    3 sqrt(2) standard deviations; its rate with one four times as large then to 5/4 of its relative error over ln 2.
    """
    values = np.array([_moved(evaluate, point, family, towards, k * step) for k in range(NOISE_VALUES)])
    orders = [(np.diff(values, k, axis=0), math.factorial(k) ** 2 / math.factorial(2 * k)) for k in (4, 5, 6)]
    noise = np.max([np.sqrt(share * np.mean(differences**2, axis=0)) for differences, share in orders], axis=0)
    return 3 * np.sqrt(2) * noise * 1.25 / (RATE_ERROR * np.log(2))


def _moved(evaluate, point, family, towards, h):
    """Values (o,) of the objectives at the start plus ``h`` times a direction of a family."""
    return evaluate(point | {family: jax.tree.map(lambda x, d: x + h * d, point[family], towards)})


def _row(name, family, number, found, floor, halvings):
    slope, remainders = found
    above = np.array(remainders) > floor
    judged = above[1:] & above[:-1]
    rates = np.log2(np.divide(remainders[:-1], remainders[1:], out=np.ones(halvings), where=judged))
    rate = float(np.min(rates[judged], initial=np.inf)) if np.all(np.isfinite(remainders)) else np.nan
    return Row(name, family, number, slope, _steps(halvings), tuple(remainders), rate)
