"""A bistable plate: four round holes whose pattern turns left or right at mu = -1.2 kT.

The barrier between the two is prescribed. Problem: radius of the holes and Nv of the gel, so that
the barrier from either pattern over the straight one is 6e-4 kT/v mm^2, with ligaments of at least
1.1 mm and outlines that do not crease. Each pattern is entered under a torque on the middle and
kept when that is taken away; both are certified stable there, and the saddle has one negative
eigenvalue. The result is checked on fresh, ever finer clouds, which give it error bars.

    python design/bistable.py  # writes out/bistable: design.json, verified.json, design.png
"""

import dataclasses
import functools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel
from jaxgel.continuation import SweepOptions
from jaxgel.design import DesignProblem, bound, optimise, verify
from jaxgel.discretisation import DiscretisationOptions
from jaxgel.mechanics import Loads, load_vector

MU = -1.2  # kT
WANTED = 6e-4  # kT/v mm^2
DISTANCE = 5.0  # of the centres from the midlines, mm
SPACING, FINER = 0.45, 0.3  # of the cloud of the search and of the finest of the verification, mm
SCALE = 0.01  # of the objective: a barrier that is a tenth off
# greatest body force over the distance from the middle, kT/v mm^2, and how far it reaches, mm
TORQUE, REACH = 1e-4, 3.0


class Torque(Loads):
    """Loads that turn the middle of a plate: body forces, so that they converge with the cloud."""

    def of(self, model):
        """Nodal loads (n, 2)."""
        return load_vector(model, body_force=_around)


def _around(x):
    return TORQUE * jnp.exp(-(x @ x) / REACH**2) * jnp.array([-x[1], x[0]])


def plate(parameters):
    """The plate of a dict of parameters."""
    centres = [(x, y) for x in (DISTANCE, -DISTANCE) for y in (DISTANCE, -DISTANCE)]
    return jaxgel.Plate(
        22.0,
        22.0,
        [jaxgel.Circle(centre, parameters["radius"]) for centre in centres],
        name="bistable",
    )


def gel(parameters):
    """The gel of a dict of parameters."""
    return jaxgel.Gel(parameters["Nv"], 1e-4)


def patterns(path):
    """The `State`s to either side without a torque: the end of a ``path``, and its mirror."""
    model, gel, control, x, pressure = jax.lax.stop_gradient(
        (path.model, path.gel, path.control, path.x[-1], path.pressure[-1])
    )
    other = jaxgel.sweep(jaxgel.Problem(model, gel, control=control, contact=False), [-1.0, 0.0])
    return dataclasses.replace(other[-1], x=x, pressure=pressure), other[-1]


@functools.lru_cache(maxsize=1)  # for objective and report of one design
def barriers(path):
    """Both `Barrier`s between the `patterns`.

    Their states may be constants, as a barrier is stationary in them.
    """
    return jaxgel.barrier(path.problem, 0.0, patterns(path))


def height(path):
    """Height () of the first barrier, kT/v mm^2."""
    return barriers(path)[0].height


problem = DesignProblem(
    start={"radius": 4.4, "Nv": 1e-3},
    bounds={"radius": (4.1, 4.45), "Nv": (8e-4, 2e-3)},
    plate=plate,
    gel=gel,
    mu=[1.0, 0.0],  # of the torque
    objective=lambda path: (height(path) / WANTED - 1.0) ** 2,
    constraints=(bound("ligament", above=1.1), bound("crease_indicator", below=2.0)),
    options=DiscretisationOptions(spacing=SPACING),
    sweep=SweepOptions(control="load", value_list=(1.0, 0.0), at_mu=MU, contact="off"),
    loads=Torque(),
    reported={"barrier": height},
)


def draw(design, path, file):
    """Both patterns, the straight state between them, and the barrier over the evaluations."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from jaxgel.plotting import STYLE, plot_pattern

    first, second = barriers(path)
    states = {"turned left": first.state, "saddle": first.saddle, "turned right": second.state}
    with mpl.rc_context(STYLE):
        figure, axes = plt.subplots(1, 4, figsize=(10.6, 2.7), layout="constrained")
        for ax, (name, state) in zip(axes, states.items(), strict=False):
            shown = jaxgel.Path.from_states(path.problem, [state])
            plot_pattern(shown, ax=ax, field=None)
            ax.set_title(f"{name}, {state.negative_pivots} negative")
        found = [1e4 * row["reported"].get("barrier", np.nan) for row in design.history]
        axes[3].plot(range(1, len(found) + 1), found, marker="o", color="#0072b2", label="search")
        axes[3].plot(
            len(found) + 1,
            1e4 * float(height(path)),
            "s",
            mfc="none",
            color="#0072b2",
            label="fresh cloud",
        )
        axes[3].axhline(1e4 * WANTED, color="#d55e00", linestyle="--", label="wanted")
        axes[3].set(xlabel="evaluation", ylabel=r"barrier ($10^{-4}\,kT/v\,$mm$^2$)")
        axes[3].legend(frameon=False, fontsize=7.5)
        figure.savefig(file)


def main(folder=Path("out/bistable")):
    """Search, verify on a finer cloud, write the folder."""
    design = optimise(problem, method="slsqp", evaluations=15, step=0.3, folder=folder, quiet=False)
    verified = {
        "study": "bistable",
        "parameters": {name: float(value) for name, value in design.parameters.items()},
    }
    verified["search"] = dict(
        value=design.value,
        feasible=design.feasible,
        outcome=str(design.outcome),
        evaluations=len(design.history),
        reported=design.reported,
    )
    for name, parameters in (("start", problem.start), ("best", design.parameters)):
        verified[name], path = verify(
            problem, parameters, spacing=(SPACING, FINER), scale=SCALE, mu=problem.mu
        )
        found = barriers(path)
        verified[name]["negative"] = [
            *(barrier.state.negative_pivots for barrier in found),
            found[0].saddle.negative_pivots,
        ]
        own = verified[name]["reported"]["barrier"]
        error = verified[name]["errors"]["reported"]["barrier"] or np.nan
        print(
            f"{name}: barrier {own:.4e} +- {error:.1e} kT/v mm^2 on {path.model.n_nodes} nodes; "
            f"{verified[name]['reason']}"
        )
    (folder / "verified.json").write_text(json.dumps(verified, indent=1))
    print(
        f"{design.text}: {verified['parameters']}, barrier {design.reported['barrier']:.4e} in "
        "the search"
    )
    draw(design, path, folder / "design.png")


if __name__ == "__main__":
    main()
