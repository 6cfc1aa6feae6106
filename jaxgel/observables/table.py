"""The table of a path, as in ``history.csv``, and the events in it."""

import dataclasses
from typing import Any

import numpy as np

from ..continuation import Path
from .gaps import IN_CONTACT, SWITCHED
from .quantities import BY_COLUMN, columns_of
from .surface import CREASE_RATIO, WRINKLE_RATIO


def history(path: Path) -> dict[str, Any]:
    """The columns of ``history.csv`` for every state of a path: name -> (k,) values, a list of texts for ``status``.

    Energy in kT/v mm^2, angles in degrees, gap in mm; J is the volume ratio of a cell and its mean is weighted with the dry volume. What
    ``status`` says is in `status_texts`.
    """
    path = dataclasses.replace(path)  # what several columns share is kept on this copy and freed with it
    values = {name: BY_COLUMN[name].of(path) for name in columns_of(path.model.lists.topology.plate)}
    return {name: column if isinstance(column, list) else np.asarray(column) for name, column in values.items()}


def events(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Events along a path with the columns ``table`` of `history`: dictionaries in the order of mu.

    Each holds ``event`` ("bifurcation", "crease", "wrinkle", "contact" or "self-contact"), ``mu`` of the first state that shows it,
    ``mu_before`` of the state before (None where it is the first), and ``text``. A bifurcation, or fold, is a change of the negative
    pivots, or where the path left an unstable branch.
    """
    mu, pivots = np.asarray(table["mu"]), np.asarray(table["negative_pivots"])
    found = []

    def add(k: int, event: str, text: str) -> None:
        before = float(mu[k - 1]) if k else None
        where = f"between mu = {before:.4f} and {mu[k]:.4f}" if k else f"at or before mu = {mu[k]:.4f}"
        found.append({"event": event, "mu": float(mu[k]), "mu_before": before, "text": f"{text} {where}"})

    for k in [k for k, text in enumerate(table.get("status", ())) if SWITCHED in text]:
        add(k, "bifurcation", "the branch became unstable and the path went over to the stable one")
    for k in range(1, len(mu)):
        if pivots[k] != pivots[k - 1]:
            add(k, "bifurcation", f"negative pivots of the tangent go from {pivots[k - 1]} to {pivots[k]}")
    for name, ratio in (("crease", CREASE_RATIO), ("wrinkle", WRINKLE_RATIO)):
        for k in np.flatnonzero(np.asarray(table["surface_ratio"]) > ratio)[:1]:
            add(k, name, f"a hole's surface is compressed past the {name} limit (stretch ratio {ratio})")
    for k in [k for k, text in enumerate(table.get("status", ())) if IN_CONTACT in text][:1]:
        add(k, "contact", "a hole's sides first touch")
    for k in np.flatnonzero(np.asarray(table["min_gap"]) <= 0)[:1]:
        add(k, "self-contact", "a hole's boundary touches itself")
    return sorted(found, key=lambda e: e["mu"])
