"""Facts about the representations of the groups."""

import pytest

from jaxgel.geometry import SYMMETRIES
from jaxgel.symmetry import IDENTITY, NAMES, representation_of, representations
from jaxgel.symmetry.irreducible import products

SYMBOLS = {
    "C1": ["A"],
    "C2": ["A", "B"],
    "C4": ["A", "B", "E"],
    "D1 (x -> -x)": ["A'", "A''"],
    "D2 (axes)": ["A1", "A2", "B1", "B2"],
    "D4": ["A1", "A2", "B1", "B2", "E"],
}


@pytest.mark.parametrize("group", NAMES, ids=NAMES.get)
def test_dimensions_add_up_to_the_order(group):
    """The squares of the dimensions.

    Of E of C4, two complex ones of one dimension each, the sum.
    """
    found = representations(group)
    dimensions = [2 if len(one.turns) > 1 else 1 for one in found]
    squares = sum(d if NAMES[group] == "C4" else d**2 for d in dimensions)
    assert squares == len(group) + 1
    assert all(sign == 1 for _, sign in found[0].signs)
    if NAMES[group] in SYMBOLS:
        assert sorted(one.name for one in found) == SYMBOLS[NAMES[group]]


@pytest.mark.parametrize("group", NAMES, ids=NAMES.get)
def test_signs_are_those_of_a_subgroup_that_the_turns_complete(group):
    table = products(group)
    for one in representations(group):
        signs = dict(one.signs)
        assert all(signs[table[a, b]] == signs[a] * signs[b] for a in signs for b in signs)
        reached = {table[element, turn] for element in signs for turn in one.turns}
        assert reached == {IDENTITY, *group}


def test_representation_of_characters():
    group = tuple(SYMMETRIES)
    assert representation_of(dict.fromkeys(group, 1.0)) == "A1"
    assert representation_of({name: 1.0 if "rotation" in name else -1.0 for name in group}) == "A2"
    double = {name: -2.0 if name == "rotation by 180" else 0.0 for name in group}
    assert representation_of(double) == "E"
    assert representation_of(dict.fromkeys(group, 0.4)) == ""
    assert representation_of({"rotation by 90": 1.0}) == ""
    alone = {name: representation_of({name: -1.0}) for name in group}
    # a quarter turn alone is no group
    turns = {"rotation by 90": "", "rotation by 180": "B", "rotation by 270": ""}
    assert alone == {name: turns.get(name, "A''") for name in group}
