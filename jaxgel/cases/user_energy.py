"""User-defined gel energy of a case file: ``[gel] energy = "module:function"``.

The function is called with the numbers of the section, ``Nv`` and ``chi`` among them, as keywords,
and returns a `material.Gel` with other ``network`` or ``volumetric`` functions, or an own dataclass
with the same four attributes. In ``stiff.py`` beside the case file:

    import jaxgel

    def gent(Nv, chi, Jm):
        return jaxgel.Gel(Nv, chi, network=jaxgel.Gent(Jm))

and in the file ``energy = "stiff:gent"`` and ``Jm = 30.0``. A run's folder stores the name, not the
code: to resume or draw it, be in the folder of the module or have that on PYTHONPATH.
"""

import functools
import importlib
import types
from pathlib import Path as File
from typing import Any

import jax.numpy as jnp

from ..materials import Gel, with_parameters

ATTRIBUTES = ("Nv", "chi", "network", "volumetric")


def user_gel(name: str, numbers: dict[str, Any], folder: str | File) -> Gel:
    """The gel that the function ``name``, "module:function", returns; ValueError for others.

    It takes a dict of numbers and pictures. The module is looked for in ``folder``, in the working
    folder, and where Python looks for modules.
    """
    where = f"gel.energy: {name!r}"
    function = _function(name, where, folder)
    try:
        gel = function(**numbers)
        # a picture, at the plate's centre
        one = with_parameters(gel, lambda part: part(jnp.zeros(2)) if callable(part) else part)
        values = [gel.network(1.2 * jnp.eye(2), one), gel.volumetric(jnp.asarray(1.44), one)]
    except Exception as problem:  # the user's code may raise anything
        reason = f"{type(problem).__name__}: {problem}"
        raise ValueError(
            f"{where} makes no gel of {', '.join(numbers)}: {' '.join(reason.split())}"
        ) from problem
    if not all(hasattr(gel, attribute) for attribute in ATTRIBUTES) or not all(
        jnp.shape(v) == () and jnp.isfinite(v) for v in values
    ):
        raise ValueError(
            f"{where} must return a gel with {', '.join(ATTRIBUTES)} whose energies are finite "
            "numbers at a stretch of 1.2"
        )
    return gel


def _function(name, where, folder):
    module, _, attribute = name.partition(":")
    files = [
        File(place, *module.split(".")).with_suffix(".py").resolve() for place in (folder, ".")
    ]
    try:
        made = next(
            (_from_file(file) for file in files if file.is_file()), None
        ) or importlib.import_module(module)
    except Exception as problem:
        reason = f"{type(problem).__name__}: {problem}"
        raise ValueError(
            f"{where}: cannot import {module!r} from {str(files[0].parent)!r}: "
            f"{' '.join(reason.split())}"
        ) from problem
    if not callable(getattr(made, attribute, None)):
        raise ValueError(f"{where}: module {module!r} has no function {attribute!r}")
    return getattr(made, attribute)


@functools.cache
def _from_file(file):
    """The module in a file, loaded once: its functions stay the same objects and compile once."""
    module = types.ModuleType(file.stem)
    module.__file__ = str(file)
    exec(compile(file.read_bytes(), file, "exec"), module.__dict__)  # noqa: S102
    return module
