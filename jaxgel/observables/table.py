"""A run's folder: what its table says of a sweep, and how table, states and summary are read back; `recorder` writes them."""

import numpy as np

from .areas import area_reduction
from .fields import cell_volumes, free_stretch, volume_ratio
from .gaps import min_gap
from .rotation import core_rotation, rotation_angle
from .surface import CREASE_RATIO, WRINKLE_RATIO, surface_ratio

COLUMNS = (
    "mu",
    "free_stretch",
    "status",
    "newton_iterations",
    "residual",
    "energy",
    "J_min",
    "J_max",
    "J_mean",
    "area_reduction",
    "rotation_deg",
    "core_rotation_deg",
    "negative_pivots",
    "lowest_eigenvalue",
    "min_gap",
    "surface_ratio",
)
SELF_CONTACT = "invalid: self-contact"
IN_CONTACT = "a hole's sides touch"
SWITCHED = "switched to the stable branch"


def history(path):
    """The columns of ``history.csv`` for every state of a path: a dictionary from each name in ``COLUMNS`` to (k,) values.

    Energy in kT/v mm^2, angles in degrees, gap in mm; J is the volume ratio of a cell and its mean is weighted with the dry
    volume. ``status`` is a list of texts: with contact, whether a hole's sides are within its range; without, ``"invalid: self-contact"``
    from the first state on in which a hole's boundary crosses itself.
    """
    J = np.asarray(volume_ratio(path))
    volumes = np.asarray(cell_volumes(path.model))
    gap = np.asarray(min_gap(path))
    values = {
        "mu": path.mu,
        "free_stretch": free_stretch(path),
        "status": _status_texts(path, gap),
        "newton_iterations": path.newton_iterations,
        "residual": path.residual,
        "energy": path.energy,
        "J_min": J.min(axis=1),
        "J_max": J.max(axis=1),
        "J_mean": J @ volumes / volumes.sum(),
        "area_reduction": area_reduction(path),
        "rotation_deg": rotation_angle(path),
        "core_rotation_deg": core_rotation(path),
        "negative_pivots": path.negative_pivots,
        "lowest_eigenvalue": path.lowest_eigenvalue,
        "min_gap": gap,
        "surface_ratio": surface_ratio(path),
    }
    return {name: values[name] if name == "status" else np.asarray(values[name]) for name in COLUMNS}


def events(table):
    """What happens along a path with the columns ``table`` of `history`, as a list of dictionaries in the order of mu.

    Each holds ``event`` ("bifurcation", "crease", "wrinkle", "contact" or "self-contact"), ``mu`` of the first state that shows it,
    ``mu_before`` of the state before (None where it is the first), and ``text``. A bifurcation, or fold, is a change of the negative
    pivots, or where the path left an unstable branch.
    """
    mu, pivots = np.asarray(table["mu"]), np.asarray(table["negative_pivots"])
    found = []

    def add(k, event, text):
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


def _status_texts(path, gap):
    """Status texts (k,) of a path, with the first self-contact and all that follows it invalid."""
    switched = getattr(path, "switched", np.zeros(len(path.mu), dtype=bool))
    crossed = np.logical_or.accumulate(np.asarray(gap) <= 0)
    touching = gap < (0.0 if path.model.contact is None else float(path.model.contact.range))
    texts = []
    for status, *facts in zip(path.status, switched, touching, strict=True):
        said = [text for text, holds in zip((SWITCHED, IN_CONTACT), facts, strict=True) if holds]
        texts.append(", ".join(said) or status.name.lower().replace("_", " "))
    return [SELF_CONTACT if c else text for text, c in zip(texts, crossed, strict=True)]
