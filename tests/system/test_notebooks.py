"""Notebooks as they are kept: valid, with the outputs of their code, and readable by Python.

CI runs them (pytest --nbmake).
"""

import ast
import re
import runpy
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parents[2] / "notebooks"
FILES = sorted(FOLDER.glob("*.ipynb"))


def test_there_are_notebooks():
    assert [file.name[:2] for file in FILES] == [
        "01",
        "02",
        "03",
        "04",
        "05",
        "06",
        "07",
        "08",
        "09",
        "10",
        "11",
    ]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_notebook_has_the_outputs_of_its_code(file):
    """Outputs by notebooks/execute.py, with figures, and nothing that changes between runs."""
    notebook = nbformat.read(file, as_version=nbformat.NO_CONVERT)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not [
        cell.id for cell in code if cell.execution_count is not None or "execution" in cell.metadata
    ]
    assert notebook.metadata.jaxgel.code == runpy.run_path(str(FOLDER / "execute.py"))["digest"](
        notebook
    )
    outputs = [output for cell in code for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert {output.output_type for output in outputs} <= {
        "display_data",
        "execute_result",
        "stream",
    }
    tree = ast.parse("\n".join(cell.source for cell in code))
    # it fails where it is not true
    assert any(isinstance(node, ast.Assert) for node in ast.walk(tree))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_links_and_paths_of_a_notebook_stay_in_the_repository(file):
    text = file.read_text(encoding="utf-8")
    prose = "\n".join(
        cell.source
        for cell in nbformat.read(file, as_version=4).cells
        if cell.cell_type == "markdown"
    )
    links = [
        link for link in re.findall(r"\]\(([^)]+)\)", prose) if not link.startswith("https://")
    ]
    assert links and all((file.parent / link).is_file() for link in links)
    assert not re.search(r"/(home|root|tmp|Users|work)/|[A-Z]:\\\\", text)
