"""Error bars of a case's numbers, derivatives and critical points from states on other clouds."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .._validation import one_of
from ..bifurcation import sweep_by_options
from ..continuation import Path
from ..equilibrium import UNOBSERVED, Observer
from ..verification import ACCURACY, Accuracy, ErrorBars, accuracy, error_bars, on_clouds
from .case import Case
from .uncertain import uncertain_inputs, uncertainty_of

POINTS = ("onset", "fold_up", "fold_down", "loop_width")
"""Control values with error bars: the first critical point, the folds, and the loop's width."""


def accuracy_of(
    case: Case, path: Path, *, quantities: Sequence[str] = ACCURACY, observer: Observer = UNOBSERVED
) -> Accuracy:
    """`verification.accuracy` of a case's ``path``, on coarser and finer clouds.

    The values are those of the control, or times.
    """
    cloud, values = path.model.cloud, np.asarray(path.value).tolist()
    own = cloud.topology.spacing

    def path_at(spacing):
        if spacing == own:
            return path
        other = dataclasses.replace(case, discretisation=case.discretisation.scaled(cloud, spacing))
        if case.time is not None:
            times = dataclasses.replace(
                case.time, end=None, steps_per_decade=None, first=None, times=tuple(values[1:])
            )
            return dataclasses.replace(other, time=times).path(other.model(), observer=observer)
        return sweep_by_options(
            other.problem(other.model()), case.sweep, values=values, observer=observer
        )

    return accuracy(path_at, own, quantities=quantities)


def slope_accuracy_of(
    case: Case, names: Sequence[str], quantities: Sequence[str]
) -> dict[tuple[str, str], ErrorBars]:
    """(quantity, input) -> `verification.ErrorBars` (1,) of its derivative at the last state.

    ``names`` are inputs as in the section ``uncertainty``; derivatives by angles in degrees are per
    degree. ValueError as of `uncertain.uncertainty_of`.
    """
    inputs, cloud = uncertain_inputs(case, dict.fromkeys(names, 1.0)), case.cloud()
    nodes = {}

    def slopes_at(spacing):
        other = dataclasses.replace(case, discretisation=case.discretisation.scaled(cloud, spacing))
        nodes[spacing] = len(other.cloud().nodes)
        return uncertainty_of(other, inputs, quantities)

    found = on_clouds(slopes_at, cloud.topology.plate, cloud.topology.spacing)
    sizes, own = (
        np.array([nodes[h] ** -0.5 for h in found]),
        list(found).index(cloud.topology.spacing),
    )
    slopes = np.array([one.slopes for one in found.values()])
    first = found[cloud.topology.spacing]
    return {
        (name, which): error_bars(sizes, slopes[:, k, i : i + 1], own)
        for k, name in enumerate(first.names)
        for i, which in enumerate(first.inputs)
    }


def point_accuracy_of(
    case: Case, names: Sequence[str], *, observer: Observer = UNOBSERVED
) -> dict[str, ErrorBars]:
    """Name -> `verification.ErrorBars` (1,) of a case's critical points, in the control's unit.

    They lie between the ends of its sweep. ``names`` are of `POINTS`; nan on clouds whose gel has
    no such point. ValueError for another name, and as of `Case.critical_points` and `Case.loop`.
    """
    for name in names:
        one_of("points", name, POINTS)
    cloud, nodes = case.cloud(), {}

    def points_at(spacing):
        other = dataclasses.replace(case, discretisation=case.discretisation.scaled(cloud, spacing))
        model = other.model()
        nodes[spacing] = model.n_nodes
        first = other.critical_points(model, most=1, observer=observer) if "onset" in names else []
        loop = other.loop(model, observer=observer) if set(names) - {"onset"} else None
        found = {"onset": first[0].value if first else None}
        if loop is not None:
            folds = {name: getattr(loop, name) for name in ("fold_up", "fold_down")}
            found |= {
                name: None if fold is None else fold.value for name, fold in folds.items()
            } | {"loop_width": loop.width}
        return [np.nan if found[name] is None else float(found[name]) for name in names]

    found = on_clouds(points_at, cloud.topology.plate, cloud.topology.spacing)
    sizes, own = (
        np.array([nodes[h] ** -0.5 for h in found]),
        list(found).index(cloud.topology.spacing),
    )
    return {
        name: error_bars(sizes, column[:, None], own)
        for name, column in zip(names, np.array(list(found.values())).T, strict=True)
    }
