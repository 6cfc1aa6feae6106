"""Finite-element values that jaxgel quotes, by NGSolve: jaxgel/paper/finite_elements.json.

NGSolve is in the extra ``[bench]``.

    python benchmarks/finite_elements.py [sample-1 ...]

Without names all cases are computed, in six minutes on one core; a named one replaces its own
values only. Each value is that of its case's first mesh, rounded to the decimal place of its
``spread``, the largest difference that the other meshes make.

Samples 4-8 and the lattice have meshes with their mirror lines, so that symmetric states stay
symmetric and the lowest eigenvalue of the tangent passes 0 at the critical mu. The buckled branch
is entered from there along the mode. Outlines do not feel each other. At the last two mu of sample
4 its buckled surface is compressed past Biot's limit, a ratio of 3.4: finer meshes wrinkle and lose
the smooth state, so the spread there is one between meshes that are too coarse to. Sample 6 loses
it soon after its last mu. Sample 9 is left out: the finer its corners, the earlier they overlap,
and it does not buckle before.
"""

import argparse
import dataclasses
import itertools
import json
import re
import time
from pathlib import Path

import ngsolve as ng
import numpy as np
import shapely
from ngsolve_gel import MixedGel, plate_mesh
from scipy.interpolate import BarycentricInterpolator

from jaxgel import sample
from jaxgel.observables import CREASE_RATIO

FILE = Path(__file__).parents[1] / "jaxgel" / "paper" / "finite_elements.json"
# mu of the first state, reached from the dry plate at once, and the largest step, kT
START, STEP = -4.9678, 0.125
# beyond the critical mu: where the buckled branch is entered and first followed, kT
PAST = (0.02, 0.04, 0.06, 0.1)
OBSERVED = {
    "rotation": lambda gel: abs(gel.midline_rotation()),
    "core": lambda gel: abs(gel.core_rotation()),
    "area": MixedGel.area_reduction,
    "energy": MixedGel.energy,
    "surface_ratio": lambda gel: gel.outlines()[2].max(),
}


@dataclasses.dataclass(frozen=True)
class Mesh:
    """Order of the displacements.

    Longest edges in the plate, on the outlines and at their corners, mm.
    """

    order: int
    plate: float
    hole: float
    corner: float | None = None


@dataclasses.dataclass(frozen=True)
class Case:
    """Requested states of a plate: symmetric at ``mu``, critical, and buckled at ``buckled``."""

    meshes: tuple
    mu: tuple
    folds: int = 1
    buckled: tuple = ()
    names: tuple = ("area", "energy")


TURNED = ("rotation", "core", "area", "energy")
CASES = {
    "sample-1": Case(
        (Mesh(5, 1.0, 0.12), Mesh(4, 1.2, 0.25)),
        (-4.9678, -3.9678, -2.9678, -1.9678, -1.4678, -0.9678, -0.9178),
        folds=0,
        names=TURNED,
    ),
    "sample-4": Case(
        (Mesh(5, 1.5, 0.4), Mesh(4, 2.0, 0.5)),
        (-2.9678, -1.9678, -1.4678, -1.0678, -0.9678),
        buckled=(-1.4678, -0.9678, -0.9178),
        names=(*TURNED, "surface_ratio"),
    ),
    "sample-5": Case((Mesh(5, 1.5, 0.4), Mesh(4, 2.0, 0.5)), (-1.9678, -1.4678, -1.0678, -0.9678)),
    "sample-6": Case((Mesh(5, 1.5, 0.4), Mesh(4, 2.0, 0.5)), (-1.9678, -1.4678, -1.0678)),
    "sample-7": Case(
        (Mesh(4, 1.5, 0.4, 0.004), Mesh(4, 1.0, 0.25, 0.02), Mesh(5, 2.0, 0.5, 0.1)), (-2.9678,)
    ),
    "sample-8": Case((Mesh(4, 1.5, 0.4, 0.05), Mesh(5, 2.0, 0.5, 0.1)), (-1.9678,)),
    "lattice": Case(
        (Mesh(5, 0.5, 0.2), Mesh(4, 0.35, 0.15)),
        (),
        folds=3,
        buckled=(-1.9678,),
        names=("core", "area", "energy"),
    ),
}
FAMILIES = {"20": "sample-4", "15": "sample-5", "10": "sample-6"}  # holes of so many pi mm^2


