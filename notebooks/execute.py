"""Execute the notebooks and keep their texts and figures: python notebooks/execute.py [01 02 ...]

Each notebook gets the digest of its code, which `tests/system/test_notebooks.py` compares: code and
outputs belong together.
"""

import base64
import hashlib
import io
import sys
from pathlib import Path

import nbclient
import nbformat
from PIL import Image

FOLDER = Path(__file__).parent
KEPT = ("image/png", "text/plain")
COLOURS = 128  # of a figure's palette: a third of the bytes


def digest(notebook: nbformat.NotebookNode) -> str:
    """Digest of the code of a notebook."""
    return hashlib.sha256(
        "\n\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code").encode()
    ).hexdigest()


def execute(file: Path) -> None:
    """Execute a notebook in its folder, and write it with its outputs."""
    notebook = nbformat.read(file, as_version=4)
    client = nbclient.NotebookClient(
        notebook,
        timeout=900,
        kernel_name="python3",
        resources={"metadata": {"path": str(file.parent)}},
    )
    with client.setup_kernel():
        for number, cell in enumerate(notebook.cells):
            client.execute_cell(cell, number)
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.execution_count, cell.outputs = (
                None,
                [kept(output) for output in cell.outputs if is_kept(output)],
            )
    notebook.metadata["jaxgel"] = {"code": digest(notebook)}
    notebook.metadata["language_info"] = {"name": "python"}
    nbformat.write(notebook, file)


def is_kept(output: nbformat.NotebookNode) -> bool:
    """Whether an output is a text or a figure; progress on the error stream is not."""
    return output.get("name") == "stdout" or any(kind in output.get("data", {}) for kind in KEPT)


def kept(output: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """An output with its figure, or its text if it has none."""
    if "data" in output:
        kind = next(kind for kind in KEPT if kind in output.data)
        output.data, output.metadata = (
            nbformat.from_dict({kind: output.data[kind]}),
            nbformat.from_dict({}),
        )
        if kind == "image/png":
            output.data[kind] = with_palette(output.data[kind])
        if output.output_type == "execute_result":
            output.execution_count = None
    return output


def with_palette(figure: str) -> str:
    """A figure (PNG, base64) with a palette of colours."""
    image, smaller = Image.open(io.BytesIO(base64.b64decode(figure))).convert("RGB"), io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(smaller, "png", optimize=True)
    return base64.b64encode(smaller.getvalue()).decode()


if __name__ == "__main__":
    for file in sorted(FOLDER.glob("*.ipynb")):
        if len(sys.argv) == 1 or file.name[:2] in sys.argv[1:]:
            execute(file)
            print(file.name, f"{file.stat().st_size / 1000:.0f} kB", flush=True)
