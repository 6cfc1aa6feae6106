"""Accuracy of jaxgel against refined finite elements, one table per row of `ROWS`.

The references are references.json and jaxgel/paper/finite_elements.json.

    python benchmarks/accuracy.py [--rows core midline ...] [--nodes 1000 1800] [--across 4]
    [--option dmax=3.5]

Every table says what is measured, the error of each cloud and the target. The rows core, midline,
energy and nodal share one sweep of sample 1 per cloud; nodal and outline solve the finite elements
again for the displacement at the nodes (NGSolve, extra ``[bench]``). Contact is off: no sides of
holes meet at these mu. ``searches`` runs the rotation study twice, some ten minutes. ``--out FILE``
keeps the numbers as JSON.
"""  # fmt: skip

import argparse
import ast
import dataclasses
import functools
import json
import math
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel
from jaxgel.cases import load_study
from jaxgel.paper import FINITE_ELEMENTS

REFERENCES = json.loads(Path(__file__).with_name("references.json").read_text(encoding="utf-8"))
# mm: number of nodes of sample 1, about -> spacing
SPACINGS = {1000: 22 / 40, 1800: 22 / 56, 3000: 22 / 72, 5400: 22 / 100}
AT = -1.4678  # mu of the nodal displacements and sensitivities, kT
START = -4.9678  # mu of the first state, kT
ONSETS = {  # case -> spacings, and the target of each in %
    "sample-4": {22 / 58: 0.4},
    "sample-5": {22 / 54: 0.4},
    "sample-7": {22 / 58: 0.4},
    "sample-8": {22 / 54: 0.4},
    "lattice": {0.2: 2.0, 0.15: 0.6, 0.1: 0.3},
}
OUTLINE_NODES = (20, 40, 60, 80, 120, 160)  # per hole
PRESSURES = (45, 71, 150, 500, -150, -600)  # of the plate without holes, Nv
TARGETS = {
    "core": {1000: 0.35, 1800: 0.2, 3000: 0.1, 5400: 0.05},  # %
    "midline": {1000: 0.5, 1800: 0.35, 3000: 0.25, 5400: 0.1},  # %
    "nodal": {1000: 0.0025, 1800: 0.0012, 3000: 0.0006, 5400: 0.0003},  # mm, rms
    "outline": {20: 0.1, 40: 0.04, 60: 0.04, 80: 0.04, 120: 0.04, 160: 0.04},  # mm, largest
    "samples": {"core": 1.0, "midline": 1.0},  # %
    "sensitivities": {"core": 1.5, "midline": 5.0},  # %
}
OBSERVED = {
    "core": lambda path: np.abs(jaxgel.core_rotation(path)),
    "midline": lambda path: np.abs(jaxgel.rotation_angle(path)),
    "energy": lambda path: path.energy,
}
# mu up to which the errors of sample 1 count, kT
LAST = {"core": -0.9178, "midline": AT, "energy": -0.9178}


class Runs:
    """Models and sweeps of the discretisation that the command line asks for."""

    def __init__(self, *, across=None, options=()):
        self.across, self.options = across, dict(options)

    def model(self, plate, **cloud):
        return jaxgel.discretise(
            jaxgel.make_cloud(plate, across=self.across, **cloud), **self.options
        )

    @functools.cache  # noqa: B019
    def curve(self, name, spacing=None):
        """Path of a sample at the mu of its references, and the seconds of model and sweep."""
        begin, plate = time.perf_counter(), jaxgel.sample(name)
        path = jaxgel.sweep(
            jaxgel.Problem(self.model(plate, spacing=spacing), plate.gel, contact=False),
            REFERENCES[name]["mu"],
        )
        return path, time.perf_counter() - begin


def curve_errors(path, name, quantity):
    """Signed errors (k,) in % of a quantity at the mu of the references, nan after the end."""
    exact = np.array(REFERENCES[name][quantity])
    found = np.full(len(exact), np.nan)
    found[: len(path)] = OBSERVED[quantity](path)
    return 100 * (found / exact - 1)


def worst(errors, counted=slice(None)):
    """Largest amount of the errors that count; nan if one is missing."""
    return float(np.abs(np.asarray(errors)[counted]).max())