def main(names):
    known = json.loads(FILE.read_text(encoding="utf-8"))
    for name in names or CASES:
        results = [values_of(name, mesh) for mesh in CASES[name].meshes]
        sizes = [result.pop("mesh") for result in results]
        known[name] = with_spread(results) | {"mesh": f"{sizes[0]}; spread: {'; '.join(sizes[1:])}"}
    content = {
        "about": (
            f"`python benchmarks/finite_elements.py` with NGSolve {ng.__version__}: mixed "
            "elements, the pressure of one order less; the spread is the largest difference to "
            "other meshes. "
            "Rotation is the midline angle of the paper, core rotation the polar rotation at the "
            "plate's centre, of the lattice at (1, 1)."
        ),
        "units": (
            "mu kT, rotations degrees, energy kT/v mm^2 (lattice: 1e-6 mm^2); area is the area "
            "reduction of all holes"
        ),
        **{name: known[name] for name in CASES},
        "areas": families(known),
    }
    FILE.write_text(compact(content), encoding="utf-8")


def compact(content):
    """JSON with each list of numbers on one line."""
    return (
        re.sub(
            r"\[[^][]*\]",
            lambda row: f"[{' '.join(row[0][1:-1].split())}]",
            json.dumps(content, indent=1),
        )
        + "\n"
    )


def values_of(name, mesh):
    """All values of a case on one mesh, printed as they come."""
    begin, case, plate = time.perf_counter(), CASES[name], sample(name)
    grid = plate_mesh(
        plate, mesh.order, mesh.plate, mesh.hole, corner=mesh.corner, folds=case.folds
    )
    gel = MixedGel(plate, grid, mesh.order, steps=4)
    corner = "" if mesh.corner is None else f", {mesh.corner} mm at corners"
    values = {
        "mesh": (
            f"P{mesh.order}, {grid.ne} curved triangles{corner}, {gel.free_dofs} free displacements"
        )
    }

    def found(new):
        values.update(new)
        print(
            f"{name}, {values['mesh']}, {time.perf_counter() - begin:.0f} s: {json.dumps(new)}",
            flush=True,
        )

    if not case.folds:
        found(turning(gel, case))
        return values
    found(onset := critical(gel))
    if case.buckled:
        enter(gel, onset["critical_mu"])
        found(
            {
                "buckled": table(
                    gel,
                    stops(onset["critical_mu"] + PAST[-1], case.buckled),
                    case.buckled,
                    case.names,
                )
            }
        )
    if name == "lattice":
        found(first_contact(gel, case.buckled[-1]))
    if case.mu:
        gel.state.vec[:] = 0
        found({"symmetric": table(gel, stops(START, case.mu), case.mu, ("area", "energy"))})
    return values


def stops(start, wanted):
    """Increasing mu from ``start`` through all of ``wanted``, at most ``STEP`` apart."""
    evenly = np.arange(start, max(wanted), STEP)
    apart = np.abs(evenly[:, None] - np.array(wanted)).min(axis=1) > STEP / 10
    return sorted({*evenly[apart].round(9).tolist(), round(start, 9), *wanted})


def table(gel, mus, wanted, names):
    """Columns of observed values at the mu that are ``wanted`` of those gone through."""
    rows = [[OBSERVED[name](gel) for name in names] for mu in gel.follow(mus) if mu in wanted]
    return {
        "mu": list(wanted),
        **{name: list(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)},
    }


def zero(mus, values):
    """The mu at which the values pass 0, by the polynomial mu(value) through the points given."""
    return float(BarycentricInterpolator(np.array(values) / np.ptp(values), mus)(0))


def turning(gel, case):
    """Sample 1: its states, and the mu at which its surface reaches the crease limit."""
    mus = stops(START, case.mu)
    columns = table(gel, mus, mus, (*case.names, "surface_ratio"))
    k = int(np.searchsorted(columns["surface_ratio"], CREASE_RATIO))
    crease = zero(
        mus[k - 2 : k + 2], np.array(columns.pop("surface_ratio")[k - 2 : k + 2]) - CREASE_RATIO
    )
    wanted = [mus.index(mu) for mu in case.mu]
    return {name: [column[k] for k in wanted] for name, column in columns.items()} | {
        "crease_mu": crease
    }


