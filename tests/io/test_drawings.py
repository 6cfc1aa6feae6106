"""Outlines from and to drawings: round trips, and a hole from a file is its curve."""

import warnings

import numpy as np
import pytest
import shapely

import jaxgel
from jaxgel.cases import from_table, load_case
from jaxgel.cli import command_line as cli
from jaxgel.geometry import outline_points
from jaxgel.io import (
    FORMATS,
    DrawingIncomplete,
    dry_gel,
    fit_fourier,
    read_outlines,
    swollen_gel,
    write_outline,
)

CLOVER = jaxgel.Fourier((0.5, -0.3), 2.0, [0.1, 0.05], [-0.05, 0.02])


def ring(hole, n=400):
    return np.asarray(outline_points(hole, np.arange(n) / n))


@pytest.fixture(scope="module")
def plate():
    return jaxgel.Plate(12, 8, [CLOVER, jaxgel.Rectangle((-4.0, 0.0), (2.0, 3.0), 0.2)], name="two")


def test_fourier_fit_finds_the_outline_it_was_drawn_from():
    """400 chords of a curve of radius 2 are off by 2 (pi / 400)^2 / 2 = 6e-5 mm.

    The parameters by about as much.
    """
    found = fit_fourier(ring(CLOVER), 1e-3)
    assert len(found.cos) == 2
    np.testing.assert_allclose(found.centre, CLOVER.centre, atol=1e-4)
    np.testing.assert_allclose(found.radius, 2.0, atol=1e-4)
    np.testing.assert_allclose(
        np.append(found.cos, found.sin), np.append(CLOVER.cos, CLOVER.sin), atol=1e-4
    )


@pytest.mark.parametrize("kind", ["dxf", "svg"])
def test_drawing_of_a_plate_is_read_back(plate, kind, tmp_path):
    """To the digits written, 1e-6 mm, and in millimetres."""
    gel = dry_gel(plate)
    found = read_outlines(write_outline(gel, tmp_path / f"two.{kind}"))
    read = shapely.Polygon(found[0], found[1:])
    assert read.area == pytest.approx(gel.area, rel=1e-6)
    assert shapely.hausdorff_distance(read, gel) < 2e-6
    assert read.area == pytest.approx(12 * 8 - float(CLOVER.area()) - 6.0, rel=1e-4)  # 720 chords


def test_curves_of_a_drawing_are_followed(tmp_path):
    """A circle and a spline-like path in SVG, an ellipse and a circle in DXF.

    The y axis of SVG points down.
    """
    svg = (
        '<svg xmlns="http://www.w3.org/2000/svg"><g transform="translate(1,2)"><circle cx="0" '
        'cy="0" r="3"/></g></svg>'
    )
    (tmp_path / "c.svg").write_text(svg)
    (circle,) = read_outlines(tmp_path / "c.svg")
    np.testing.assert_allclose(np.hypot(circle[:, 0] - 1, circle[:, 1] + 2), 3.0, atol=1e-6)
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new(units=ezdxf.units.CM)
    document.modelspace().add_ellipse((0, 0), major_axis=(0.4, 0), ratio=0.5)
    document.modelspace().add_text("not an outline")
    document.modelspace().add_line((0, 0), (1, 1))
    document.saveas(tmp_path / "e.dxf")
    with pytest.warns(
        DrawingIncomplete,
        match=r"without 1 TEXT on layer '0' \(no outline\), 1 LINE on layer '0' \(not closed\)$",
    ):
        (ellipse,) = read_outlines(tmp_path / "e.dxf")
    # centimetres became millimetres; chords
    assert shapely.Polygon(ellipse).area == pytest.approx(np.pi * 4 * 2, rel=1e-3)
    np.testing.assert_allclose((ellipse[:, 0] / 4) ** 2 + (ellipse[:, 1] / 2) ** 2, 1.0, atol=1e-6)


