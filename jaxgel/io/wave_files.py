"""The files of ``jaxgel waves``."""

from pathlib import Path as File
from typing import Any

import numpy as np

from ..waves import Dispersion, LatticeOnset
from .files import write_atomically, write_csv, write_json


def write_waves(onset: LatticeOnset | None, bands: Dispersion | None, folder: File, options: dict[str, Any]) -> None:
    """``waves.json`` with the onset and the gaps of the bands, null where there are none, in a folder.

    With an onset also ``zone.csv``, the lowest eigenvalue by wave vector, and ``onset.npz`` with state and wave; with bands ``bands.csv``,
    the frequencies by wave vector.
    """
    gaps = None if bands is None else {"mu": bands.mu, "gaps": bands.gaps, "corners": bands.corners}
    write_json(folder / "waves.json", {"options": options, "onset": _entry(onset), "bands": gaps})
    if bands is not None:
        header = ["kx", "ky", "along", *(f"omega_{k + 1}" for k in range(bands.squares.shape[1]))]
        write_csv(folder / "bands.csv", header, np.column_stack([bands.wave_vectors, bands.along, bands.frequencies]).tolist())
    if onset is not None:
        write_csv(folder / "zone.csv", ["kx", "ky", "eigenvalue"], np.column_stack([onset.zone, onset.eigenvalues]).tolist())
        arrays = {"x": np.asarray(onset.x), "modes": onset.modes, "wave_vector": onset.wave_vector}
        write_atomically(folder / "onset.npz", lambda stream: np.savez(stream, **arrays))


def _entry(onset):
    if onset is None:
        return None
    names = ("kind", "periods", "slope", "text")
    return {"mu": float(onset.mu), "wave_vector": onset.wave_vector.tolist()} | {name: getattr(onset, name) for name in names}
