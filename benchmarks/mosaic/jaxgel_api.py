"""jaxgel as a Tesseract for all three tasks of ``domain.py``.

Gradients by the implicit function theorem.
"""

import functools
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parent))

import jax
import jax.numpy as jnp
import numpy as np

# the schemas are part of a Tesseract's interface
from domain import GEL, MU, TASKS, InputSchema, OutputSchema, sizes  # noqa: F401

import jaxgel
from jaxgel.controls import Load

START, SQUEEZED = -4.9678, -1.4  # kT
SIGNS = np.array([(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)])  # of the centres of four holes
ACROSS = 1e-4  # kT/v mm, the force at a value of 1


def apply(inputs):
    """Values of a task."""
    return OutputSchema(
        value=np.asarray(solved(inputs.task, jnp.asarray(inputs.shape), jnp.asarray(inputs.gel)))
    )


def vector_jacobian_product(inputs, vjp_inputs, vjp_outputs, cotangent_vector):
    """Gradients with respect to ``vjp_inputs`` of the values times the cotangent."""
    given = {"shape": jnp.asarray(inputs.shape), "gel": jnp.asarray(inputs.gel)}
    chosen = {name: given[name] for name in vjp_inputs}
    _, pull = jax.vjp(lambda some: solved(inputs.task, **(given | some)), chosen)
    return {
        name: np.asarray(found)
        for name, found in pull(jnp.asarray(cotangent_vector["value"]))[0].items()
    }


def abstract_eval(abstract_inputs):
    """Shapes of the values."""
    return {"value": {"shape": (sizes(abstract_inputs.task),), "dtype": "float64"}}


def solved(task, shape, gel):
    """Values (k,) of a task; the cloud is that of the reference, moved with the holes."""
    return {"pattern": _pattern, "onset": _onset, "fold": _fold}[task](
        shape, jaxgel.Gel(*(gel * np.array(GEL[task])))
    )


@functools.cache
def reference(task):
    """The plate of the reference."""
    shape = TASKS[task]
    if task == "pattern":
        holes = [
            jaxgel.Ellipse(tuple(hole[2:4]), tuple(hole[:2]), float(hole[4]))
            for hole in shape.reshape(4, 5)
        ]
        return jaxgel.Plate(22, 22, holes, spacing=22 / 56)
    if task == "onset":
        return jaxgel.Plate(
            22, 22, [jaxgel.Circle(tuple(shape[0] * sign), shape[1]) for sign in SIGNS]
        )
    edges = {"left": "fixed", "right": "fixed", "top": "free", "bottom": "free"}
    return jaxgel.Plate(
        10,
        1,
        [jaxgel.Circle((x, 0), shape[1]) for x in (-shape[0], shape[0])],
        edges=edges,
        spacing=0.5,
        nodes_per_hole=12,
    )


def model_of(task, holes):
    """The model of the reference whose holes have moved."""
    return jaxgel.discretise(jaxgel.make_cloud(reference(task).at(holes)))


def _pattern(shape, gel):
    holes = [
        {"semi_axes": hole[:2], "centre": hole[2:4], "angle": hole[4]}
        for hole in shape.reshape(4, 5)
    ]
    path = jaxgel.sweep(jaxgel.Problem(model_of("pattern", holes), gel), jnp.array([START, *MU]))
    return jaxgel.core_rotation(path)[1:]


def _onset(shape, gel):
    model = model_of("onset", [{"centre": shape[0] * sign, "radius": shape[1]} for sign in SIGNS])
    return jnp.array(
        [jaxgel.critical_points(jaxgel.Problem(model, gel), (START, MU[-1]), most=1)[0].mu]
    )


def _fold(shape, gel):
    model = model_of(
        "fold",
        [{"centre": shape[0] * jnp.array([x, 0.0]), "radius": shape[1]} for x in (-1.0, 1.0)],
    )
    nodes = np.asarray(jax.lax.stop_gradient(model.cloud.nodes))
    middle = np.abs(nodes[:, 0]) < 1e-6
    force = np.stack([np.zeros(len(nodes)), middle / middle.sum() * ACROSS], axis=1)
    problem = jaxgel.Problem(model, gel, control=Load(force, mu=SQUEEZED, scale=1.0), contact=False)
    return jnp.array([jaxgel.critical_points(problem, (-2.0, 2.0), most=1)[0].value])
