"""Notebooks as they are kept: valid, without results, and readable by Python. Running them is a step of its own (pytest --nbmake)."""

import ast
import re
from pathlib import Path

import nbformat
import pytest

FILES = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert [file.name[:2] for file in FILES] == ["01", "02", "03", "04", "05", "06", "07", "08", "09"]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_notebook_is_clean(file):
    notebook = nbformat.read(file, as_version=nbformat.NO_CONVERT)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not [cell.id for cell in code if cell.outputs or cell.execution_count is not None]
    tree = ast.parse("\n".join(cell.source for cell in code))
    assert any(isinstance(node, ast.Assert) for node in ast.walk(tree))  # it fails where it is not true


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_links_and_paths_of_a_notebook_stay_in_the_repository(file):
    text = file.read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if not link.startswith("https://")]
    assert links and all((file.parent / link).is_file() for link in links)
    assert not re.search(r"/(home|root|tmp|Users|work)/|[A-Z]:\\\\", text)
