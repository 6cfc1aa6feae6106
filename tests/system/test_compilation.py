"""Programs compiled as a user's give the tests' numbers, which lack LLVM's optimisation.

See conftest.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from jaxgel.cli.environment import quick_flags

NUMBERS = """
import json, jax, jaxgel
hole = jaxgel.Ellipse((0.3, -0.2), (2.4, 1.6), 0.4)
gel = jaxgel.Gel(Nv=1e-3, chi=1e-4)
plate = jaxgel.Plate(8, 8, [hole], spacing=1.2, nodes_per_hole=8, core=(3.2, 3.0), gel=gel)
cloud = jaxgel.make_cloud(plate)

def rotation(v):
    model = jaxgel.discretise(cloud.at(plate.at([{"semi_axes": v[:2]}])))
    path = jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(v[2], v[3])), [-3.5, -2.2])
    return jaxgel.rotation_angle(path)[-1]

value, slopes = jax.value_and_grad(rotation)(jax.numpy.array([2.4, 1.6, 1e-3, 1e-4]))
numbers = [float(value), *slopes.tolist()]
print(json.dumps(numbers))
"""


@pytest.fixture(scope="module")
def numbers():
    """Last rotation and its derivatives by the semi-axes, Nv and chi, from this process."""
    names = {}
    exec(NUMBERS, names)
    return names["numbers"]


@pytest.mark.slow
@pytest.mark.parametrize("flags", [[], quick_flags()], ids=["library", "command line"])
def test_states_and_gradients_are_those_of_programs_compiled_as_a_users_are(flags, numbers):
    environment = os.environ | {"XLA_FLAGS": " ".join(flags)}
    done = subprocess.run(
        [sys.executable, "-c", NUMBERS], env=environment, capture_output=True, text=True, check=True
    )
    # Newton's tolerance leaves 1e-10 of the forces
    np.testing.assert_allclose(json.loads(done.stdout), numbers, rtol=1e-9)
