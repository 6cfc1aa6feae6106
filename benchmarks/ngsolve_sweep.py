"""Sample 1 swollen in 30 steps of mu by NGSolve: the peer of jaxgel in ``sweep.py``.

Run as a script it computes the refined curve in reference_core_rotation.json again.
"""

import contextlib
import dataclasses
import json
import statistics
import time
from pathlib import Path

import ngsolve as ng
import numpy as np
from ngsolve_gel import MixedGel, plate_mesh

from jaxgel import sample

MU = np.linspace(-4.9678, -0.9178, 30)
REFERENCE = Path(__file__).with_name("reference_core_rotation.json")


@dataclasses.dataclass(frozen=True)
class Row:
    """A mesh and a way to iterate on it."""

    order: int
    """Order k of displacement and geometry; the pressure has order k-1."""
    plate: float
    """Longest edge in the plate, mm."""
    hole: float
    """Longest edge on the holes, mm."""
    grading: float = 0.3
    """Growth of the edges away from short ones."""
    keep: bool = True
    """Whether a factorisation serves several corrections.

    False: Newton with a new tangent each time.
    """

    def gel(self):
        """The dry gel on this mesh."""
        plate = sample("sample-1")
        return MixedGel(
            plate, plate_mesh(plate, self.order, self.plate, self.hole, self.grading), self.order
        )


# From 10 % to 0.25 % in the core rotation, each about the cheapest of its order. The last two are
# cubic at 6,800 degrees of freedom.
ROWS = (
    Row(3, 4, 3, grading=0.8),
    Row(3, 6, 4),
    Row(3, 4, 3),
    Row(2, 1.5, 0.7),
    Row(3, 2, 1.5),
    Row(3, 2, 0.9),
    Row(4, 6, 4),
    Row(4, 4, 2.5),
    Row(4, 2, 1.5),
    Row(5, 5, 3),
    Row(3, 1.9, 0.58),
    Row(3, 1.9, 0.58, keep=False),
)


def sweep(gel, keep=True, observe=MixedGel.core_rotation):
    """Equilibria at MU from the dry plate, by quadratic extrapolation, with counts.

    (observed, factorisations, corrections).
    """
    history, observed, counts = [], [], []
    state = gel.state.vec.FV().NumPy()
    state[:] = 0
    for mu in MU:
        if len(history) > 1:
            weights = ((3, -3, 1), (2, -1))[len(history) == 2]
            state[:] = sum(w * before for w, before in zip(weights, reversed(history), strict=True))
        counts.append(gel.equilibrium(mu, keep))
        history = [*history[-2:], state.copy()]
        observed.append(observe(gel))
    return observed, *(int(n) for n in np.sum(counts, axis=0))


def measure(row, runs, threads):
    """Median of ``runs`` sweeps on one mesh after a first one, as a dict.

    Meshing and forms are timed apart.
    """
    ng.SetNumThreads(threads)
    with ng.TaskManager() if threads > 1 else contextlib.nullcontext():
        begin = time.perf_counter()
        gel, wall, cpu = row.gel(), [], []
        setup = time.perf_counter() - begin
        for _ in range(runs + 1):
            begin = time.perf_counter(), time.process_time()
            core, factorisations, corrections = sweep(gel, row.keep)
            wall.append(time.perf_counter() - begin[0])
            cpu.append(time.process_time() - begin[1])
    return {
        "solver": f"NGSolve P{row.order}" + ("" if row.keep else " Newton"),
        "version": ng.__version__,
        "mesh": dataclasses.asdict(row) | {"elements": gel.mesh.ne},
        "free_dofs": gel.free_dofs,
        "newton": corrections,
        "factorisations": factorisations,
        "setup_s": setup,
        "compile_s": wall[0] - statistics.median(wall[1:]),
        "wall_s": statistics.median(wall[1:]),
        "wall_all_s": wall,
        "cpu_s": statistics.median(cpu[1:]),
        "energy": gel.energy(),
        "core_rotation": core,
    }


def write_reference():
    """The refined curve to reference_core_rotation.json: quartic elements.

    Quintic ones on another mesh give the spread.
    """
    curves, sizes = [], []
    for row in (Row(4, 1.2, 0.25), Row(5, 1.5, 0.3)):
        gel = row.gel()
        observed = sweep(
            gel, observe=lambda gel: (gel.core_rotation(), gel.midline_rotation(), gel.energy())
        )[0]
        curves.append(np.array(observed).T)
        sizes.append(
            f"P{row.order}, {gel.mesh.ne} curved triangles, {gel.free_dofs} free displacements"
        )
    names = ("core_rotation", "midline_rotation", "energy")
    spread = np.abs(curves[0] / curves[1] - 1).max(axis=1)
    content = {
        "about": (
            f"Sample 1 by NGSolve {ng.__version__}, {sizes[0]}; spread: largest relative "
            f"difference to {sizes[1]}"
        ),
        "units": (
            "mu kT, rotations degrees (midline: line joining the highest and lowest point of y = "
            "0), energy kT/v mm^2"
        ),
        "spread": dict(zip(names, spread.tolist(), strict=True)),
        "mu": MU.round(9).tolist(),
        **dict(zip(names, curves[0].round(6).tolist(), strict=True)),
    }
    REFERENCE.write_text(json.dumps(content, indent=1) + "\n")
    print(REFERENCE.name, content["about"], content["spread"], sep="\n")


if __name__ == "__main__":
    write_reference()
