"""Gaps between facing points of a hole's outline, and the status of each state in words, as in ``history.csv``.

Two points of an outline face each other where the line between them leaves both surfaces at less than 60 degrees to the normal. Pairs
closer than two node spacings on the dry plate are neighbours and do not count.
"""

from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import shapely

from .._memo import once_per_owner
from .._types import Array, Bool, Float
from ..continuation import Path
from ..discretisation import Model
from ..mechanics import is_film, outline_loops
from .areas import dry_outlines, outlines
from .fields import membrane_stress
from .states import States, over_states

FACING = 0.5  # cosine of the largest angle between a gap and the normals at its ends
SELF_CONTACT = "invalid: self-contact"
IN_CONTACT = "a hole's sides touch"
SWITCHED = "switched to the stable branch"
WRINKLES = "a thin film wrinkles out of its plane"
ROUND_OFF = 1e-9  # kT/v: compression of a film that is none


def min_gap(path: States) -> Float[np.ndarray, " k"]:
    """Smallest gap (k,) between facing points of one hole's outline, mm; 0 where an outline crosses itself.

    inf where no points face each other, and for a plate without holes. Not differentiable, unlike `gap`: whether an outline crosses
    itself is no formula that JAX traces. NumPy evaluates it, so that the table of a run waits for no compilation.
    """
    smallest = np.full(len(path.x), np.inf)
    for states, dry in zip(outlines(path), dry_outlines(path.model), strict=True):
        distant = _distant_pairs(np.asarray(dry), path.model)
        for k, loop in enumerate(np.asarray(states)):
            crosses = not shapely.LinearRing(loop).is_simple
            smallest[k] = 0.0 if crosses else min(smallest[k], np.sqrt(_squared_gaps(loop, distant, np).min()))
    return smallest


def gap(path: States) -> Float[Array, " k"]:
    """Smallest gap (k,) between facing points of one hole's outline, mm, with the derivatives of the nearest pair.

    It is the plate's shorter side where no points face each other. Unlike `min_gap` it does not notice an outline that crosses itself.
    """
    return over_states(_gap, path)


min_gap_once = once_per_owner(min_gap)
"""`min_gap`, evaluated once for a path: two columns of the table depend on it."""


def status_texts(path: Path) -> list[str]:
    """Status of each state (k): how Newton ended, or that the state is on another branch than the one before, or in contact.

    With contact, a state is in contact where a gap is below the range of contact. Without, all states from the first one on in which a
    hole's boundary crosses itself are ``SELF_CONTACT``. A film that is compressed in its plane would wrinkle out of it; its smallest stress
    is given, see `membrane_stress`.
    """
    smallest = min_gap_once(path)
    switched = getattr(path, "switched", np.zeros(len(path.mu), dtype=bool))
    crossed = np.logical_or.accumulate(smallest <= 0)
    touching = smallest < (0.0 if path.model.contact is None else float(path.model.contact.range))
    stress = membrane_stress(path) if is_film(path.model) else np.zeros(len(path.mu))
    texts = []
    for status, least, *facts in zip(path.status, np.asarray(stress), switched, touching, strict=True):
        found = [text for text, holds in zip((SWITCHED, IN_CONTACT), facts, strict=True) if holds]
        found += [f"{WRINKLES} ({least:.2g} kT/v)"] if least < -ROUND_OFF else []
        texts.append(", ".join(found) or status.name.lower().replace("_", " "))
    return [SELF_CONTACT if c else text for text, c in zip(texts, crossed, strict=True)]


def _gap(x: Float[Array, "n 2"], model: Model) -> Float[Array, ""]:
    """`gap` of one state."""
    plate = model.lists.topology.plate
    largest = float(min(plate.width, plate.height))
    pairs = zip(outline_loops(x, model), dry_outlines(jax.lax.stop_gradient(model)), strict=True)
    gaps = [_nearest_gap(loop, _distant_pairs(dry, model), largest) for loop, dry in pairs]
    return jnp.min(jnp.stack([jnp.asarray(largest), *gaps]))


def _nearest_gap(loop: Float[Array, "m 2"], distant: Bool[Array, "m m"], largest: float) -> Float[Array, ""]:
    """Smallest distance between facing points of a closed loop, ``largest`` where there are none; its pair is chosen on constants."""
    squared = _squared_gaps(jax.lax.stop_gradient(loop), distant, jnp)
    a, b = jnp.unravel_index(jnp.argmin(squared), squared.shape)
    facing = squared[a, b] < largest**2
    return jnp.where(facing, jnp.sqrt(jnp.where(facing, jnp.sum((loop[a] - loop[b]) ** 2), 1.0)), largest)


def _squared_gaps(loop: Float[Array, "m 2"], distant: Bool[Array, "m m"], xp: ModuleType) -> Float[Array, "m m"]:
    """Squared distances of facing points of a closed loop, gel outside, by NumPy or JAX (``xp``); inf for all other pairs."""
    tangent = xp.roll(loop, -1, axis=0) - xp.roll(loop, 1, axis=0)
    normal = xp.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / xp.linalg.norm(tangent, axis=1, keepdims=True)
    squared = (loop[None, :, 0] - loop[:, None, 0]) ** 2 + (loop[None, :, 1] - loop[:, None, 1]) ** 2
    height = normal @ loop.T  # over the tangent at each point, from the origin
    leaving = height - xp.diagonal(height)[:, None] > FACING * xp.sqrt(squared)
    return xp.where(leaving & leaving.T & distant, squared, xp.inf)


def _distant_pairs(dry: Float[Array, "m 2"], model: Model) -> Bool[Array, "m m"]:
    """Pairs of points that lie two node spacings or more apart on the dry outline of a hole."""
    return (dry[None, :, 0] - dry[:, None, 0]) ** 2 + (dry[None, :, 1] - dry[:, None, 1]) ** 2 >= (2 * model.cloud.spacing) ** 2
