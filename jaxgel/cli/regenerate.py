"""``python -m jaxgel.cli.regenerate`` writes the package data of `generated` anew.

It is due after a change of the schema, of a sample or of the text of a case file; a test holds the data equal to what the code makes.
"""

import json

from ..cases import case_schema, case_text, example, explicit, load_case, sample, sample_names
from .generated import EXAMPLE, file


def make() -> dict[str, str]:
    """The files as the code makes them, name -> text."""
    texts = {name: {"line": _line(sample(name)), "text": case_text(explicit(load_case(name)))} for name in sample_names()}
    files = {"schema.json": case_schema(), "samples.json": texts | {EXAMPLE: {"text": case_text(example())}}}
    return {name: json.dumps(content, indent=1, ensure_ascii=False) + "\n" for name, content in files.items()}


def _line(plate) -> str:
    kinds = sorted({type(hole).__name__.lower() for hole in plate.holes})
    holes = f"{len(plate.holes)} holes ({', '.join(kinds)})" if kinds else "no hole"
    return f"{plate.name:10s} {plate.width:g} x {plate.height:g} {plate.unit}, {holes}, Nv {plate.gel.Nv:g}, chi {plate.gel.chi:g}"


if __name__ == "__main__":
    for name, text in make().items():
        file(name).write_text(text, encoding="utf-8")
