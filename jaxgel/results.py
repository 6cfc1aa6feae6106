"""A run's folder: what its table says of a sweep, and how table, states and summary are read back; `recorder` writes them."""

import csv
import dataclasses
import json
from pathlib import Path as File

import numpy as np

from . import cases
from .constraints import free_dofs
from .contact import with_contact
from .energy import all_volumes
from .equilibrium import Status
from .files import MAX_BYTES, guarded, read_arrays
from .observables import (
    area_reduction,
    cell_volumes,
    core_rotation,
    free_stretch,
    min_gap,
    rotation_angle,
    surface_ratio,
    volume_ratio,
)
from .path import Path, Step

COLUMNS = (
    "mu",
    "free_stretch",
    "status",
    "newton_iterations",
    "residual",
    "energy",
    "J_min",
    "J_max",
    "J_mean",
    "area_reduction",
    "rotation_deg",
    "core_rotation_deg",
    "negative_pivots",
    "lowest_eigenvalue",
    "min_gap",
    "surface_ratio",
)
INTEGER_COLUMNS = ("newton_iterations", "negative_pivots")
CREASE_RATIO = 2.4  # ratio of the in-plane principal stretches at which a plane-strain surface creases, stretch 0.647 (Hong et al. 2009)
WRINKLE_RATIO = 3.4  # the same for wrinkles, stretch 0.544 (Biot 1963)
SELF_CONTACT = "invalid: self-contact"
IN_CONTACT = "a hole's sides touch"
SWITCHED = "switched to the stable branch"
FORMAT = 2  # raised when the meaning of a file changes


def history(path):
    """The columns of ``history.csv`` for every state of a path: a dictionary from each name in ``COLUMNS`` to (k,) values.

    Energy in kT/v mm^2, angles in degrees, gap in mm; J is the volume ratio of a cell and its mean is weighted with the dry
    volume. ``status`` is a list of texts: with contact, whether a hole's sides are within its range; without, ``"invalid: self-contact"``
    from the first state on in which a hole's boundary crosses itself.
    """
    J = np.asarray(volume_ratio(path))
    volumes = np.asarray(cell_volumes(path.model))
    gap = np.asarray(min_gap(path))
    values = {
        "mu": path.mu,
        "free_stretch": free_stretch(path),
        "status": _status_texts(path, gap),
        "newton_iterations": path.newton_iterations,
        "residual": path.residual,
        "energy": path.energy,
        "J_min": J.min(axis=1),
        "J_max": J.max(axis=1),
        "J_mean": J @ volumes / volumes.sum(),
        "area_reduction": area_reduction(path),
        "rotation_deg": rotation_angle(path),
        "core_rotation_deg": core_rotation(path),
        "negative_pivots": path.negative_pivots,
        "lowest_eigenvalue": path.lowest_eigenvalue,
        "min_gap": gap,
        "surface_ratio": surface_ratio(path),
    }
    return {name: values[name] if name == "status" else np.asarray(values[name]) for name in COLUMNS}


def events(table):
    """What happens along a path with the columns ``table`` of `history`, as a list of dictionaries in the order of mu.

    Each holds ``event`` ("bifurcation", "crease", "wrinkle", "contact" or "self-contact"), ``mu`` of the first state that shows it,
    ``mu_before`` of the state before (None where it is the first), and ``text``. A bifurcation, or fold, is a change of the negative
    pivots, or where the path left an unstable branch.
    """
    mu, pivots = np.asarray(table["mu"]), np.asarray(table["negative_pivots"])
    found = []

    def add(k, event, text):
        before = float(mu[k - 1]) if k else None
        where = f"between mu = {before:.4f} and {mu[k]:.4f}" if k else f"at or before mu = {mu[k]:.4f}"
        found.append({"event": event, "mu": float(mu[k]), "mu_before": before, "text": f"{text} {where}"})

    for k in [k for k, text in enumerate(table.get("status", ())) if SWITCHED in text]:
        add(k, "bifurcation", "the branch became unstable and the path went over to the stable one")
    for k in range(1, len(mu)):
        if pivots[k] != pivots[k - 1]:
            add(k, "bifurcation", f"negative pivots of the tangent go from {pivots[k - 1]} to {pivots[k]}")
    for name, ratio in (("crease", CREASE_RATIO), ("wrinkle", WRINKLE_RATIO)):
        for k in np.flatnonzero(np.asarray(table["surface_ratio"]) > ratio)[:1]:
            add(k, name, f"a hole's surface is compressed past the {name} limit (stretch ratio {ratio})")
    for k in [k for k, text in enumerate(table.get("status", ())) if IN_CONTACT in text][:1]:
        add(k, "contact", "a hole's sides first touch")
    for k in np.flatnonzero(np.asarray(table["min_gap"]) <= 0)[:1]:
        add(k, "self-contact", "a hole's boundary touches itself")
    return sorted(found, key=lambda e: e["mu"])


