"""NGSolve (mixed finite elements) as a Tesseract for the task ``pattern`` of ``domain.py``.

It has neither onsets nor folds. Gradients by direct differentiation: the residual of each state on
moved meshes and with other gels gives, by one factor of the tangent, how displacements and
pressures move with every number; the rotation is differenced along that motion.
"""

import dataclasses
import functools
import pathlib
import sys

sys.path[:0] = [str(pathlib.Path(__file__).parent), str(pathlib.Path(__file__).parents[1])]

import numpy as np

# the schemas are part of a Tesseract's interface
from domain import GEL, MU, TASKS, InputSchema, OutputSchema  # noqa: F401
from finite_elements import stops
from ngsolve_gel import MixedGel, plate_mesh
from references import MorphedGel

import jaxgel

START = -4.9678  # kT
# of the elements; their longest edges in the plate and on the holes, mm
ORDER, PLATE, HOLE = 4, 2.0, 0.9
STEP = {"shape": 1e-4, "gel": 1e-3}  # of the differences


def apply(inputs):
    """Rotations of the core; the mesh is that of the reference, moved with the holes."""
    found = [gel.core_rotation() for gel, _ in states(inputs)]
    return OutputSchema(value=np.array(found))


def vector_jacobian_product(inputs, vjp_inputs, vjp_outputs, cotangent_vector):
    """Gradients with respect to ``vjp_inputs`` of the rotations times the cotangent."""
    given = {"shape": np.array(inputs.shape), "gel": np.array(inputs.gel)}
    found = {name: np.zeros(len(given[name])) for name in vjp_inputs}
    for (gel, mu), share in zip(states(inputs), np.asarray(cotangent_vector["value"]), strict=True):
        gel.factor()
        for name in vjp_inputs:
            for k in range(len(given[name])):
                move = STEP[name] * np.eye(len(given[name]))[k]
                found[name][k] += share * slope(gel, mu, given, name, move) / (2 * STEP[name])
    return found


def abstract_eval(abstract_inputs):
    """Shapes of the rotations."""
    return {"value": {"shape": (len(MU),), "dtype": "float64"}}


def states(inputs):
    """The gel in equilibrium at each of `MU`, with that mu."""
    if inputs.task != "pattern":
        raise ValueError(f"task: {inputs.task!r} is not solved by NGSolve here; it has 'pattern'")
    gel = gel_at(np.array(inputs.shape), np.array(inputs.gel))
    for mu in gel.follow(stops(START, list(MU))):
        if mu in MU:
            yield gel, mu


def slope(gel, mu, given, name, move):
    """Change of the rotation, degrees, from minus to plus ``move`` of the numbers ``name``."""
    state, ends = gel.state.vec.FV().NumPy().copy(), []
    for sign in (1, -1):
        other = gel_at(**(given | {name: given[name] + sign * move}))
        other.mu.Set(mu)
        other.state.vec.FV().NumPy()[:] = state
        other.residual.Assemble()
        ends.append((other, other.residual.vec.FV().NumPy().copy()))
    motion = solved(gel, (ends[1][1] - ends[0][1]) / 2)
    found = []
    for (other, _), sign in zip(ends, (1, -1), strict=True):
        gel.mesh.SetDeformation(other.motion)
        other.state.vec.FV().NumPy()[:] = state + sign * motion
        found.append(other.core_rotation())
    gel.mesh.SetDeformation(gel.motion)
    return found[0] - found[1]


def solved(gel, right):
    """Motion of displacements and pressures under this right-hand side, by the factor at hand."""
    r, K = gel.residual.vec, gel.tangent
    r.FV().NumPy()[:] = right
    r.data += K.harmonic_extension_trans * r
    gel.step.data = gel.inverse * r
    gel.step.data += K.harmonic_extension * gel.step
    gel.step.data += K.inner_solve * r
    return gel.step.FV().NumPy().copy()


def gel_at(shape, gel):
    """The dry gel on the mesh of the reference, moved with the holes."""
    holes = [
        {"centre": tuple(hole[2:4]), "semi_axes": tuple(hole[:2]), "angle": float(hole[4])}
        for hole in shape.reshape(4, 5)
    ]
    base = reference()
    base.mesh.UnsetDeformation()
    base.plate = dataclasses.replace(base.plate, gel=jaxgel.Gel(*(gel * np.array(GEL["pattern"]))))
    return MorphedGel(base, lambda hole, index: dataclasses.replace(hole, **holes[index]))


@functools.cache
def reference():
    """The dry gel of the reference."""
    holes = [
        jaxgel.Ellipse(tuple(hole[2:4]), tuple(hole[:2]), float(hole[4]))
        for hole in TASKS["pattern"].reshape(4, 5)
    ]
    plate = jaxgel.Plate(22, 22, holes, gel=jaxgel.Gel(*GEL["pattern"]))
    return MixedGel(plate, plate_mesh(plate, ORDER, PLATE, HOLE), ORDER, steps=4)
