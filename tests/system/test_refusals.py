"""Frequent mistakes are refused in one line: argument, value and alternatives."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import observables
from jaxgel.continuation import SweepOptions

OBSERVABLES = [
    *(
        "area_reduction",
        "area_reduction_per_hole",
        "core_rotation",
        "rotation_angle",
        "surface_ratio",
        "crease_indicator",
        "min_gap",
    ),
    *(
        "outlines",
        "volume_ratio",
        "cauchy_stress",
        "macroscopic_deformation",
        "history",
        "field_values",
    ),
]
KINDS = [("model", " Model"), ("gel", " gel such as"), ("path", " Path")]
GEL, TURN = jaxgel.Gel(1e-3, 0.1), 2 * np.pi * np.arange(50) / 50
RING = np.stack([np.cos(TURN), 0.7 * np.sin(TURN)], axis=1)


def test_arguments_of_another_kind_are_told_from_models_gels_paths_and_points(
    tiny_model, tiny_plate, refused
):
    problem = jaxgel.Problem(tiny_model, GEL, contact=False)
    model, gel, path = (
        rf"^{name}: an argument of the kind {{}} is not accepted; give a{rest}"
        for name, rest in KINDS
    )
    solvers = (jaxgel.sweep, jaxgel.critical_points, jaxgel.loop)
    refused(
        lambda call, *given: call(*given),
        [
            *(
                (
                    solve,
                    tiny_model,
                    (-3.0, -2.0),
                    r"^problem: an argument of the kind Model is not accepted; give a Prob",
                )
                for solve in solvers
            ),
            (jaxgel.Problem, tiny_plate, GEL, model.format("Plate")),
            (jaxgel.Problem, GEL, tiny_model, model.format("Gel")),
            (
                jaxgel.Problem,
                tiny_model,
                jaxgel.Gel,
                r"^gel: the class Gel is not accepted; give a gel such as",
            ),
            (jaxgel.Problem, tiny_model, {"Nv": 1e-3}, gel.format("dict")),
            (jaxgel.load_vector, tiny_plate, model.format("Plate")),
            (
                jaxgel.imperfection,
                problem,
                None,
                0.1,
                r"^point: an argument of the kind NoneType is not accepted; give a Crit",
            ),
            (jaxgel.continue_branch, tiny_model, path.format("Model")),
            (jaxgel.folds, tiny_model, path.format("Model")),
            (jaxgel.continuation.lowest_eigenvalue, tiny_model, path.format("Model")),
            *(
                (
                    getattr(observables, name),
                    tiny_model,
                    *["J"] * (name == "field_values"),
                    path.format("Model"),
                )
                for name in OBSERVABLES
            ),
        ],
    )


def test_clouds_and_plates_are_told_from_other_arguments(tiny_model, tiny_plate):
    with pytest.raises(
        ValueError, match=r"^cloud: an argument of the kind Plate is not accepted; give a Cloud"
    ):
        jaxgel.discretise(tiny_plate)
    with pytest.raises(
        ValueError, match=r"^plate: an argument of the kind Model is not accepted; give a Plate"
    ):
        jaxgel.make_cloud(tiny_model)
    with pytest.raises(ValueError, match=r"^plate: the class Plate is not accepted"):
        jaxgel.make_cloud(jaxgel.Plate)


@pytest.mark.parametrize("theta", [{"radius": 1.0}, [1.0], ["radius"]])
def test_parameters_are_a_list_with_a_dict_for_each_hole(theta, tiny_plate):
    with pytest.raises(
        ValueError,
        match=r"^theta: .* is not accepted; give a list with one dict of parameters per hole, such",
    ):
        tiny_plate.at(theta)


@pytest.mark.parametrize(
    ("centre", "edge"),
    [((1, 0), "right"), ((-1 + 1e-6, 0), "left"), ((0, 1 + 1e-6), "top"), ((0.3, -1), "bottom")],
    ids=str,
)
def test_a_hole_that_touches_an_edge_is_named(centre, edge):
    plate = jaxgel.Plate(4, 4, [jaxgel.Circle(centre, 1.0)], spacing=0.5)
    with pytest.raises(
        ValueError, match=rf"^holes\[0\]: it touches the {edge} edge; move it in .*or across"
    ):
        jaxgel.make_cloud(plate)


def test_holes_across_an_edge_or_a_hundredth_of_the_plate_away_do_not_touch_it():
    for x in (1.3, 0.96):
        assert len(
            jaxgel.make_cloud(jaxgel.Plate(4, 4, [jaxgel.Circle((x, 0), 1.0)], spacing=0.5)).nodes
        )


@pytest.mark.parametrize(
    ("holes", "ligament"),
    [
        ([jaxgel.Circle((1, 0), 0.999)], r"0\.001 mm between holes\[0\] and the right edge"),
        (
            [jaxgel.Circle((-0.8, 0), 0.7), jaxgel.Circle((0.601, 0), 0.7)],
            r"0\.001 mm between holes\[0\] and holes\[1\]",
        ),
    ],
    ids=["edge", "hole"],
)
def test_a_ligament_too_narrow_for_shape_functions_is_named(holes, ligament):
    """By the discretisation, or already by the cloud where it has no node."""
    plate = jaxgel.Plate(4, 4, holes, spacing=0.4, nodes_per_hole=16)
    with pytest.raises(
        ValueError,
        match=(
            rf"ligament (of )?{ligament}|in the "
            rf"{ligament.replace(' between', ' ligament between')}"
        ),
    ):
        jaxgel.discretise(jaxgel.make_cloud(plate))


@pytest.mark.thorough
@pytest.mark.parametrize("sides", [50, 300])
def test_a_polygon_of_many_sides_has_a_node_at_each_corner(sides):
    turn = 2 * np.pi * np.arange(sides) / sides
    corners = np.stack([np.cos(turn), 0.7 * np.sin(turn)], axis=1)
    nodes = np.asarray(
        jaxgel.make_cloud(jaxgel.Plate(4, 4, [jaxgel.Polygon(corners)], spacing=0.5)).nodes
    )
    assert np.linalg.norm(nodes[:, None] - corners[None], axis=2).min(axis=0).max() < 1e-12


def test_too_few_nodes_for_a_polygon_are_named_by_their_entry():
    with pytest.raises(
        ValueError,
        match=r"^nodes_per_hole: 20 are too few for holes\[0\] with 50 sides; give at least 50$",
    ):
        jaxgel.make_cloud(jaxgel.Plate(4, 4, [jaxgel.Polygon(RING)]), nodes_per_hole=20)


@pytest.mark.parametrize(("chi", "bound"), [(0.1, -23.4), (-5.0, -28.5)])
def test_a_mu_at_which_the_volume_ratio_is_lost_in_round_off_is_refused_with_the_bound(
    tiny_model, chi, bound
):
    """J - 1 = exp(mu - 1 - chi) there, and the bulk stiffness 1 / (J - 1) leaves two digits of Nv.

    At the bound there is a state.
    """
    gel = jaxgel.Gel(1e-3, chi)
    with pytest.raises(
        ValueError,
        match=rf"^mu: -40 is too low, J - 1 would be lost in round-off; give at least {bound} kT$",
    ):
        jaxgel.sweep(jaxgel.Problem(tiny_model, gel), [-40.0, -3.0])
    assert bound == pytest.approx(np.log(100 * np.finfo(float).eps / 1e-3) + 1 + chi, abs=0.1)
    assert jaxgel.sweep(jaxgel.Problem(tiny_model, gel), [bound]).stop.ok


def test_steps_beside_a_list_of_values_are_refused():
    with pytest.raises(ValueError, match=r"^sweep\.steps: 5 does not go with a list of values"):
        SweepOptions(mu=(-3.0, -2.0), steps=5)
    with pytest.raises(
        ValueError, match=r"^sweep\.steps: 'auto' does not go with a list of values"
    ):
        SweepOptions(control="chi", value_list=(0.1, 0.2), steps="auto")
    assert len(SweepOptions().values) == 40 and SweepOptions(mu=(-3.0, -2.0)).values == [-3.0, -2.0]
    assert SweepOptions(steps=5).at([-3.0, -2.0]).values == [-3.0, -2.0]


def test_traced_parameters_still_pass(tiny_plate):
    assert isinstance(tiny_plate.at([{"radius": jnp.asarray(1.0)}]), jaxgel.Plate)