def spread_of(name, quantity, counted=slice(None)):
    """Largest spread of the finite elements in % at the mu that count."""
    table = REFERENCES[name]
    return worst(100 * np.array(table["spread"][quantity]) / np.array(table[quantity]), counted)


def heading(text):
    print(f"\n{text}")


def line(label, cells, ends=()):
    print(
        f"{label:>10}"
        + "".join(
            f"{cell:>9}" if isinstance(cell, str) else f"{cell:9.3f}" for cell in (*cells, *ends)
        ),
        flush=True,
    )


def verdict(value, target):
    return "-" if target is None else "yes" if value <= target else "NO"


def row_curve(quantity, runs, options):
    """Errors of sample 1 along the stable branch on clouds of several sizes."""
    mus, last = REFERENCES["sample-1"]["mu"], LAST[quantity]
    counted = np.array(mus) <= last
    spread = f"{spread_of('sample-1', quantity, counted):.1e} %"
    heading(
        f"{quantity} of sample 1: error in %, worst to mu = {last}; spread of the finite elements "
        f"up to {spread}"
    )
    line("nodes", [f"{mu:.4f}" for mu in mus], ("worst", "target", "met", "seconds"))
    found = []
    for size in options.nodes:
        path, seconds = runs.curve("sample-1", SPACINGS[size])
        errors = curve_errors(path, "sample-1", quantity)
        largest, target = worst(errors, counted), TARGETS.get(quantity, {}).get(size)
        line(
            path.model.n_nodes,
            errors,
            (largest, "" if target is None else target, verdict(largest, target), f"{seconds:.1f}"),
        )
        found.append(
            {
                "nodes": path.model.n_nodes,
                "mu": mus,
                "errors": errors.tolist(),
                "worst": largest,
                "target": target,
            }
        )
    return found


@functools.cache
def finite_element_displacement():
    """Function of dry points (m, 2): their displacements (m, 2), mm, by refined finite elements.

    They are those of sample 1 at ``AT``.
    """
    from references import MESHES, solved

    gel = solved(MESHES[0], AT)
    return lambda dry: gel.u(gel.points(*np.asarray(dry).T))


def nodal_errors(path):
    """Distances (n,) of the deformed nodes at ``AT`` from the finite elements, mm; nan if none.

    nan if the sweep ended before.
    """
    dry = np.asarray(path.model.cloud.nodes)
    at = np.flatnonzero(np.abs(path.mu - AT) < 1e-9)
    if not len(at):
        return np.full(len(dry), np.nan)
    return np.linalg.norm(
        np.asarray(path.x[at[0]]) - dry - finite_element_displacement()(dry), axis=1
    )


def row_nodal(runs, options):
    """Nodal displacements of sample 1 at ``AT``: rms, largest, observed order between clouds."""
    heading(
        f"nodal displacement of sample 1 at mu = {AT}: error in mm; order: of the rms in the node "
        "distance, from the cloud before"
    )
    print(
        f"{'nodes':>10}{'rms':>10}{'largest':>10}{'outlines':>10}{'target':>10}{'met':>6}"
        f"{'order':>8}   (outlines: rms on them)"
    )
    found = []
    for size in options.nodes:
        path, _ = runs.curve("sample-1", SPACINGS[size])
        error, on_outlines = nodal_errors(path), outline_nodes(path.model)
        rms, target = rms_of(error), TARGETS["nodal"].get(size)
        row = {
            "nodes": len(error),
            "rms": rms,
            "largest": float(error.max()),
            "outlines": rms_of(error[on_outlines]),
            "target": target,
        }
        if found:
            row["order"] = (
                2 * math.log(found[-1]["rms"] / rms) / math.log(len(error) / found[-1]["nodes"])
            )
        found.append(row)
        print(
            f"{row['nodes']:10}{rms:10.5f}{row['largest']:10.5f}{row['outlines']:10.5f}"
            f"{target:10.4f}{verdict(rms, target):>6}{row.get('order', math.nan):8.2f}",
            flush=True,
        )
    return found


def rms_of(error):
    return float(np.sqrt(np.mean(error**2)))


