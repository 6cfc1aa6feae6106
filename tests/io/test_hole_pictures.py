"""Holes from pictures: discs and edges in closed form, refusals, written and read again."""

import dataclasses

import numpy as np
import pytest
import shapely
from PIL import Image

import jaxgel
from jaxgel.cases import from_table, load_case
from jaxgel.cli import command_line as cli
from jaxgel.geometry import check_plate
from jaxgel.io import dry_gel, write_outline

WIDTH, HEIGHT, PER_MM = 20.0, 12.0, 10  # of the plate, mm
PIXEL = 1 / PER_MM
LEFT, RIGHT = ((-4.3, 2.1), 3.0), ((5.6, -1.4), 2.2)  # centre and radius, mm
Y, X = np.meshgrid(
    HEIGHT / 2 - PIXEL * (np.arange(120) + 0.5),
    PIXEL * (np.arange(200) + 0.5) - WIDTH / 2,
    indexing="ij",
)


def distance(circle):
    """Of the pixels' centres from a circle, mm, negative inside."""
    (x, y), radius = circle
    return np.hypot(X - x, Y - y) - radius


def grey(*distances):
    """A picture with smooth edges, black inside: half grey where the distance is 0."""
    return np.rint(255 * np.clip(0.5 + np.min(distances, axis=0) / PIXEL, 0, 1)).astype(np.uint8)


def black_and_white(*distances):
    return np.where(np.min(distances, axis=0) < 0, 0, 255).astype(np.uint8)


@pytest.fixture
def case(tmp_path):
    """Function: a picture and further entries -> the case of a plate whose holes are in it."""

    def load(picture, entries="", size=(WIDTH, HEIGHT)):
        image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
        image.save(tmp_path / "holes.png")
        text = (
            f"[plate]\nwidth = {size[0]}\nheight = {size[1]}\n[[holes]]\nkind = 'image'\n"
            f"file = 'holes.png'\n{entries}\n"
        )
        (tmp_path / "case.toml").write_text(text)
        return load_case(tmp_path / "case.toml")

    return load


@pytest.mark.parametrize(("draw", "off"), [(grey, 0.05), (black_and_white, 0.25)])
def test_drawn_circles_are_found_where_they_are(case, draw, off):
    """From the top, left to right.

    ``off`` in pixels: a black and white edge is known to half a pixel, its mean over a circle
    better.
    """
    plate = case(draw(distance(LEFT), distance(RIGHT))).plate
    for hole, (centre, radius) in zip(plate.holes, (LEFT, RIGHT), strict=True):
        assert isinstance(hole, jaxgel.Fourier)
        assert len(hole.cos) == 1
        assert np.hypot(*(hole.centre - np.array(centre))) < off * PIXEL
        assert float(hole.area()) == pytest.approx(
            np.pi * radius**2, abs=2 * np.pi * radius * off * PIXEL
        )


@pytest.mark.parametrize("tolerance", [0.05, 0.3])
def test_polygons_stay_within_the_tolerance(case, tolerance):
    """Of the circle, to a twentieth of a pixel: that of the outline between smooth pixels.

    Light holes are those of the negative.
    """
    plate = case(
        255 - grey(distance(LEFT)), f"shade = 'light'\nfit = 'polygon'\ntolerance = {tolerance}"
    ).plate
    (hole,) = plate.holes
    circle = shapely.Point(LEFT[0]).buffer(LEFT[1], quad_segs=256)
    found = shapely.Polygon(np.asarray(hole.vertices))
    assert (
        shapely.hausdorff_distance(found.exterior, circle.exterior.segmentize(0.01))
        < tolerance + 0.1 * PIXEL
    )
    # a regular one with that sagitta has a third
    assert len(hole.vertices) < 3 * np.pi / np.sqrt(2 * tolerance / LEFT[1])


def test_a_fit_that_misses_the_tolerance_is_refused(case):
    with pytest.raises(
        ValueError,
        match=(
            r"^holes\[0\]\.fit: 'holes\.png', hole at .*: 24 terms miss the outline by .*fit = "
            r"'polygon'$"
        ),
    ):
        case(black_and_white(np.maximum(abs(X) - 4, abs(Y) - 2)), "tolerance = 0.05")


def test_polygons_may_be_cut_by_the_edges_of_the_plate(case):
    """Half a disc at the right edge and a strip in the lower left corner give their gel."""
    half, corner = distance(((WIDTH / 2, 1.0), 2.0)), np.maximum(X + 8.0, Y + 4.5)
    plate = case(grey(half, corner), "fit = 'polygon'").plate
    check_plate(plate)
    area = WIDTH * HEIGHT - np.pi * 2.0**2 / 2 - 2.0 * 1.5
    # the tolerance along the outline
    assert dry_gel(plate).area == pytest.approx(area, abs=0.75 * PIXEL * (2 * np.pi + 3.5))
    with pytest.raises(
        ValueError,
        match=(
            r"^holes\[0\]\.fit: the edge of 'holes\.png' cuts the hole at \(.*\) mm; take fit = "
            r"'polygon'$"
        ),
    ):
        case(grey(half))