def test_solid_is_closed_and_has_the_volume_of_the_gel(plate, tmp_path):
    gel = dry_gel(plate)
    content = write_outline(gel, tmp_path / "two.stl", height=2.5).read_bytes()
    records = np.frombuffer(
        content[84:], dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    assert len(records) == np.frombuffer(content[80:84], "<u4")[0]
    corners = records["corners"].astype(float)
    volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(2.5 * gel.area, rel=1e-5)  # single precision
    names = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    directed = np.concatenate([names[:, [0, 1]], names[:, [1, 2]], names[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed)  # no edge twice in one direction
    # and each one in both
    assert {tuple(e) for e in directed.tolist()} == {tuple(e[::-1]) for e in directed.tolist()}


def test_hole_from_a_file_becomes_numbers_of_the_case(tmp_path):
    """The case then needs the file no more, and a run's folder can be read without it."""
    np.savetxt(tmp_path / "clover.csv", ring(CLOVER), delimiter=",", header="x,y", comments="")
    case = tmp_path / "case.toml"
    text = (
        "[plate]\nwidth = 12.0\nheight = 8.0\n[[holes]]\nkind = 'outline'\nfile = 'clover.csv'\n"
        "scale = 0.5\ncentre = [1.0, 0.0]\n"
    )
    case.write_text(text)
    hole = load_case(case).plate.holes[0]
    assert isinstance(hole, jaxgel.Fourier)
    assert float(hole.area()) == pytest.approx(float(CLOVER.area()) / 4, rel=1e-3)
    assert load_case(case).table()["holes"][0]["kind"] == "fourier"
    case.write_text(text + "fit = 'polygon'\ntolerance = 0.02\n")
    polygon = load_case(case).plate.holes[0]
    assert float(polygon.area()) == pytest.approx(float(CLOVER.area()) / 4, rel=0.02)
    assert len(polygon.vertices) < 40
    np.testing.assert_allclose(
        shapely.Polygon(polygon.vertices).centroid.coords[0], [1.0, 0.0], atol=0.02
    )


def test_drawing_that_cannot_be_used_is_refused_in_one_line(tmp_path, refused):
    def attempt(name, content, entries):
        (tmp_path / name).write_text(content)
        lines = "".join(f"{key} = {value!r}\n" for key, value in entries.items())
        (tmp_path / "case.toml").write_text(
            f"[plate]\nwidth = 9.0\nheight = 9.0\n[[holes]]\nkind = 'outline'\nfile = '{name}'\n"
            f"{lines}"
        )
        load_case(tmp_path / "case.toml")

    refused(
        attempt,
        [
            ("a.png", "", {}, r"^file: '.*a.png' is not a .csv, .dxf or .svg file$"),
            (
                "a.csv",
                "1,2\n3\n",
                {},
                (
                    "^file: .* is no drawing that can be read: row 2: number of columns 1; give "
                    "two columns x and y, .*$"
                ),
            ),
            ("a.svg", "<svg", {}, "^file: .* is no drawing that can be read: "),
            ("a.dxf", "rubbish", {}, "^file: cannot read .*a.dxf.* is not a DXF file.$"),
            (
                "a.csv",
                "0,0\n2,0\n2,2\n0,2\n",
                {"number": 1},
                r"^holes\[0\].number: 1 is not one of the 1 closed outlines of 'a.csv'",
            ),
            (
                "a.csv",
                "0,0\n2,0\n2,2\n0,2\n",
                {"fit": "spline"},
                r"^holes\[0\].fit: 'spline' is unknown; accepted: fourier, polygon$",
            ),
            (
                "a.csv",
                "0,0\n2,0\n2,2\n0,2\n",
                {"tolerance": 1e-3},
                r"^holes\[0\].fit: 24 terms miss the outline by .*fit = 'polygon'$",
            ),
            (
                "a.csv",
                "0,0\n2,2\n2,0\n0,2\n",
                {},
                r"^holes\[0\].file: outline 0 of 'a.csv' crosses itself or has no area$",
            ),
        ],
    )


def test_outline_in_a_study_says_where_it_belongs():
    with pytest.raises(
        ValueError,
        match=r"^holes\[0\].kind: 'outline' belongs in a case file; name that file by case = ",
    ):
        from_table(
            {
                "plate": {"width": 2.0, "height": 1.0},
                "holes": [{"kind": "outline", "file": "a.csv"}],
            },
            "study",
        )


CUT = (
    "[plate]\nwidth = 4.0\nheight = 4.0\n[[holes]]\nkind = 'rectangle'\ncentre = [0.0, 0.0]\n"
    "sides = [5.0, 0.5]\n"
)


@pytest.mark.parametrize("kind", FORMATS)
def test_plate_in_two_parts_is_refused_by_the_command(kind, tmp_path, capsys):
    """In the words of a run, and no file is written."""
    (tmp_path / "cut.toml").write_text(CUT)
    assert (
        cli.main(
            [
                "outline",
                str(tmp_path / "cut.toml"),
                "--format",
                kind,
                "--out",
                str(tmp_path / f"cut.{kind}"),
            ]
        )
        == 2
    )
    assert (
        capsys.readouterr().err
        == "jaxgel: error: holes: they cut the plate into 2 parts; leave one connected piece\n"
    )
    assert not (tmp_path / f"cut.{kind}").exists()


def test_polygons_of_several_parts_are_written_whole(tmp_path):
    """Two squares, one with a hole: outlines, and the volume of the solid."""
    gel = shapely.union_all(
        [shapely.box(0, 0, 3, 3) - shapely.box(1, 1, 2, 2), shapely.box(5, 0, 6, 1)]
    )
    for kind in ("dxf", "svg"):
        areas = sorted(
            shapely.Polygon(line).area
            for line in read_outlines(write_outline(gel, tmp_path / f"a.{kind}"))
        )
        assert areas == pytest.approx([1, 1, 9])
    content = write_outline(gel, tmp_path / "a.stl", height=2.0).read_bytes()
    records = np.frombuffer(
        content[84:], dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    a, b, c = np.moveaxis(records["corners"].astype(float), 1, 0)
    assert np.einsum("ti,ti->", a, np.cross(b, c)) / 6 == pytest.approx(2.0 * gel.area)


def test_command_tells_what_was_left_out_of_a_drawing_in_one_line(tmp_path, capsys):
    """Once for two holes of one file, and without a place in the source."""
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new(units=ezdxf.units.MM)
    document.modelspace().add_circle((0, 0), 1)
    document.modelspace().add_line((0, 0), (1, 0))
    document.saveas(tmp_path / "a.dxf")
    holes = "".join(
        f"[[holes]]\nkind = 'outline'\nfile = 'a.dxf'\ncentre = [{x}, 0.0]\n" for x in (-2.0, 2.0)
    )
    (tmp_path / "case.toml").write_text(f"[plate]\nwidth = 9.0\nheight = 9.0\n{holes}")
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert (
            cli.main(["outline", str(tmp_path / "case.toml"), "--out", str(tmp_path / "plate.svg")])
            == 0
        )
    text = f"file: {str(tmp_path / 'a.dxf')!r} is read without 1 LINE on layer '0' (not closed)"
    assert capsys.readouterr().err == f"jaxgel: warning: {text}\n"


@pytest.mark.parametrize("offset", [0.0, 4e5])
def test_first_and_last_point_are_compared_relative_to_the_shape(offset, tmp_path):
    """A square of 4 mm keeps its corners far from the origin, and loses a repeated point."""
    square = np.array([(0, 0), (4, 0), (4, 4), (0, 4)]) + offset
    for name, points in {"open": square, "closed": [*square, square[0]]}.items():
        np.savetxt(tmp_path / f"{name}.csv", points, delimiter=",")
        (outline,) = read_outlines(tmp_path / f"{name}.csv")
        np.testing.assert_array_equal(outline, square)


def test_command_writes_dry_and_swollen_outlines(path, run_folder, tmp_path, capsys):
    assert (
        cli.main(["outline", "sample-1", "--format", "svg", "--out", str(tmp_path / "dry.svg")])
        == 0
    )
    assert (
        cli.main(["outline", str(run_folder), "--mu", "-0.92", "--out", str(tmp_path / "wet.dxf")])
        == 0
    )
    assert capsys.readouterr().out.split() == [str(tmp_path / "dry.svg"), str(tmp_path / "wet.dxf")]
    wet = read_outlines(tmp_path / "wet.dxf")
    assert len(wet) == 5
    holes = sum(shapely.Polygon(line).area for line in wet[1:])
    assert holes == pytest.approx(
        80 * np.pi * (1 - float(jaxgel.area_reduction(path)[-1])), rel=1e-3
    )
    assert swollen_gel(path, -1).area == pytest.approx(22**2 - holes, rel=1e-9)
    assert cli.main(["outline", "sample-1", "--mu", "-1"]) == 2
    capsys.readouterr()
    assert (
        cli.main(
            ["outline", str(run_folder), "--mu", "-0.5", "--out", str(tmp_path / "beyond.dxf")]
        )
        == 2
    )
    assert "mu: -0.5 is beyond the path, which runs from" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["svg", "dxf"])
@pytest.mark.parametrize("size", [4e-3, 4e3])
def test_drawings_have_significant_digits_for_plates_of_any_size(kind, size, tmp_path):
    gel = dry_gel(jaxgel.Plate(size, size, [jaxgel.Circle((0.1 * size, 0), 0.25 * size)]))
    lines = read_outlines(write_outline(gel, tmp_path / f"gel.{kind}"))
    areas = sorted(shapely.Polygon(line).area for line in lines)
    assert areas[1] - areas[0] == pytest.approx(gel.area, rel=1e-6)