def outline_nodes(model):
    """Whether (n,) a node of sample 1 lies on the outline of a hole."""
    dry, on = np.asarray(model.cloud.nodes), np.zeros(model.n_nodes, bool)
    for hole in model.cloud.plate.holes:
        c, s = np.cos(float(hole.angle)), np.sin(float(hole.angle))
        arm = (
            (dry - np.asarray(hole.centre))
            @ np.array([[c, -s], [s, c]])
            / np.asarray(hole.semi_axes)
        )
        on |= np.abs(np.linalg.norm(arm, axis=1) - 1) < 1e-6
    return on


def row_outline(runs, options):
    """Nodal displacements of sample 1 with few and many nodes on the outlines."""
    heading(
        f"outline nodes per hole on the default grid, sample 1 at mu = {AT}: error of the nodal "
        "displacement in mm, rotations in %"
    )
    print(
        f"{'per hole':>10}{'nodes':>8}{'rms':>10}{'largest':>10}{'target':>10}{'met':>6}"
        f"{'core':>9}{'midline':>9}"
    )
    plate, found = jaxgel.sample("sample-1"), []
    mus = [mu for mu in REFERENCES["sample-1"]["mu"] if mu <= AT]
    for number in options.outline_nodes:
        path = jaxgel.sweep(
            jaxgel.Problem(runs.model(plate, nodes_per_hole=number), plate.gel, contact=False), mus
        )
        error, target = nodal_errors(path), TARGETS["outline"].get(number)
        core, midline = (
            curve_errors(path, "sample-1", name)[len(mus) - 1] for name in ("core", "midline")
        )
        row = {
            "per_hole": number,
            "nodes": len(error),
            "rms": rms_of(error),
            "largest": float(error.max()),
            "target": target,
        }
        found.append(row | {"core": float(core), "midline": float(midline)})
        print(
            f"{number:10}{row['nodes']:8}{row['rms']:10.5f}{row['largest']:10.5f}"
            f"{target or math.nan:10.3f}{verdict(row['largest'], target):>6}"
            f"{core:9.3f}{midline:9.3f}",
            flush=True,
        )
    return found


def row_samples(runs, _):
    """Errors of samples 2 and 3 along the stable branch on the paper's clouds."""
    found = []
    for name in ("sample-2", "sample-3"):
        mus = REFERENCES[name]["mu"]
        path, seconds = runs.curve(name)
        heading(f"{name}, {path.model.n_nodes} nodes: error in %, {seconds:.1f} s")
        line("", [f"{mu:.4f}" for mu in mus], ("worst", "spread", "target", "met"))
        for quantity, target in TARGETS["samples"].items():
            errors = curve_errors(path, name, quantity)
            line(
                quantity,
                errors,
                (worst(errors), spread_of(name, quantity), target, verdict(worst(errors), target)),
            )
            found.append(
                {
                    "case": name,
                    "quantity": quantity,
                    "mu": mus,
                    "errors": errors.tolist(),
                    "target": target,
                }
            )
    return found


def row_onset(runs, options):
    """First critical mu of the symmetric branch."""
    heading("onset: error of the critical mu in %")
    print(
        f"{'case':>10}{'nodes':>8}{'critical mu':>13}{'elements':>10}{'error':>9}{'spread':>9}"
        f"{'target':>9}{'met':>5}{'seconds':>9}"
    )
    found = []
    for name in options.cases:
        plate, exact = jaxgel.sample(name), FINITE_ELEMENTS[name]["critical_mu"]
        for spacing, target in ONSETS[name].items():
            begin = time.perf_counter()
            model = runs.model(plate, spacing=spacing)
            points = jaxgel.critical_points(
                jaxgel.Problem(model, plate.gel), (START, min(exact + 0.5, -0.9)), most=1
            )
            mu = float(points[0].mu) if points else math.nan
            error, spread = (
                100 * (mu / exact - 1),
                -100 * FINITE_ELEMENTS[name]["spread"]["critical_mu"] / exact,
            )
            found.append(
                {"case": name, "nodes": model.n_nodes, "mu": mu, "error": error, "target": target}
            )
            print(
                f"{name:>10}{model.n_nodes:8}{mu:13.4f}{exact:10.4f}{error:9.3f}{spread:9.3f}"
                f"{target:9.2f}{verdict(abs(error), target):>5}"
                f"{time.perf_counter() - begin:9.1f}",
                flush=True,
            )
    return found


