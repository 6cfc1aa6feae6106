"""Error bars of a case's numbers: the same states on other clouds."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..bifurcation import sweep_by_options
from ..continuation import Path
from ..equilibrium import UNOBSERVED, Observer
from ..verification import ACCURACY, Accuracy, accuracy
from .case import Case


def accuracy_of(case: Case, path: Path, *, quantities: Sequence[str] = ACCURACY, observer: Observer = UNOBSERVED) -> Accuracy:
    """`verification.accuracy` of a case's ``path``: its values of the control, or its times, on coarser and finer clouds."""
    cloud, values = path.model.cloud, np.asarray(path.value).tolist()
    own = cloud.topology.spacing

    def path_at(spacing):
        if spacing == own:
            return path
        other = dataclasses.replace(case, discretisation=case.discretisation.scaled(cloud, spacing))
        if case.time is not None:
            times = dataclasses.replace(case.time, end=None, steps_per_decade=None, first=None, times=tuple(values[1:]))
            return dataclasses.replace(other, time=times).path(other.model(), observer=observer)
        return sweep_by_options(other.problem(other.model()), case.sweep, values=values, observer=observer)

    return accuracy(path_at, own, quantities=quantities)
