"""A domain for the gradient benchmark Mosaic: patterns of a swelling plate, onset, snap-through.

Mosaic is ``mosaic-bench``. Three tasks with one interface, ``shape`` (m,) and ``gel`` (2,) to
``value`` (k,), all dimensionless or as said:

- ``pattern``: four ellipses in a square plate of 22 mm, sample 1 of Deng et al. (2020). ``shape``
  (20,): semi-axes (mm), centre (mm) and angle (rad) of each hole; ``value``: rotation of the core
  at `MU`, degrees.
- ``onset``: a square plate of 22 mm with four round holes. ``shape`` (2,): distance of the centres
  from the midlines and radius, mm; ``value`` (1,): mu (kT) at which the symmetric pattern buckles.
- ``fold``: a buckled beam of 10 x 1 mm with two round holes, pressed across its middle. ``shape``
  (2,): distance of the holes from the middle and radius, mm; ``value`` (1,): force at the limit of
  stability, 1e-4 kT/v mm.

``gel`` has Nv and chi over those of the reference, (1, 1) for it.
"""

import numpy as np
from pydantic import BaseModel, Field
from tesseract_core.runtime import Array, Differentiable, Float64

MU = (-3.9678, -2.9678, -1.9678, -1.4678, -0.9678)  # kT
TASKS = {
    "pattern": np.array(
        [(5.0, 4.0, x, y, np.pi / 2 * (x * y < 0)) for x in (-5.0, 5.0) for y in (-5.0, 5.0)]
    ).ravel(),
    "onset": np.array([5.0, 4.4721]),
    "fold": np.array([2.5, 0.2]),
}  # name -> shape of the reference
# Nv and chi of the reference
GEL = {"pattern": (1e-3, 1e-4), "onset": (1e-3, 1e-4), "fold": (1e-2, 0.1)}


class InputSchema(BaseModel):
    """What a solver is given."""

    task: str = Field(description="name of the task")
    shape: Differentiable[Array[(None,), Float64]] = Field(
        description="numbers of the holes, see the task"
    )
    gel: Differentiable[Array[(2,), Float64]] = Field(
        description="Nv and chi over those of the reference"
    )


class OutputSchema(BaseModel):
    """What it returns."""

    value: Differentiable[Array[(None,), Float64]] = Field(description="numbers of the task")


def inputs(task):
    """Inputs of the reference."""
    return {"task": task, "shape": TASKS[task], "gel": np.ones(2)}


def sizes(task):
    """Number of values of a task."""
    return len(MU) if task == "pattern" else 1