def row_sensitivities(runs, options):
    """Derivatives of both rotations of sample 1 at ``AT`` with respect to geometry and gel."""
    table, plate, found = REFERENCES["sensitivities"], jaxgel.sample("sample-1"), []
    names = list(table["core"]["spread"])
    start = jnp.array(
        [5.0, 4.0, 0.0, *map(float, plate.holes[0].centre), plate.gel.Nv, plate.gel.chi]
    )

    def rotations(p, spacing):
        """Amounts (2,) of core and midline rotation, degrees, in the order of the references."""
        theta = [
            {
                "semi_axes": p[:2],
                "angle": float(hole.angle) + p[2],
                "centre": p[3:5] if k == 0 else jnp.asarray(hole.centre),
            }
            for k, hole in enumerate(plate.holes)
        ]
        model = runs.model(plate.at(theta), spacing=spacing)
        mus = jnp.array([mu for mu in REFERENCES["sample-1"]["mu"] if mu <= AT])
        path = jaxgel.sweep(
            jaxgel.Problem(model, jaxgel.Gel(Nv=p[5], chi=p[6]), contact=False), mus
        )
        return jnp.abs(jnp.stack([jaxgel.core_rotation(path)[-1], jaxgel.rotation_angle(path)[-1]]))

    heading(f"sensitivities of sample 1 at mu = {AT} by squares along a side: error in %")
    print(
        f"{'':>10}"
        + "".join(f"{name:>16}" for name in names)
        + f"{'worst':>9}{'target':>9}{'met':>6}"
    )
    for quantity in TARGETS["sensitivities"]:
        spread = [
            100 * table[quantity]["spread"][name] / abs(table[quantity][name]) for name in names
        ]
        print(
            f"{quantity:>10}"
            + "".join(f"{value:16.2f}" for value in spread)
            + "  spread of the finite elements"
        )
    for squares in options.squares:
        _, pull = jax.vjp(functools.partial(rotations, spacing=plate.width / squares), start)
        for k, (quantity, target) in enumerate(TARGETS["sensitivities"].items()):
            errors = 100 * (
                np.asarray(pull(jnp.eye(2)[k])[0])
                / np.array([table[quantity][name] for name in names])
                - 1
            )
            print(
                f"{quantity:>8}{squares:>3}" + "".join(f"{error:16.2f}" for error in errors)
                + f"{worst(errors):9.2f}{target:9.1f}{verdict(worst(errors), target):>6}",
                flush=True,
            )  # fmt: skip
            found.append(
                {
                    "squares": squares,
                    "quantity": quantity,
                    "errors": dict(zip(names, errors.tolist(), strict=True)),
                    "target": target,
                }
            )
    return found


def row_plate(runs, _):
    """Spurious unstable modes of a uniformly stretched or compressed plate without holes."""
    heading(
        "plate of 4 x 2 mm without holes, all edges held, mu = -2: negative eigenvalues at a "
        "pressure of so many Nv (target: none)"
    )
    print(f"{'p / Nv':>10}{'J':>9}{'spacing':>9}{'negative':>10}{'met':>6}")
    gel, mu, found = jaxgel.Gel(Nv=1e-3, chi=1e-4), -2.0, []
    for p in PRESSURES:
        J = uniform_volume_ratio(p * gel.Nv, mu, gel)
        stretch = math.sqrt(J)
        for spacing in (0.25, 0.125):
            plate = jaxgel.Plate(
                4,
                2,
                edges="fixed",
                deformation=((stretch, 0), (0, stretch)),
                spacing=spacing,
                gel=gel,
            )
            try:
                path = jaxgel.sweep(
                    jaxgel.Problem(runs.model(plate), gel, contact=False), [mu], branch="symmetric"
                )
                negative = int(path.negative_pivots[-1])
            except Exception as error:  # a table of failures is wanted, too
                negative, text = -1, str(error).splitlines()[0]
                print(text)
            found.append({"p": p, "spacing": spacing, "negative": negative})
            print(
                f"{p:10}{J:9.4f}{spacing:9.3f}{negative:10}{'yes' if negative == 0 else 'NO':>6}",
                flush=True,
            )
    return found


