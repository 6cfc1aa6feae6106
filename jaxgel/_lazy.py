"""Names of a package that are imported when they are first used."""

import pathlib
from collections.abc import Callable

import lazy_loader


def attach(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package by the stub of its ``__init__``.

    A star import takes no packages.
    """
    of_name, names, every = lazy_loader.attach_stub(package, file)
    return (
        of_name,
        names,
        [name for name in every if not (pathlib.Path(file).parent / name).is_dir()],
    )
