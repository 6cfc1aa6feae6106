"""Lists of points by spreadsheets, pandas, NumPy and MATLAB: outlines, or refused rows.

A refusal names the row.
"""

import codecs
from collections import Counter

import numpy as np
import pytest
import shapely

from jaxgel.cases import load_case
from jaxgel.io import read_outlines
from jaxgel.io.drawing import Omission
from jaxgel.io.point_lists import read_points

HOUSE = [(0, 0), (2, 0), (2, 1), (1, 2), (0, 1)]  # an area of 3
TENT = [(5, 5), (9, 5), (7, 9)]  # an area of 8


def rows(points, separator=",", before=""):
    return "".join(f"{before}{x}{separator}{y}\n" for x, y in points)


def read(content, folder):
    file = folder / "points.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_points(file)


TAKEN = {  # content: areas
    "commas": (rows(HOUSE), [3]),
    "commas and blanks": (rows(HOUSE, ", "), [3]),
    "semicolons": (rows(HOUSE, ";"), [3]),
    "tabs": (rows(HOUSE, "\t"), [3]),
    "spaces": (rows(HOUSE, "   ", before=" "), [3]),
    "quotes": ("".join(f'"{x}","{y}"\n' for x, y in HOUSE), [3]),
    "exponents": ("".join(f"{x:.3e},{y:+.3e}\n" for x, y in HOUSE), [3]),
    "byte order mark": (codecs.BOM_UTF8 + rows(HOUSE).encode(), [3]),
    "byte order mark before names": (codecs.BOM_UTF8 + b"x,y\n" + rows(HOUSE).encode(), [3]),
    "UTF-16": (rows(HOUSE, "\t").encode("utf-16"), [3]),
    "lines of Windows": (rows(HOUSE).replace("\n", "\r\n"), [3]),
    "names": ("x,y\n" + rows(HOUSE), [3]),
    "names in another order": ("Y,X\n" + rows([p[::-1] for p in HOUSE]), [3]),
    "names with units": ("X (mm);Y (mm)\n" + rows(HOUSE, ";"), [3]),
    "names with units between spaces": ("x [mm] y [mm]\n" + rows(HOUSE, " "), [3]),
    "centimetres": ("x_cm,y_cm\n" + rows(HOUSE), [300]),
    "micrometres": ("x / µm\ty / µm\n" + rows(HOUSE, "\t"), [3e-6]),
    "coordinates": ("x-coordinate,y-coordinate\n" + rows(HOUSE), [3]),
    "index of pandas": (
        ",x,y\n" + "".join(f"{k},{x},{y}\n" for k, (x, y) in enumerate(HOUSE)),
        [3],
    ),
    "index after the points": (
        "x,y,n\n" + "".join(f"{x},{y},{k}\n" for k, (x, y) in enumerate(HOUSE)),
        [3],
    ),
    "id of the points": (
        "id,y,x\n" + "".join(f"{k},{y},{x}\n" for k, (x, y) in enumerate(HOUSE)),
        [3],
    ),
    "name of the shapes": (
        "shape,x,y\n" + rows(HOUSE, before="house,") + rows(TENT, before="tent,"),
        [3, 8],
    ),
    "one name of all": ("part,x,y\n" + rows(HOUSE, before="1,"), [3]),
    "blank row": (rows(HOUSE) + "\n" + rows(TENT), [3, 8]),
    "blank rows and comments": (
        "# house\n" + rows(HOUSE) + "\n\n# tent\n" + rows(TENT) + "\n",
        [3, 8],
    ),
    "blank row of a spreadsheet": ("x,y\n" + rows(HOUSE) + ",\n" + rows(TENT) + ",,\n", [3, 8]),
    "row of nan": (rows(HOUSE) + "NaN,NaN\n" + rows(TENT), [3, 8]),
    "names of each shape": ("x,y\n" + rows(HOUSE) + "\nx,y\n" + rows(TENT), [3, 8]),
    "blank row after each": (rows(HOUSE).replace("\n", "\n\n"), [3]),
    "comments of MATLAB": ("% house\n" + rows(HOUSE, " "), [3]),
    "names in a comment": ("# y x\n" + rows([p[::-1] for p in HOUSE], " "), [3]),
    "separator of Excel": ("sep=;\n" + rows(HOUSE, ";"), [3]),
}