def uniform_volume_ratio(p, mu, gel):
    """J > 1 at which the mixing energy's derivative is the pressure ``p``, kT/v; by bisection.

    The network's own part is left out.
    """
    low, high = 1 + 1e-12, 1e3
    for _ in range(200):
        J = (low + high) / 2
        value = math.log(1 - 1 / J) + 1 / J + gel.chi / J**2 - gel.Nv / J - mu
        low, high = (J, high) if value < p else (low, J)
    return (low + high) / 2


def row_searches(*_):
    """Optima of the rotation study from its start and from one 1e-6 of its bounds away.

    Each is also tried on a fresh cloud.
    """
    heading(
        "searches of design/rotation.toml: midline at the last mu, degrees, on the cloud of the "
        "search and on a fresh finer one"
    )
    line("start +", ("search", "fresh"))
    moved = (0.0, 1e-6)
    found = {by: searched(by) for by in moved}
    for by, values in found.items():
        line(f"{by:g}", [f"{value:.2f}" for value in values])
    return found


def searched(moved):
    """Best midline rotation, degrees, of the study started at ``moved``, and on a fresh cloud."""
    study = load_study(Path(__file__).parents[1] / "design" / "rotation.toml")
    problem = dataclasses.replace(
        study.problem, start=study.problem.parameters(study.problem.vector + moved)
    )
    design = dataclasses.replace(study, problem=problem).run()
    return design.value, study.verify(design.parameters)[0]["last"]["rotation"]


def row_time(runs, options):
    """A sweep of sample 1 in 30 states: seconds."""
    plate, mu = jaxgel.sample("sample-1"), np.linspace(-4.9678, -0.9178, 30)
    heading("30 states of sample 1: seconds, median of 7")
    line("nodes", ("seconds",))
    found = {}
    for nodes in options.nodes:
        model = runs.model(plate, spacing=SPACINGS[nodes])
        # the first one compiles
        taken = [seconds_of(jaxgel.sweep, jaxgel.Problem(model, plate.gel), mu) for _ in range(8)][
            1:
        ]
        found[nodes] = np.median(taken)
        line(model.n_nodes, [f"{found[nodes]:.2f}"])
    return found


def seconds_of(function, *args, **keywords):
    """Seconds that a call takes."""
    begin = time.perf_counter()
    function(*args, **keywords)
    return time.perf_counter() - begin


ROWS = {
    "core": functools.partial(row_curve, "core"),
    "midline": functools.partial(row_curve, "midline"),
    "energy": functools.partial(row_curve, "energy"),
    "nodal": row_nodal,
    "samples": row_samples,
    "onset": row_onset,
    "sensitivities": row_sensitivities,
    "outline": row_outline,
    "plate": row_plate,
    "searches": row_searches,
    "time": row_time,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--rows",
        nargs="+",
        choices=ROWS,
        default=list(ROWS),
        metavar="ROW",
        help=f"of {', '.join(ROWS)} (all)",
    )
    parser.add_argument(
        "--nodes",
        type=int,
        nargs="+",
        choices=SPACINGS,
        default=list(SPACINGS),
        help="clouds of sample 1 (all)",
    )
    parser.add_argument(
        "--squares",
        type=int,
        nargs="+",
        default=[56],
        help="along a side, for the clouds of the sensitivities (56)",
    )
    parser.add_argument(
        "--outline-nodes",
        type=int,
        nargs="+",
        default=list(OUTLINE_NODES),
        help="per hole, for the row outline",
    )
    parser.add_argument(
        "--cases",
        nargs="+",
        choices=ONSETS,
        default=list(ONSETS),
        metavar="CASE",
        help="of the onsets (all)",
    )
    parser.add_argument("--across", type=int, help="of jaxgel.make_cloud (its default)")
    parser.add_argument(
        "--option",
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        help="further options of jaxgel.discretise",
    )
    parser.add_argument("--out", type=Path, help="file for the numbers")
    options = parser.parse_args()
    runs = Runs(across=options.across, options=[parsed(text) for text in options.option])
    print(
        f"jaxgel at {Path(jaxgel.__file__).parent}, across {runs.across}, "
        f"{runs.options or 'default options'}"
    )
    found = {row: ROWS[row](runs, options) for row in options.rows}
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def parsed(text):
    """(name, value) of NAME=VALUE; the value as a Python literal if it is one."""
    name, _, value = text.partition("=")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return name, value


if __name__ == "__main__":
    main()
