"""Regions of other materials in case files."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from jaxgel import Composite, Elastomer, Gel, Plate, Polygon
from jaxgel.cases import case_text, example, explicit, from_table, load_case, load_path
from jaxgel.cli import main
from jaxgel.io import dry_gel, dry_regions, write_outline
from jaxgel.materials import with_matrix

PLATE = {"width": 2.0, "height": 2.0, "edges": {"top": "free"}, "spacing": 0.5}
STIFF = {
    "kind": "circle",
    "centre": [0.1, 0.0],
    "radius": 0.5,
    "elastomer": {"Nv": 0.1, "bulk": 10.0},
}
LAYER = {"kind": "rectangle", "centre": [0.0, -1.5], "sides": [4.0, 1.6], "gel": {"Nv": 4e-3}}
TABLE = {
    "plate": PLATE,
    "regions": [STIFF, LAYER],
    "gel": {"Nv": 1e-3, "chi": 0.1},
    "sweep": {"mu": [-4.0, -3.0]},
}


def test_a_region_has_what_it_says_and_else_the_gel_of_the_plate():
    case = from_table(TABLE, "regions")
    assert case.gel == Composite(Gel(1e-3, 0.1), (Elastomer(0.1, 10.0), Gel(4e-3, 0.1)))
    assert [float(region.area()) for region in case.plate.regions] == pytest.approx(
        [np.pi / 4, 6.4]
    )


def test_a_region_has_every_parameter_of_its_gel_as_a_picture(tmp_path):
    Image.fromarray(np.array([[0, 255], [255, 0]], dtype=np.uint8)).save(tmp_path / "warm.png")
    warm = {"temperature": {"file": "warm.png", "low": 25.0, "high": 40.0}}
    case = from_table(
        {"plate": PLATE, "regions": [LAYER | {"gel": warm}], "gel": {"kind": "pnipam"}},
        "regions",
        tmp_path,
    )
    temperature = case.gel.regions[0].temperature
    assert [
        float(temperature(np.array(point))) for point in ((-0.5, -0.5), (0.5, -0.5))
    ] == pytest.approx([40.0, 25.0])


@pytest.mark.parametrize(
    "case", [from_table(TABLE, "regions"), example(regions=True)], ids=["own", "example"]
)
def test_the_text_of_a_case_with_regions_is_that_case(case, tmp_path):
    file = tmp_path / "case.toml"
    file.write_text(case_text(explicit(case)), encoding="utf-8")
    again = load_case(file)
    assert again.gel == case.gel
    for one, other in zip(again.plate.regions, case.plate.regions, strict=True):
        assert type(one) is type(other)
        for name, value in one.theta.items():
            np.testing.assert_array_equal(value, other.theta[name])


@pytest.mark.slow
def test_a_run_with_regions_is_read_drawn_and_resumed(tmp_path, capsys):
    file, out = tmp_path / "case.toml", tmp_path / "out"
    file.write_text(
        case_text(from_table(TABLE | {"output": {"animation": False}}, "case")), encoding="utf-8"
    )
    assert main(["run", str(file), "--out", str(out), "--quiet"]) == 0
    assert {"pattern.png", "gel.png", "states.npz"} <= {path.name for path in out.iterdir()}
    path = load_path(out)
    assert len(path) == 2
    assert sorted(
        set(np.round(np.concatenate([np.ravel(part) for part in path.gel.Nv.points]), 6))
    ) == [1e-3, 4e-3, 0.1]
    assert main(["outline", str(file), "--out", str(tmp_path / "case.svg")]) == 0
    assert (tmp_path / "case.svg").read_text().count("<path") == 3


def test_what_a_map_varies_outside_the_regions_is_kept_with_its_runs():
    """The gel of a region has its own numbers, all of them, once the case is read."""
    case = from_table(TABLE, "regions")
    varied = dataclasses.replace(case, gel=with_matrix(case.gel, chi=0.4))
    assert varied.gel.regions == case.gel.regions
    assert from_table(varied.table(), "again").gel == varied.gel


def test_a_region_in_several_parts_is_drawn(tmp_path):
    legs = Polygon(
        [
            (-0.8, 0.2),
            (-0.3, 0.2),
            (-0.3, 1.5),
            (0.3, 1.5),
            (0.3, 0.2),
            (0.8, 0.2),
            (0.8, 2.0),
            (-0.8, 2.0),
        ]
    )
    plate = Plate(2.0, 2.0, regions=[legs])
    assert (
        write_outline(dry_gel(plate), tmp_path / "legs.svg", regions=dry_regions(plate))
        .read_text()
        .count("<path")
        == 3
    )


def test_a_design_with_a_held_axial_stretch_is_written():
    case = from_table(
        {"plate": PLATE | {"kinematics": "generalised plane strain", "axial_stretch": 1.2}}, "held"
    )
    assert "axial_stretch = 1.2" in case_text(explicit(case))


def test_a_picture_gives_regions_of_one_material(tmp_path):
    pixels = np.full((80, 80), 255, dtype=np.uint8)
    y, x = np.mgrid[:80, :80]
    for centre in ((20, 20), (60, 50)):
        pixels[(x - centre[0]) ** 2 + (y - centre[1]) ** 2 < 100] = 0
    Image.fromarray(pixels).save(tmp_path / "spots.png")
    table = TABLE | {
        "regions": [{"kind": "image", "file": "spots.png", "elastomer": STIFF["elastomer"]}]
    }
    case = from_table(table, "spots", tmp_path)
    assert case.gel.regions == (Elastomer(0.1, 10.0),) * 2
    # half a pixel of ten
    assert [float(region.area()) for region in case.plate.regions] == pytest.approx(
        [np.pi / 16] * 2, rel=0.03
    )


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ([STIFF | {"gel": {}}], "regions[0]: give one of gel and elastomer"),
        ([{"kind": "circle", "centre": [0, 0], "radius": 0.5}], "gel"),
        ([STIFF | {"elastomer": {"Nv": 0.1}}], "regions[0].elastomer: "),
        ([STIFF | {"elastomer": {"Nv": 0.1, "bulk": -1.0}}], "regions[0].elastomer.bulk: -1.0"),
        ([STIFF | {"radius": -1.0}], "regions[0].radius: -1.0"),
        (
            [LAYER | {"gel": {"Nw": 1.0}}],
            "regions[0].gel: unknown gel parameter 'Nw'; did you mean 'Nv'?",
        ),
    ],
)
def test_wrong_entries_are_refused_in_one_line(regions, message):
    with pytest.raises(ValueError) as problem:  # noqa: PT011 — the message is looked at below
        from_table(TABLE | {"regions": regions}, "regions")
    assert message in str(problem.value)
    assert "\n" not in str(problem.value)


def test_a_region_beyond_the_plate_or_across_a_hole_is_refused_by_the_command(tmp_path, capsys):
    for region, words in (
        (STIFF | {"centre": [9.0, 0.0]}, "it lies outside the plate"),
        (STIFF, "their outlines cross or touch"),
    ):
        hole = {"kind": "circle", "centre": [0.5, 0.0], "radius": 0.3}
        file = tmp_path / "case.toml"
        source = from_table(TABLE | {"regions": [region], "holes": [hole]}, "case")
        file.write_text(case_text(source), encoding="utf-8")
        assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 2
        assert words in capsys.readouterr().err
