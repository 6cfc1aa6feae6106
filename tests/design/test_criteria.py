"""Facts about objectives: a quantity is read where the path has a value."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgel.controls import ChemicalPotential
from jaxgel.design import misfit, value_at
from jaxgel.equilibrium import Status

MU = np.array([-3.0, -2.0, -1.0])


def path_of(values, stop=Status.CONVERGED):
    return SimpleNamespace(
        value=jnp.asarray(values), control=ChemicalPotential(), stop=stop, t=None
    )


def square(path):
    return path.value**2


@pytest.mark.parametrize("values", [MU, MU[::-1]])
def test_a_value_between_two_states_is_linear(values):
    assert float(value_at(square, -1.5)(path_of(values))) == pytest.approx(2.5)
    assert float(value_at(square, -1.0)(path_of(values))) == 1.0


@pytest.mark.parametrize("at", [-3.1, 0.0])
def test_a_value_beyond_the_path_is_refused(at):
    message = rf"^mu: {at:g} is beyond the path, which runs from -3 to -1; ask for a value within$"
    with pytest.raises(ValueError, match=message):
        value_at(square, at)(path_of(MU))
    with pytest.raises(ValueError, match=message):
        misfit(square, [-2.0, at], [1.0, 2.0])(path_of(MU))


def test_a_value_beyond_a_path_that_stopped_is_not_a_number_and_has_no_slope():
    stopped = path_of(MU, Status.STEP_TOO_SMALL)
    assert np.isnan(value_at(square, -0.5)(stopped))
    assert float(value_at(square, -2.5)(stopped)) == pytest.approx(6.5)
    slope = jax.grad(lambda factor: value_at(lambda path: factor * square(path), -0.5)(stopped))(
        1.0
    )
    assert np.isnan(slope)