def critical(gel):
    """Critical mu of the symmetric branch, and the area reduction there.

    The lowest eigenvalue is 0; the state is left close by.
    """
    gel.state.vec[:] = 0
    lowest, area = {}, {}
    for mu in gel.follow(START + STEP * k for k in itertools.count()):
        negative, values, _ = gel.modes()
        lowest[mu], area[mu] = values[0], gel.area_reduction()
        if negative:
            break
    for _ in range(8):
        near = sorted(lowest, key=lambda at: abs(lowest[at]))[:3]
        guess = zero(near, [lowest[at] for at in near])
        if min(abs(guess - at) for at in near) < 1e-4:  # no closer: the tangent is singular there
            return {
                "critical_mu": guess,
                "critical_area": float(
                    BarycentricInterpolator(near, [area[at] for at in near])(guess)
                ),
            }
        gel.equilibrium(guess)
        lowest[guess], area[guess] = gel.modes()[1][0], gel.area_reduction()
    raise RuntimeError(f"the lowest eigenvalue was not followed to 0: {lowest}")


def enter(gel, mu):
    """Branch switching from near the critical ``mu``, by the mode with a growing amplitude."""
    gel.equilibrium(mu + PAST[0])
    state, mode = gel.state.vec.FV().NumPy(), gel.modes()[2][0]
    symmetric = state.copy()
    for amplitude in 0.05 * 1.3 ** np.arange(12):  # mm
        state[:] = symmetric + amplitude * mode
        gel.equilibrium(mu + PAST[0], keep=False)
        if abs(gel.core_rotation()) > 0.3:  # degrees; the symmetric state has 0.002
            break
    for _ in gel.follow(mu + past for past in PAST):
        pass
    if abs(gel.core_rotation()) < 0.3 or gel.modes()[0]:
        raise RuntimeError(f"no stable buckled state was found at mu = {mu + PAST[-1]:.4f}")


def first_contact(gel, start):
    """The mu at which an outline first touches itself, by bisection, and its area reduction."""
    state, below = gel.state.vec.FV().NumPy(), None
    for mu in gel.follow(start + STEP / 2 * k for k in itertools.count()):
        if overlaps(gel):
            break
        below = mu, state.copy()
    low, high = below[0], mu
    while high - low > 1e-6:
        middle = (low + high) / 2
        gel.equilibrium(middle)
        low, high = (low, middle) if overlaps(gel) else (middle, high)
    return {"first_contact_mu": low, "area_at_first_contact": gel.area_reduction()}


def overlaps(gel):
    """Whether the outline of a whole circular hole crosses itself."""
    dry, deformed, _ = gel.outlines(64)
    for centre, radius in ((np.array(hole.centre), float(hole.radius)) for hole in gel.plate.holes):
        arm = dry - centre
        own = np.flatnonzero(np.abs(np.linalg.norm(arm, axis=1) / radius - 1) < 1e-3)
        inside = np.abs(centre).max() + radius < gel.plate.width / 2
        if (
            inside
            and not shapely.LinearRing(deformed[own[np.argsort(np.arctan2(*arm[own].T))]]).is_simple
        ):
            return True
    return False


def with_spread(results):
    """The first of some results (dicts), rounded to the largest difference to the others."""
    first, spread, values = results[0], {}, {}
    for key, value in first.items():
        if isinstance(value, dict):
            values[key] = with_spread([result[key] for result in results])
        elif key == "mu":
            values[key] = value
        else:
            apart = np.max(
                [np.abs(np.subtract(value, other[key])) for other in results[1:]], axis=0
            )
            places = np.clip(np.ceil(-np.log10(np.maximum(apart, 1e-6))), 0, 6).astype(int)
            values[key] = np.vectorize(lambda v, n: round(float(v), int(n)))(value, places).tolist()
            spread[key] = np.vectorize(lambda s: float(f"{s:.1e}"))(apart).tolist()
    return values | ({"spread": spread} if spread else {})


def families(content):
    """Area reduction of holes of three sizes at equal mu, from symmetric states of samples 4-6."""
    mus = (-1.4678, -1.0678)
    tables = {size: content[name]["symmetric"] for size, name in FAMILIES.items()}
    area = {
        size: [table["area"][table["mu"].index(mu)] for mu in mus] for size, table in tables.items()
    }
    return {
        "about": "four circular holes of so many pi mm^2 each: the symmetric states of samples 4-6",
        "mu": mus,
        "area": area,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)} (all)")
    names = parser.parse_args().names
    if unknown := set(names) - set(CASES):
        parser.error(f"unknown case {', '.join(unknown)}")
    main(names)
