"""Grey pictures as parameters of the gel in case files, and films of samples."""

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxgel
from jaxgel.cases import from_table, load_case, load_path
from jaxgel.cli import main
from jaxgel.io import read_outlines, write_mask

PLATE = "[plate]\nwidth = 4.0\nheight = 2.0\nedges = { top = 'free' }\n"
OPTIONS = (
    "[sweep]\nmu = [-3.0, -2.0]\n[discretisation]\nspacing = 0.5\n[output]\nanimation = false\n"
)
GREY = np.array([[0, 51, 102, 153], [255, 204, 255, 204]], dtype=np.uint8)


@pytest.fixture
def case(tmp_path):
    """Function: the gel's entries, and what stands before -> case of a file by ``mask.png``."""
    Image.fromarray(GREY).save(tmp_path / "mask.png")
    Image.new("RGB", (4, 2)).save(tmp_path / "colour.png")
    Image.new("L", (4, 4)).save(tmp_path / "square.png")
    (tmp_path / "text.png").write_text("no picture")

    def load(gel, plate=PLATE):
        (tmp_path / "case.toml").write_text(f"{plate}[gel]\n{gel}\n{OPTIONS}")
        return load_case(tmp_path / "case.toml")

    return load


def test_a_picture_is_read_from_its_top_with_black_low(case):
    """At pixel centres the values are the picture's, and the case's table holds its pixels."""
    found = case('Nv = { file = "mask.png", low = 1e-3, high = 2e-3 }')
    assert [
        float(found.gel.Nv(jnp.array([x, 0.5]))) for x in (-1.5, -0.5, 0.5, 1.5)
    ] == pytest.approx([1e-3, 1.2e-3, 1.4e-3, 1.6e-3])
    assert [float(found.gel.Nv(jnp.array([x, -0.5]))) for x in (-1.5, -0.5)] == pytest.approx(
        [2e-3, 1.8e-3]
    )
    assert found.table()["gel"] == {
        "Nv": {"low": 1e-3, "high": 2e-3, "pixels": GREY.tolist()},
        "chi": found.gel.chi,
    }


def test_a_picture_moves_with_holes_if_asked(case):
    assert isinstance(
        case('chi = { file = "mask.png", low = 0.1, high = 0.2, with_holes = true }').gel.chi,
        jaxgel.WithHoles,
    )


def test_a_picture_that_cannot_be_used_is_refused_in_one_line(case, refused):
    refused(
        case,
        [
            (
                'Nv = { file = "colour.png", low = 1e-3, high = 2e-3 }',
                r"^gel\.Nv\.file: 'colour\.png' is a picture of mode RGB, it must be",
            ),
            (
                'Nv = { file = "square.png", low = 1e-3, high = 2e-3 }',
                r"^gel\.Nv: a picture of 4 x 4 pixels does not cover a plate of 4 x 2",
            ),
            (
                'Nv = { file = "text.png", low = 1e-3, high = 2e-3 }',
                r"^gel\.Nv\.file: 'text\.png' cannot be read as a picture: ",
            ),
            (
                'Nv = { file = "none.png", low = 1e-3, high = 2e-3 }',
                r"^gel\.Nv\.file: 'none\.png' cannot be read as a picture: .*No such file",
            ),
            (
                'Nv = { file = "mask.png", low = 0, high = 2e-3 }',
                r"^gel\.Nv\.low: 0 is not accepted, it must be a finite number > 0$",
            ),
            (
                'chi = { file = "mask.png", low = 0.1, high = 2 }',
                r"^gel\.chi\.high: 2 is not accepted, it must be a finite number < 2",
            ),
            ('Nv = { file = "mask.png", low = 1e-3 }', r"gel\.Nv: high is missing"),
            ("Nv = { low = 1e-3, high = 2e-3 }", r"gel\.Nv: .*file.*pixels"),
            (
                "Nv = { pixels = [[0, 1, 2, 3], [0, 1]], low = 1e-3, high = 2e-3 }",
                r"^gel\.Nv\.pixels: rows of 2 to 4 pixels",
            ),
            (
                "Nv = { pixels = [[0, 256]], low = 1e-3, high = 2e-3 }",
                r"gel\.Nv\.pixels\[0\]\[1\]: 256 is not a whole number",
            ),
        ],
    )


@pytest.mark.slow
def test_a_run_with_a_picture_needs_no_other_file_than_the_energy_of_ones_own(
    case, tmp_path, monkeypatch, capsys
):
    """The folder is read where the energy's module is, without the picture.

    Its figures show the parameter on the dry plate.
    """
    code = (
        "import jaxgel\n\ndef gent(Nv, chi, Jm):\n"
        "    return jaxgel.Gel(Nv, chi, network=jaxgel.Gent(Jm))\n"
    )
    (tmp_path / "stiff_print.py").write_text(code)
    case(
        'energy = "stiff_print:gent"\nJm = 30.0\n'
        'Nv = { file = "mask.png", low = 1e-3, high = 2e-3 }'
    )
    assert (
        main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "run"), "--quiet"]) == 0
    )
    (tmp_path / "mask.png").unlink()
    assert (tmp_path / "run" / "gel.png").is_file()
    assert "Nv" in (tmp_path / "run" / "vtu" / "state-0000.vtu").read_bytes().decode(
        errors="replace"
    )
    assert main(["resume", str(tmp_path / "run"), "--no-plots"]) == 2
    assert "gel.energy: 'stiff_print:gent': cannot import" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    assert main(["resume", str(tmp_path / "run"), "--no-plots", "--quiet"]) == 0
    path = load_path(tmp_path / "run")
    assert len(path) == 2 and path.gel.network.Jm == 30.0
    values = jaxgel.observables.parameter_values(path)["Nv"]
    assert values.shape == (path.model.n_cells,)
    assert 1e-3 <= float(values.min()) < 1.2e-3 < 1.8e-3 < float(values.max()) <= 2e-3


