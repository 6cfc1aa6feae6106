"""The engine ``jaxgel`` of xarray: ``xarray.open_dataset(folder)`` opens the folder of a run."""

from collections.abc import Iterable
from pathlib import Path as File
from typing import Any

from xarray.backends import BackendEntrypoint

from .netcdf import dataset


class RunEngine(BackendEntrypoint):
    """Opens the folder of a run as its `dataset`; the package's entry point tells xarray."""

    description = "Open the folder of a jaxgel run"

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None
    ) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The `dataset` of a run's folder, without some variables.

        ValueError for a folder without a readable run.
        """
        return dataset(filename_or_obj).drop_vars(drop_variables or [])

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether it is the folder of a run."""
        return (
            isinstance(filename_or_obj, str | File)
            and (File(filename_or_obj) / "states.npz").is_file()
        )