@pytest.mark.parametrize(
    ("picture", "entries", "message"),
    [
        (
            Image.new("RGB", (200, 120)),
            "",
            (
                r"\.file: 'holes\.png' is a picture of mode RGB, it must be black and white or "
                r"8-bit grey"
            ),
        ),
        (
            Image.new("L", (200, 120), 255),
            "",
            r"\.file: 'holes\.png' has no hole: grey values from 255 to 255 do not cross half grey",
        ),
        (
            Image.new("1", (200, 120)),
            "",
            r"\.file: 'holes\.png' has no hole: grey values from 0 to 0 do not cross half grey",
        ),
        (
            black_and_white(distance(LEFT), distance(((0.05, 0.05), 0.08))),
            "",
            r"\.file: .* dark speck of 0\.5 pixels at \(.*\) mm, .* 8",
        ),
        (
            black_and_white(np.abs(distance(LEFT)) - 0.5),
            "",
            r"\.file: 'holes\.png' has gel inside the hole at \(-4\.3, 2\.1\) mm; ",
        ),
        (
            black_and_white(distance(LEFT))[:, :100],
            "",
            r": a picture of 100 x 120 pixels does not cover a plate of 20 x 12 with square",
        ),
        (
            black_and_white(distance(LEFT)),
            "tolerance = 2.0",
            r"\.tolerance: 2 mm is more than a tenth of the plate's shorter side, 12 mm",
        ),
        (
            black_and_white(distance(LEFT)),
            "shade = 'grey'",
            r"\.shade: 'grey' is unknown; .*dark, light",
        ),
        (black_and_white(distance(LEFT)), "number = 1", r": unknown entry 'number'; "),
    ],
)
def test_a_picture_that_cannot_be_used_is_refused_in_one_line(case, picture, entries, message):
    with pytest.raises(ValueError, match=rf"^holes\[0\]{message}") as problem:
        case(picture, entries)
    assert "\n" not in str(problem.value)


def test_a_case_keeps_the_numbers_and_stands_beside_other_holes(case, tmp_path):
    found = case(
        grey(distance(LEFT), distance(RIGHT)),
        "[[holes]]\nkind = 'circle'\ncentre = [0.0, -4.0]\nradius = 1.0",
    )
    (tmp_path / "holes.png").unlink()
    assert [hole["kind"] for hole in found.table()["holes"]] == ["fourier", "fourier", "circle"]
    assert len(from_table(found.table(), "again").plate.holes) == 3
    with pytest.raises(ValueError, match=r"^holes\[0\]\.kind: 'image' belongs in a case file; "):
        from_table(
            {"plate": {"width": 2.0, "height": 1.0}, "holes": [{"kind": "image", "file": "a.png"}]},
            "study",
        )
    with pytest.raises(
        ValueError, match=r"^holes: plate\.sample = 'square' has its own; drop one of the two$"
    ):
        from_table(
            {"plate": {"sample": "square"}, "holes": [{"kind": "image", "file": "a.png"}]},
            "case",
            tmp_path,
        )


def test_holes_that_are_written_are_read_again(tmp_path, capsys):
    """A case's picture read as its holes: outlines to a tenth of a pixel and the tolerance."""
    plate = jaxgel.Plate(
        WIDTH,
        HEIGHT,
        [
            jaxgel.Ellipse(LEFT[0], (3.0, 2.0), 0.4),
            jaxgel.Fourier(RIGHT[0], 2.0, [0.1, 0.05], [0.0, 0.1]),
        ],
    )
    holes = [
        {"kind": type(hole).__name__.lower()}
        | {name: np.asarray(value).tolist() for name, value in hole.theta.items()}
        for hole in plate.holes
    ]
    lines = "".join(
        "[[holes]]\n" + "".join(f"{key} = {value!r}\n" for key, value in hole.items())
        for hole in holes
    )
    (tmp_path / "case.toml").write_text(f"[plate]\nwidth = {WIDTH}\nheight = {HEIGHT}\n{lines}")
    file = tmp_path / "holes.png"
    assert (
        cli.main(
            [
                "outline",
                str(tmp_path / "case.toml"),
                "--format",
                "png",
                "--pixels-per-mm",
                "25",
                "--out",
                str(file),
            ]
        )
        == 0
    )
    assert capsys.readouterr().out.split() == [str(file)]
    with Image.open(file) as picture:
        assert picture.size == (500, 300)
        np.testing.assert_allclose(
            np.array(picture.size) / picture.info["dpi"] * 25.4, (WIDTH, HEIGHT), rtol=1e-4
        )
    entries = "kind = 'image'\nfile = 'holes.png'\nfit = 'polygon'\ntolerance = 1e-3"
    (tmp_path / "again.toml").write_text(
        f"[plate]\nwidth = {WIDTH}\nheight = {HEIGHT}\n[[holes]]\n{entries}\n"
    )
    assert (
        cli.main(["outline", str(tmp_path / "again.toml"), "--format", "png", "--out", str(file)])
        == 2
    )
    assert (
        capsys.readouterr().err
        == f"jaxgel: error: --out: '{file}' is a file that the case reads; give another name\n"
    )
    again = load_case(tmp_path / "again.toml").plate
    assert shapely.hausdorff_distance(dry_gel(again), dry_gel(plate)) < 0.1 / 25 + 1e-3
    assert dry_gel(again).area == pytest.approx(dry_gel(plate).area, rel=1e-4)


def test_a_picture_has_a_round_scale_and_a_bounded_number_of_pixels(tmp_path):
    gel = dry_gel(dataclasses.replace(jaxgel.sample("sample-1"), holes=()))
    with Image.open(write_outline(gel, tmp_path / "plate.png")) as picture:
        assert picture.size == (1100, 1100)  # 50 to a mm
        assert np.asarray(picture).min() == 255
    for scale in (1e3, 1e-3):
        with pytest.raises(
            ValueError,
            match=(
                r"^pixels_per_mm: .* gives 22 x 22 mm in .* pixels, there must be at least 1 and "
                r"at most"
            ),
        ):
            write_outline(gel, tmp_path / "plate.png", pixels_per_mm=scale)
