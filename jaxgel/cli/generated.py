"""Package data from which help texts, samples, schema, init and refusals answer without importing the packages.

``python -c "from jaxgel.cli import generated; generated.write()"`` makes the data anew, which is due after a change of the schema, of a
sample or of the text of a case file; a test holds the data equal to what the code makes.
"""

import functools
import json
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

EXAMPLE, WITH_REGIONS = "example", "example with regions"  # names of the cases that ``jaxgel init`` writes without --from


@functools.cache
def schema() -> dict[str, Any]:
    """The JSON schema of a case file."""
    return json.loads(file("schema.json").read_text(encoding="utf-8"))


@functools.cache
def samples() -> dict[str, dict[str, str]]:
    """Name of a built-in case -> ``line``, its line in ``jaxgel samples``, and ``text``, its case file; and the examples' ``text``."""
    return json.loads(file("samples.json").read_text(encoding="utf-8"))


def choices(section: str, key: str) -> list[str]:
    """The words that an entry of a case file may be."""
    return schema()["properties"][section]["properties"][key]["enum"]


def default(section: str, key: str) -> object:
    """The default of an entry of a case file."""
    return schema()["properties"][section]["properties"][key].get("default")


def file(name: str) -> Traversable:
    """The file of package data with that name."""
    return resources.files("jaxgel.cli").joinpath("data", name)


def write() -> None:
    """Write the files anew."""
    for name, text in make().items():
        file(name).write_text(text, encoding="utf-8")


def make() -> dict[str, str]:
    """The files as the code makes them, name -> text."""
    from ..cases import case_schema, case_text, example, explicit, load_case, sample, sample_names

    texts = {name: {"line": _line(sample(name)), "text": case_text(explicit(load_case(name)))} for name in sample_names()}
    examples = {name: {"text": case_text(example(regions=name == WITH_REGIONS))} for name in (EXAMPLE, WITH_REGIONS)}
    files = {"schema.json": case_schema(), "samples.json": texts | examples}
    return {name: json.dumps(content, indent=1, ensure_ascii=False) + "\n" for name, content in files.items()}


def _line(plate):
    kinds = sorted({type(hole).__name__.lower() for hole in plate.holes})
    holes = f"{len(plate.holes)} holes ({', '.join(kinds)})" if kinds else "no hole"
    return f"{plate.name:10s} {plate.width:g} x {plate.height:g} {plate.unit}, {holes}, Nv {plate.gel.Nv:g}, chi {plate.gel.chi:g}"
