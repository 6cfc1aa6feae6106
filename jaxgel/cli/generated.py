"""Package data from which help texts, samples, schema, init and refusals answer without importing JAX; see `regenerate`."""

import functools
import json
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

EXAMPLE = "example"  # name of the case that ``jaxgel init`` writes without --from


@functools.cache
def schema() -> dict[str, Any]:
    """The JSON schema of a case file."""
    return json.loads(file("schema.json").read_text(encoding="utf-8"))


@functools.cache
def samples() -> dict[str, dict[str, str]]:
    """Name of a built-in case -> ``line``, its line in ``jaxgel samples``, and ``text``, its case file; and the example's ``text``."""
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