STEP_ARRAYS = (
    "mu",
    "x",
    "pressure",
    "newton_iterations",
    "residual",
    "energy",
    "negative_pivots",
    "lowest_eigenvalue",
    "switched",
    "stride",
)
OF_LAST = ("modes", "rate")  # kept of the last step only


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """A run's folder as read from disk; k states of n nodes."""

    folder: File
    """Where it lies."""
    summary: dict
    """Content of ``summary.json``."""
    history: dict
    """Columns of ``history.csv``: name -> (k,) array, status a list of texts."""
    states: dict
    """Arrays of ``states.npz``: mu (k,), x (k, n, 2) mm, pressure (k, g) kT/v, nodes (n, 2) mm, outline_0 ... (k, m, 2) mm, and the rest
    of each `path.Step`; modes (f, m) and rate (n, 2) those of the last, where it has them."""

    @property
    def mu(self):
        """(k,) chemical potential in kT."""
        return self.states["mu"]

    @property
    def x(self):
        """(k, n, 2) deformed node positions in mm."""
        return self.states["x"]

    @property
    def outlines(self):
        """(k, m, 2) deformed outline of each hole, in mm, a list of closed loops as in `observables.outlines`."""
        return [self.states[f"outline_{i}"] for i in range(len(self.states)) if f"outline_{i}" in self.states]


def load_run(folder, *, max_bytes=MAX_BYTES):
    """The `Run` in a folder written by `recorder.Recorder`, finished or not; nothing in it is executed or unpickled.

    Raises ValueError for a folder without a run, a damaged or foreign file, and one with more than ``max_bytes`` in a file.
    """
    folder = File(folder)
    summary = read_summary(folder, max_bytes)
    table = guarded(folder / "history.csv", _read_history, max_bytes)
    states = folder / "states.npz"
    states = guarded(states, _read_states, max_bytes) if table["mu"].size and states.is_file() else None
    if states is None:
        raise ValueError(f"folder: {str(folder)!r} holds no accepted state; its run ended as {summary['status']!r}: {summary['reason']}")
    k = min(len(states["mu"]), len(table["mu"]))  # a run killed between two files leaves one row more in history.csv
    if k < len(states["mu"]):
        states = {name: a for name, a in states.items() if name not in OF_LAST}  # of a state whose row was cut off with the machine
    if not np.array_equal(states["mu"][:k], table["mu"][:k]):
        raise ValueError(f"folder: history.csv and states.npz in {str(folder)!r} are of different runs: their mu differ")
    states = {name: a if name in ("nodes", *OF_LAST) else a[:k] for name, a in states.items()}
    return Run(folder, summary, {name: column[:k] for name, column in table.items()}, states)


def read_summary(folder, max_bytes=MAX_BYTES):
    """Content of the ``summary.json`` of a run's folder, a dict; ValueError as for `load_run`."""
    if not (File(folder) / "summary.json").is_file():
        raise ValueError(f"folder: {str(folder)!r} holds no summary.json; expected a folder written by jaxgel run")
    return guarded(File(folder) / "summary.json", _read_summary, max_bytes)


def load_path(folder):
    """The `path.Path` of a run's folder, to the bit, on the model built again from the options in its ``summary.json``.

    Raises ValueError as `load_run`, and when the model differs from the stored one (written by another version).
    """
    run = load_run(folder)
    case, model, steps = rebuilt(run)
    return Path.from_steps(model, case.gel, steps, stop=Status[run.summary["stop"]], stop_text=run.summary["reason"])


