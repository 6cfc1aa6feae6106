"""What acts at a value of a control, and which controls and values are refused."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgel.cloud import make_cloud
from jaxgel.controls import (
    Changes,
    ChemicalPotential,
    Control,
    Driven,
    Load,
    Setting,
    Stretch,
    changes_of,
    check_control,
    check_is_control,
    check_values,
    chi,
    driven,
    temperature,
)
from jaxgel.geometry import EDGES, Plate
from jaxgel.materials import Composite, Elastomer, Filled, Gel, LocalValues
from jaxgel.mechanics import edges_of

GEL = Gel(1e-3, 0.1)
EDGES_OF_PLATE = edges_of(
    make_cloud(Plate(4.0, 4.0, displacement={"top": (0.0, 0.1)}, spacing=1.0)).topology, True
)


NOTHING = Changes(edges=False, loads=False, gel=False, stiffness=False)


def test_a_control_changes_what_it_says():
    control = ChemicalPotential()
    setting = control(-0.5, GEL)
    assert (setting.mu, setting.gel, setting.deformation, setting.displacement) == (
        -0.5,
        GEL,
        None,
        None,
    )
    assert (control.name, control.unit) == ("mu", "kT")
    assert changes_of(control, GEL) == NOTHING
    assert changes_of(Stretch(), GEL) == dataclasses.replace(NOTHING, edges=True)
    assert changes_of(Load(np.ones((3, 2))), GEL) == dataclasses.replace(NOTHING, loads=True)
    assert changes_of(chi(), GEL) == dataclasses.replace(NOTHING, gel=True)
    assert changes_of(driven("Nv"), GEL) == dataclasses.replace(NOTHING, gel=True, stiffness=True)


def test_a_driven_parameter_replaces_that_of_the_gel_and_of_no_elastomer():
    control = chi(mu=-0.3)
    assert isinstance(control, Control)
    assert (control.name, control.unit, temperature().unit) == ("chi", "", "°C")
    setting = control(0.4, GEL)
    assert (float(setting.mu), setting.gel.Nv, setting.gel.chi) == (-0.3, 1e-3, 0.4)
    both = control(0.4, Composite(GEL, (Gel(2e-3, 0.1), Elastomer(1.0, 10.0)))).gel
    assert (both.matrix.chi, both.regions[0].chi, both.regions[0].Nv) == (0.4, 0.4, 2e-3)
    assert both.regions[1] == Elastomer(1.0, 10.0)
    with pytest.raises(
        ValueError,
        match=(
            r"^control: regions\[0\] has a 'chi' of its own, only one number of all gels can be "
            r"driven"
        ),
    ):
        control(0.4, Composite(GEL, (Gel(1e-3, 0.2),)))
    local = LocalValues((), jnp.ones(2), jnp.ones(0))
    assert control(0.4, Filled(dataclasses.replace(GEL, Nv=local), local)).gel.gel.chi == 0.4


def test_a_stretch_moves_the_edges_along_its_direction():
    for direction, expected in (("x", [1.2, 1.0]), ("y", [1.0, 1.2]), ("both", [1.2, 1.2])):
        control = Stretch(direction, mu=-1.0)
        moved = EDGES_OF_PLATE.moved(control(1.2, GEL))
        np.testing.assert_allclose(moved.deformation, np.diag(expected))
        # what the control does not say the plate does
        np.testing.assert_array_equal(moved.displacement, EDGES_OF_PLATE.displacement)
    with pytest.raises(ValueError, match="direction: 'z' is not one of x, y, both"):
        Stretch("z")


def test_a_load_multiplies_its_loads():
    loads = np.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(Load(loads)(0.5, GEL).loads, loads / 2)


def _ramp(value, gel, rate):
    return Setting(rate * value, gel, displacement={"right": jnp.stack([value, 0.0 * value])})


def test_an_own_path_is_differentiable_in_its_parameters():
    control = Driven(_ramp, (jnp.asarray(2.0),), name="ramp", unit="s")
    assert isinstance(control, Control)
    assert jax.grad(lambda control: control(3.0, GEL).mu)(control).parameters[0] == 3.0
    moved = EDGES_OF_PLATE.moved(control(0.25, GEL))
    np.testing.assert_array_equal(moved.deformation, np.eye(2))
    displacement = dict(zip(EDGES, np.asarray(moved.displacement).tolist(), strict=True))
    assert (displacement["right"], displacement["top"]) == ([0.25, 0.0], [0.0, 0.1])
    check_control(control, GEL, np.array([0.0, 1.0, 0.0]))


def _jump(value, gel):
    return Setting(jnp.where(value < 0.3, -1.0, -0.5), gel)


def _nothing(value, gel):
    return value


def _endless(value, gel):
    return Setting(-1.0, gel, displacement={"right": jnp.array([jnp.inf, value])})


def _too_poor(value, gel):
    return Setting(-1.0, dataclasses.replace(gel, chi=2.0 * value))


def _unknown(value, gel):
    return Setting(-1.0, gel, displacement={"rihgt": jnp.stack([value, 0.0])})


def test_controls_that_cannot_be_used_are_refused_in_one_line(refused):
    refused(
        check_is_control,
        [
            (
                lambda value, gel: Setting(value, gel),
                "^control: .* must have a name, a unit and a scale",
            )
        ],
    )
    refused(
        lambda control: check_control(control, GEL, np.array([0.0, 1.0])),
        [
            (temperature(), "control: 'temperature' is no parameter of Gel, it has Nv, chi"),
            (
                Driven(_jump, name="ramp"),
                r"ramp: what acts jumps at 0\.3, the path must be continuous",
            ),
            (
                Driven(_nothing, name="ramp"),
                "ramp: the control gives float at 0, it must give a Setting",
            ),
            (Driven(_endless, name="ramp"), "ramp: what acts at 0 is not finite"),
            (
                Driven(_unknown, name="ramp"),
                (
                    r"ramp: displacement of \['rihgt'\] is not accepted, edges are left, right, "
                    r"bottom, top"
                ),
            ),
            (Stretch(mu=np.nan), "stretch = 0: mu: nan is not accepted"),
            (
                Driven(_too_poor, name="ramp"),
                r"ramp = 1: chi: 2 is not accepted, it must be a finite number < 2",
            ),
        ],
        start=True,
    )


def test_a_parameter_that_varies_over_the_plate_is_not_driven():
    field = Gel(1e-3, lambda X: 0.1 + 0.01 * X[0])
    with pytest.raises(ValueError, match=r"^control: 'chi' varies over the plate"):
        check_control(chi(), field, np.array([0.1, 0.2]))


def test_a_steep_path_is_no_jump():
    check_control(Driven(_steep), GEL, np.array([0.0, 1.0]))


def _steep(value, gel):
    return Setting(jnp.tanh(1e6 * (value - 0.3)), gel)


def test_values_that_cannot_be_used_are_refused(refused):
    refused(
        lambda values: check_values(values, "temperature", "°C"),
        [
            (
                [25.0, np.nan],
                (
                    r"temperature: \[25.0, nan\] is not accepted, it must be a list of finite "
                    r"numbers \(°C\)"
                ),
            ),
            (["warm"], r"temperature: \['warm'\] is not accepted"),
            ([], r"temperature: \[\] is not accepted"),
            ([25.0, 30.0, 30.0], "temperature: 30 is followed by 30, the values must differ"),
            ((25.0, 25.0), "temperature: 25 is followed by 25, the values must differ"),
        ],
        start=True,
    )


def test_values_of_a_study_must_rise():
    with pytest.raises(ValueError, match=r"^mu: -1 is followed by -2, the values must increase"):
        check_values([-1.0, -2.0], rising=True)
    np.testing.assert_array_equal(check_values([-2.0, -1.0], rising=True), [-2.0, -1.0])