def test_a_sample_may_be_a_film(tmp_path):
    (tmp_path / "film.toml").write_text(
        '[plate]\nsample = "sample-1"\nkinematics = "plane stress"\n'
    )
    found = load_case(tmp_path / "film.toml")
    assert found.plate.kinematics == "plane stress"
    assert len(found.plate.holes) == 4


def grey_of(file):
    with Image.open(file) as picture:
        return np.asarray(picture), np.array(picture.size) / picture.info["dpi"] * 25.4


def test_a_printed_gel_is_written_as_an_outline_and_masks_of_one_scale(case, tmp_path, capsys):
    """At its own scale the picture comes back; the DXF file is as large as it."""
    case(
        'Nv = { file = "mask.png", low = 1e-3, high = 2e-3 }\n'
        "chi = { pixels = [[0, 255]], low = 0.3, high = 0.2 }"
    )
    assert (
        main(
            [
                "outline",
                str(tmp_path / "case.toml"),
                "--pixels-per-mm",
                "1",
                "--out",
                str(tmp_path / "plate.dxf"),
            ]
        )
        == 0
    )
    files = [tmp_path / name for name in ("plate.dxf", "plate-Nv.png", "plate-chi.png")]
    assert capsys.readouterr().out.split() == [str(file) for file in files]
    pixels, size = grey_of(files[1])
    np.testing.assert_array_equal(pixels, GREY)
    np.testing.assert_allclose(size, (4, 2), rtol=1e-4)
    # between two pixels of 2 mm
    np.testing.assert_array_equal(grey_of(files[2])[0], [[0, 64, 191, 255]] * 2)
    (outline,) = read_outlines(files[0])
    np.testing.assert_allclose(np.ptp(outline, axis=0), (4, 2))


@pytest.mark.thorough
def test_any_field_is_written_at_the_centres_of_the_pixels(tmp_path, tiny_model):
    """A function, and one by its values at nodes, black where that has none."""
    plane = lambda X: 1.0 + 0.1 * X[..., 0] - 0.2 * X[..., 1]  # noqa: E731
    y, x = np.meshgrid(1.5 - np.arange(4), np.arange(4) - 1.5, indexing="ij")
    exact = np.rint(255 * (1.0 + 0.1 * x - 0.2 * y) / 2)
    ends = {"low": 0.0, "high": 2.0, "pixels_per_mm": 1.0}
    np.testing.assert_array_equal(
        grey_of(write_mask(plane, (4.0, 4.0), tmp_path / "a.png", **ends))[0], exact
    )
    nodal = jaxgel.NodalField(plane(tiny_model.cloud.nodes), tiny_model)
    np.testing.assert_array_equal(
        grey_of(write_mask(nodal, (4.0, 4.0), tmp_path / "b.png", **ends))[0], exact
    )
    far = grey_of(write_mask(nodal, (16.0, 16.0), tmp_path / "c.png", **ends))[0]
    assert far[0].max() == 0


def test_a_mask_that_moves_with_a_hole_is_written_where_the_material_is(case, tmp_path):
    """The field moves with the outline: a step of Nv through the hole's centre moved with it.

    What was beside the outline is beside the moved one.
    """
    hole = "[[holes]]\nkind = 'circle'\ncentre = [{}, 0.0]\nradius = 0.6\n"
    moved = "[[moved]]\ncentre = [0.3, 0.0]\n"
    mask = (
        "Nv = { pixels = [[0, 0, 255, 255], [0, 0, 255, 255]], low = 1e-3, high = 2e-3, "
        "with_holes = true }"
    )
    case(mask, PLATE + hole.format(0.0) + moved)
    assert (
        main(
            [
                "outline",
                str(tmp_path / "case.toml"),
                "--pixels-per-mm",
                "50",
                "--out",
                str(tmp_path / "a.svg"),
            ]
        )
        == 0
    )
    pixels, _ = grey_of(tmp_path / "a-Nv.png")
    above = pixels[50 - 32]  # y = 0.63 mm, just above the hole
    half = (np.flatnonzero(above > 127)[0] + 0.5) / 50 - 2
    # two pixels: the material above the hole moves nearly as far
    assert half == pytest.approx(0.3, abs=0.04)


def test_a_sample_may_be_in_generalised_plane_strain(tmp_path):
    (tmp_path / "case.toml").write_text(
        '[plate]\nsample = "sample-1"\nkinematics = "generalised plane strain"\n'
        "axial_stretch = 1.05\n"
    )
    found = load_case(tmp_path / "case.toml")
    assert found.plate.kinematics == "generalised plane strain"
    assert found.plate.axial_stretch == 1.05
    assert from_table(found.table(), "again").plate.axial_stretch == 1.05


@pytest.mark.parametrize(
    "entry",
    ["", *(f"axial_stretch = {wrong}" for wrong in ("0", "-1.0", '"free"', "true", "[1.0]"))],
)
def test_wrong_axial_stretches_are_refused_in_one_line(tmp_path, entry):
    (tmp_path / "case.toml").write_text(
        f'[plate]\nsample = "sample-1"\nkinematics = "generalised plane strain"\n{entry}\n'
    )
    with pytest.raises(
        ValueError,
        match=r"^plate\.axial_stretch: [^\n]*$"
        if entry
        else r"^axial_stretch: is missing; [^\n]*$",
    ):
        load_case(tmp_path / "case.toml")
