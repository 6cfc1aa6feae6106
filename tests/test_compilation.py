"""Programs that are compiled as a user's are give the numbers of those of the tests, which leave out LLVM's optimisation, see conftest."""

import json
import os
import subprocess
import sys

import numpy as np

from jaxgel.versions import quick_flags

NUMBERS = """
import json, os
import jax, jaxgel
plate = jaxgel.Plate(4, 4, [jaxgel.Circle((0.1, -0.2), 1.1)], edges={"top": "free"}, spacing=2 / 3, nodes_per_hole=12)
cloud = jaxgel.make_cloud(plate)

def readings(v):
    model = jaxgel.discretise(cloud.at(plate.at([{"radius": v[0]}])))
    path = jaxgel.sweep(model, jaxgel.Gel(v[1], v[2]), mu=[-3.0, -2.0], contact="off")
    return jax.numpy.stack([jaxgel.area_reduction(path)[-1], path.energy[-1]])

values, pullback = jax.vjp(readings, jax.numpy.array([1.1, 1e-3, 1e-4]))
numbers = [values.tolist(), *(pullback(row)[0].tolist() for row in jax.numpy.eye(2))]
print(json.dumps([os.environ["XLA_FLAGS"], numbers]))
"""


def test_states_and_gradients_are_those_of_programs_compiled_as_a_users_are(capsys):
    names = {}
    exec(compile(NUMBERS, "numbers", "exec"), names)
    environment = {name: value for name, value in os.environ.items() if name not in ("XLA_FLAGS", "JAX_DISABLE_MOST_OPTIMIZATIONS")}
    done = subprocess.run([sys.executable, "-c", NUMBERS], env=environment, capture_output=True, text=True, check=True)
    flags, numbers = json.loads(done.stdout)
    assert flags.split() == quick_flags()
    for one, other in zip(names["numbers"], numbers, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)  # states are solved to 1e-10 of the network's forces