def rebuilt(run):
    """The `cases.Case` of a `Run`, its model with contact, and the accepted `Step`s; ValueError where they do not fit together."""
    case = cases.from_table(run.summary["options"], run.summary["case"])
    model, states = of_case(case.model(), case), run.states
    nodes, modes = np.asarray(model.cloud.nodes), states.get("modes")
    fits = nodes.shape == states["nodes"].shape and np.abs(nodes - states["nodes"]).max() <= 1e-9
    fits = fits and states["pressure"].shape[1] == len(all_volumes(model)) and len(states["x"][0]) == len(nodes)
    if not (fits and (modes is None or len(modes) == len(free_dofs(model.lists.topology)))):
        raise ValueError(f"folder: the nodes in {str(run.folder)!r} are not those of this version of jaxgel; run the case again")
    steps = [_step(states, i) for i in range(len(run.mu))]
    return case, model, [*steps[:-1], dataclasses.replace(steps[-1], modes=modes, rate=states.get("rate"))]


def of_case(model, case):
    """The model with the contact that the sweep of the case gives it."""
    return with_contact(model, case.gel) if case.sweep.contact == "on" else model


def _step(states, i):
    """The accepted step ``i`` of the arrays of ``states.npz``."""
    values = {name: states[name][i] if states[name].ndim > 1 else states[name][i].item() for name in STEP_ARRAYS}
    apart = int(states["apart"][i])
    return Step(**values, status=Status[str(states["status"][i])], apart=None if apart < 0 else bool(apart))


def _status_texts(path, gap):
    """Status texts (k,) of a path, with the first self-contact and all that follows it invalid."""
    switched = getattr(path, "switched", np.zeros(len(path.mu), dtype=bool))
    crossed = np.logical_or.accumulate(np.asarray(gap) <= 0)
    touching = gap < (0.0 if path.model.contact is None else float(path.model.contact.range))
    texts = []
    for status, *facts in zip(path.status, switched, touching, strict=True):
        said = [text for text, holds in zip((SWITCHED, IN_CONTACT), facts, strict=True) if holds]
        texts.append(", ".join(said) or status.name.lower().replace("_", " "))
    return [SELF_CONTACT if c else text for text, c in zip(texts, crossed, strict=True)]


def _read_summary(content, _):
    summary = json.loads(content)
    if summary["format"] != FORMAT:
        raise ValueError(f"format {summary['format']}, this version reads {FORMAT}")
    wanted = {
        "case": str,
        "options": dict,
        "status": str,
        "reason": str,
        "stop": str,
        "wall_seconds": float,
        "versions": dict,
        "events": list,
    }
    for key, kind in wanted.items():
        if not isinstance(summary[key], kind):
            raise ValueError(f"{key} is not of type {kind.__name__}")
    if summary["stop"] not in Status.__members__:
        raise ValueError(f"stop {summary['stop']!r} is no status")
    return summary


def _read_history(content, _):
    lines = content.decode().splitlines(keepends=True)
    complete = [line for line in lines if line.endswith("\n")]  # the last row may have been cut off with the machine
    header, *rows = csv.reader(complete)
    if tuple(header) != COLUMNS or any(len(row) != len(COLUMNS) for row in rows):
        raise ValueError(f"columns are not {', '.join(COLUMNS)}")
    columns = {name: [row[i] for row in rows] for i, name in enumerate(COLUMNS)}
    kinds = {name: int if name in INTEGER_COLUMNS else float for name in COLUMNS}
    return {name: c if name == "status" else np.array(c, dtype=float).astype(kinds[name]) for name, c in columns.items()}


def _read_states(content, max_bytes):
    arrays = read_arrays(content, max_bytes)
    (k, n, _), groups = arrays["x"].shape, arrays["pressure"].shape[1]
    shapes = dict.fromkeys((*STEP_ARRAYS, "status", "apart"), (k,)) | {"x": (k, n, 2), "pressure": (k, groups), "nodes": (n, 2)}
    shapes |= {name: (k, a.shape[1], 2) for name, a in arrays.items() if name.startswith("outline_")}
    if "modes" in arrays:
        shapes["modes"] = (len(arrays["modes"]), arrays["modes"].shape[1])
    if "rate" in arrays:
        shapes["rate"] = (n, 2)
    for name, shape in shapes.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind not in "bfiU":
            raise ValueError(f"{name} has shape {arrays[name].shape}, expected {shape}")
    for name in {"mu", "x", "pressure", *OF_LAST} & arrays.keys():
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} is not finite")
    if not np.all(np.diff(arrays["mu"]) > 0) or not set(arrays["status"]) <= Status.__members__.keys():
        raise ValueError("mu does not increase, or a status is unknown")
    return arrays