REFUSED = {
    "nothing": ("", "it has no points"),
    "names alone": ("x,y\n", "it has no points"),
    "three columns": (
        "1,2,3\n4,5,6\n",
        (
            "row 1: number of columns 3; give two columns x and y, or more with a first row that "
            "names x and y"
        ),
    ),
    "other names": (
        "a,b\n1,2\n",
        "row 1: no columns x and y among 'a', 'b'; give two columns x and y, or more .*",
    ),
    "a name twice": ("x,y,x\n1,2,3\n", "row 1: no columns x and y among 'x', 'y', 'x'; .*"),
    "decimal commas": ("1,5;2,0\n", "row 1: '1,5 2,0' has decimal commas; write decimal points"),
    "decimal commas after names": (
        "x;y\n1;2\n1,5;2\n",
        "row 3: '1,5 2' has decimal commas; write decimal points",
    ),
    "decimal commas between blanks": (
        "1,5 2,0\n",
        "row 1: '1,5 2,0' has decimal commas; write decimal points",
    ),
    "a word": ("0,0\n\n# c\n1,one\n", "row 4: 'one' is not a finite number"),
    "a word in the first row": ("0,a\n", "row 1: 'a' is not a finite number"),
    "half a point": ("0,0\n1\n", "row 2: number of columns 1; .*"),
    "a point without x": ("0,0\n,1\n", "row 2: '' is not a finite number"),
    "nan": ("0,0\n1,nan\n", "row 2: 'nan' is not a finite number"),
    "a third number": ("x,y\n0,0,5\n", "row 2: number of columns 3; the first row names 2"),
    "another coding": (
        "größe;x\n".encode("latin-1"),
        "byte 2 is not UTF-8; save the file as UTF-8",
    ),
}


def test_outlines_of_a_list_of_points(tmp_path):
    centre = np.array(shapely.Polygon(HOUSE).centroid.coords[0])
    for name, (content, areas) in TAKEN.items():
        drawing = read(content, tmp_path)
        assert [shapely.Polygon(line).area for line in drawing.outlines] == pytest.approx(areas), (
            name
        )
        assert shapely.Polygon(drawing.outlines[0]).centroid.coords[0] == pytest.approx(
            np.sqrt(areas[0] / 3) * centre
        ), name
        assert not drawing.omissions, name


def test_list_that_is_not_of_points_is_refused_with_its_row(tmp_path, refused):
    refused(lambda content: read(content, tmp_path), REFUSED.values(), whole=True)


def test_what_is_not_taken_of_a_list_is_counted(tmp_path):
    drawing = read(
        "x,y,z\n" + "".join(f"{x},{y},0.5\n" for x, y in HOUSE) + "\n1,2,0.5\n3,4,0.5\n", tmp_path
    )
    assert len(drawing.outlines) == 1
    assert drawing.omissions == Counter(
        {Omission("column", "z", "not x or y"): 1, Omission("points", "", "fewer than 3"): 2}
    )


def test_square_far_from_the_origin_keeps_its_corners(tmp_path):
    """Its first point may be repeated at its end, and points one after another may be equal."""
    square = [(4e5 + x, y) for x, y in [(0, 0), (4, 0), (4, 0), (4, 4), (0, 4)]]
    for points in (square, [*square, square[0]]):
        read(rows(points), tmp_path)
        (outline,) = read_outlines(tmp_path / "points.csv")
        assert len(outline) == 4 and shapely.Polygon(outline).area == 16


def test_case_file_with_a_byte_order_mark_loads(tmp_path):
    (tmp_path / "points.csv").write_text("\ufeff" + rows(HOUSE), encoding="utf-8")
    text = (
        "[plate]\nwidth = 9.0\nheight = 9.0\n[[holes]]\nkind = 'outline'\nfile = 'points.csv'\n"
        "fit = 'polygon'\n"
    )
    (tmp_path / "case.toml").write_text("\ufeff" + text, encoding="utf-8")
    assert float(load_case(tmp_path / "case.toml").plate.holes[0].area()) == pytest.approx(3)
