"""The irreducible representations of a group, each as a subgroup with signs.

On a symmetric state the tangent is block diagonal over the representations of its group (Healey
1988; Golubitsky, Stewart & Schaeffer 1988). Every block acts on the fields that a subgroup keeps or
reverses, each element by its own sign: of a representation of one dimension the whole group; of the
double one of D4 the mirrors at the axes, one of which keeps the field and the other one reverses
it; of the double one of C4 the half turn, which reverses it.
"""

import dataclasses
import functools
import itertools
from collections.abc import Mapping

import numpy as np

from ..geometry import SYMMETRIES
from .groups import IDENTITY, NAMES

ALIKE = 0.1  # difference of a character from that of a representation


@dataclasses.dataclass(frozen=True)
class Representation:
    """One irreducible representation of a group."""

    name: str
    """Mulliken's symbol, such as A1, B2 or E."""
    signs: tuple[tuple[str, int], ...]
    """(element, sign) of the subgroup with its identity: R x = sign x for fields x of the block."""
    turns: tuple[str, ...]
    """Coset representatives of the subgroup: images of the block in the rest of the plate."""
    copies: int
    """Number of equal blocks of the tangent: one for each of the first so many ``turns``."""


@functools.cache
def representations(group: tuple[str, ...]) -> tuple[Representation, ...]:
    """The irreducible representations of a group of ``NAMES``, that of symmetric fields first."""
    elements, table = (IDENTITY, *group), products(group)
    found = []
    for choice in itertools.product((1, -1), repeat=len(group)):
        sign = dict(zip(elements, (1, *choice), strict=True))
        if all(sign[a] * sign[b] == sign[product] for (a, b), product in table.items()):
            found.append(Representation(_symbol(group, sign), tuple(sign.items()), (IDENTITY,), 1))
    if NAMES[group] == "D4":
        signs = ((IDENTITY, 1), ("x -> -x", 1), ("y -> -y", -1), ("rotation by 180", -1))
        found.append(Representation("E", signs, (IDENTITY, "rotation by 90"), 2))
    if NAMES[group] == "C4":
        found.append(
            Representation(
                "E", ((IDENTITY, 1), ("rotation by 180", -1)), (IDENTITY, "rotation by 90"), 1
            )
        )
    return tuple(found)


def _symbol(group, sign):
    """Mulliken's symbol of a one-dimensional representation: A or B, with 1 or 2.

    The letter is chosen by the rotation, the number by the first mirror.
    """
    turn = next((name for name in ("rotation by 90", "rotation by 180") if name in group), None)
    mirror = next((name for name in group if "rotation" not in name), None)
    letter = "A" if turn is None or sign[turn] > 0 else "B"
    if mirror is None:
        return letter
    if turn is None:
        return letter + ("'" if sign[mirror] > 0 else "''")
    return letter + ("1" if sign[mirror] > 0 else "2")


def representation_of(characters: Mapping[str, float]) -> str:
    """Symbol of the representation with ``characters``, name -> trace of all symmetries.

    The group is that of a space of modes. Empty if the names are no group, or the traces none of
    one representation.
    """
    group = tuple(characters)
    if group not in NAMES:
        return ""
    for representation in representations(group):
        signs = dict(representation.signs)
        double = len(representation.turns) > 1
        expected = [
            2 * signs.get(name, 0) * ("rotation" in name) if double else signs[name]
            for name in group
        ]
        if np.allclose(expected, list(characters.values()), atol=ALIKE):
            return representation.name
    return ""


def products(group: tuple[str, ...]) -> dict[tuple[str, str], str]:
    """(first, second) -> name of ``second`` after ``first``, in a group with its identity."""
    matrices = {
        IDENTITY: np.eye(2, dtype=int),
        **{name: np.array(SYMMETRIES[name]) for name in group},
    }
    names = {tuple(matrix.ravel().tolist()): name for name, matrix in matrices.items()}
    pairs = itertools.product(matrices, repeat=2)
    return {(a, b): names[tuple((matrices[a] @ matrices[b]).ravel().tolist())] for a, b in pairs}
