"""Random plates with obstacles: each ends in a path whose states are not crossed, or in one line.

Number k depends on nothing else. Spacing and number of outline nodes are the same for all, so that
they share compiled programs.
"""

import gc

import numpy as np
import pytest
from crossings import crossed

import jaxgel
from jaxgel.continuation import SweepFailed

CASES = 50
GROUPS = 5  # of cases, a test each
CUTS = 3  # of a step: a path that folds back ends soon


def drawn_plate(rng):
    """A plate with free edges, up to one hole and three obstacles, also overlapping ones."""
    edges = {
        edge: str(rng.choice(["free", "roller", "fixed"], p=[0.5, 0.35, 0.15]))
        for edge in ("left", "right", "bottom", "top")
    }
    edges["bottom"] = "roller" if set(edges.values()) == {"free"} else edges["bottom"]
    holes = [drawn_hole(rng)] if rng.random() < 0.6 else []
    obstacles = [drawn_obstacle(rng) for _ in range(rng.integers(1, 3))]
    if holes and rng.random() < 0.5:
        obstacles.append(
            jaxgel.Disc(
                np.asarray(holes[0].centre) + rng.uniform(-0.05, 0.05, 2), rng.uniform(0.02, 0.08)
            )
        )
    return jaxgel.Plate(
        1.0, 1.0, holes, edges=edges, obstacles=obstacles, spacing=0.2, nodes_per_hole=16
    )


def drawn_hole(rng):
    """Inside the plate or open to an edge."""
    centre = (
        rng.uniform(-0.15, 0.15, 2)
        if rng.random() < 0.7
        else rng.permutation([rng.uniform(-0.1, 0.1), rng.choice([-0.5, 0.5])])
    )
    return jaxgel.Ellipse(centre, rng.uniform(0.12, 0.3, 2), rng.uniform(0.0, 3.0))


def drawn_obstacle(rng):
    """Around the plate, at a distance that the gel crosses or not."""
    angle, distance = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.49, 0.8)
    away = np.array([np.cos(angle), np.sin(angle)])
    away, kind = away / np.abs(away).max(), rng.integers(3)
    if kind == 0:
        axis = np.eye(2)[rng.integers(2)] * rng.choice([-1.0, 1.0])
        return jaxgel.HalfPlane(distance * axis, -axis * rng.uniform(0.5, 2.0))
    if kind == 1:
        radius = rng.uniform(0.05, 0.6)
        return jaxgel.Disc((distance + radius) * away, radius)
    across = np.array([-away[1], away[0]])
    return jaxgel.Polyline(
        distance * away
        + rng.uniform(-0.3, 0.3, (4, 1)) * across
        + rng.uniform(0.0, 0.2, (4, 1)) * away
    )


def outcome(number):
    """What is wrong with a case: a list of texts, and how it ended."""
    rng = np.random.default_rng(number)
    plate, punched = drawn_plate(rng), rng.random() < 0.4
    gel = jaxgel.Gel(10 ** rng.uniform(-3.5, -1.0), rng.uniform(0.0, 0.6))
    values, options = (
        np.sort(rng.uniform(-3.0, -0.1, 3)),
        {"contact_range": float(rng.choice([0.0125, 0.03, 0.06]))},
    )
    if punched:
        options["control"] = jaxgel.Punch(
            rng.uniform(-0.3, 0.3, 2), int(rng.integers(len(plate.obstacles))), float(values[1])
        )
        values = np.linspace(0.0, 1.0, 3)
    try:
        model = jaxgel.discretise(jaxgel.make_cloud(plate))
        path = jaxgel.sweep(
            jaxgel.Problem(model, gel, **options), values, steps=jaxgel.StepControl(max_cuts=CUTS)
        )
    except (ValueError, SweepFailed) as refusal:
        return [f"case {number}: {refusal!r}"] * (
            "\n" in str(refusal) or not str(refusal)
        ), "refused"
    ended = "complete" if path.stop.ok else "stopped"
    return [f"case {number}: {text}" for text in crossed(path)] + [f"case {number}: no reason"] * (
        "\n" in path.stop_text
    ), ended


@pytest.mark.slow
@pytest.mark.parametrize("group", range(GROUPS))
def test_a_random_plate_with_obstacles_ends_in_states_that_are_not_crossed_or_in_one_line(group):
    faults, ends = [], []
    for number in range(group * CASES // GROUPS, (group + 1) * CASES // GROUPS):
        wrong, ended = outcome(number)
        faults += wrong
        ends.append(ended)
        gc.collect()
    assert not faults, "\n".join(faults)
    assert ends.count("complete") > 0
