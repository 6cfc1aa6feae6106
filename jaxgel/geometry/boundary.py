"""Edges of a plate: conditions, macroscopic deformation, prescribed displacements.

Lengths in mm.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .._validation import did_you_mean, finite_numbers

EDGES = ("left", "right", "bottom", "top")
CONDITIONS = ("roller", "fixed", "free", "periodic")
OPPOSITE = {"left": "right", "right": "left", "bottom": "top", "top": "bottom"}
FREE = "free"
"""A component of the macroscopic deformation along which no mean stress acts."""
Deformation = tuple[tuple[float | str, float | str], tuple[float | str, float | str]]
AXIS = {"left": 0, "right": 0, "bottom": 1, "top": 1}
"""Axis normal to each edge."""
FRAME_EDGES = (("left", "right"), ("bottom", "top"))
"""The two edges normal to each axis."""


@dataclasses.dataclass(frozen=True)
class Edges(Mapping):
    """Edge of the plate -> its condition, or another value; hashable."""

    values_in_order: tuple
    """Value of each of ``EDGES``, in that order."""

    def __getitem__(self, edge: str) -> Any:
        return dict(zip(EDGES, self.values_in_order, strict=True))[edge]

    def __iter__(self) -> Iterator[str]:
        return iter(EDGES)

    def __len__(self) -> int:
        return len(EDGES)


def checked_edges(edges: Mapping[str, str] | str) -> Edges:
    """The conditions as ``Edges``, rollers if none is given.

    ValueError for unknown ones and half a periodic pair.
    """
    if isinstance(edges, str):
        edges = dict.fromkeys(EDGES, edges)
    if not isinstance(edges, Mapping):
        raise ValueError(
            f"edges: {edges!r} is neither a condition nor a mapping from edges to conditions such "
            "as {'top': 'free'}"
        )
    for edge, condition in edges.items():
        if edge not in EDGES:
            raise ValueError(f"edges: unknown edge {edge!r}; {did_you_mean(edge, EDGES)}")
        if condition not in CONDITIONS:
            raise ValueError(
                f"edges: {edge} = {condition!r} is unknown; {did_you_mean(condition, CONDITIONS)}"
            )
        if condition == "periodic" and edges.get(OPPOSITE[edge], "roller") != "periodic":
            raise ValueError(f"edges: {edge} = 'periodic' needs {OPPOSITE[edge]} = 'periodic'")
    return Edges(tuple(edges.get(edge, "roller") for edge in EDGES))


def checked_deformation(deformation: object, edges: Edges) -> Deformation:
    """The macroscopic deformation gradient as nested tuples.

    ValueError for one that edges do not allow.
    """
    listed = np.array(
        _all_free(edges) if isinstance(deformation, str) and deformation == FREE else deformation,
        dtype=object,
    )
    free = np.reshape([isinstance(entry, str) for entry in listed.ravel()], listed.shape)
    for entry in listed[free]:
        if entry != FREE:
            raise ValueError(f"deformation: {entry!r} is neither a number nor {FREE!r}")
    if free.any() and free.shape == (2, 2):
        _check_free(free, edges)
        deformation = np.where(free, np.eye(2), listed).tolist()
    F = np.array(finite_numbers(deformation, (2, 2), "deformation"))
    if not np.linalg.det(F) > 0:
        raise ValueError(
            f"deformation: {F.tolist()} has the determinant {np.linalg.det(F):.3g}, it must be "
            "positive"
        )
    for edge, condition in edges.items():
        if condition == "roller" and F[AXIS[edge], 1 - AXIS[edge]] != 0:
            raise ValueError(
                f"deformation: {F.tolist()} tilts the roller edge {edge}; make the edge fixed or "
                "periodic, or drop the shear"
            )
    return tuple(
        tuple(FREE if listed[i, j] == FREE else float(F[i, j]) for j in range(2)) for i in range(2)
    )


def _all_free(edges):
    """The deformation whose components are all free that can be."""
    along = [edges[edge] == "periodic" for edge in ("left", "bottom")]
    if not any(along):
        raise ValueError(
            f"deformation: {FREE!r} is that of a periodic cell; make two opposite edges periodic"
        )
    shear = FREE if all(along) else 0.0
    return (FREE if along[0] else 1.0, shear), (shear, FREE if along[1] else 1.0)


def _check_free(free, edges):
    """Refuse components (2, 2) that are ``free`` if edges hold them."""
    if free[0, 1] != free[1, 0]:
        raise ValueError(
            f"deformation: a free shear is one unknown, F12 = F21; make both {FREE!r}, or both "
            "numbers"
        )
    needed = {(0, 0): ("left",), (1, 1): ("bottom",), (0, 1): ("left", "bottom")}
    for (i, j), sides in needed.items():
        where = f"deformation: the component {i + 1}{j + 1} is {FREE!r}, but"
        for side in sides if free[i, j] else ():
            if edges[side] != "periodic":
                raise ValueError(f"{where} the edges {side} and {OPPOSITE[side]} are not periodic")
        for edge in EDGES if free[i, j] else ():
            if i in held_components(edges, edge):
                raise ValueError(f"{where} the {edges[edge]} edge {edge} holds it")


def checked_displacement(displacement: object, edges: Edges) -> Edges:
    """The displacements as ``Edges``; ValueError for those that edges do not allow."""
    if not isinstance(displacement, Mapping):
        raise ValueError(
            f"displacement: {displacement!r} is not a mapping from edges to displacements such as "
            "{'top': (0, 0.1)}"
        )
    found = dict.fromkeys(EDGES, (0.0, 0.0))
    for edge, value in displacement.items():
        if edge not in EDGES:
            raise ValueError(f"displacement: unknown edge {edge!r}; {did_you_mean(edge, EDGES)}")
        found[edge] = finite_numbers(value, (2,), f"displacement: {edge}")
        for component in range(2):
            if found[edge][component] != 0 and component not in held_components(edges, edge):
                raise ValueError(
                    f"displacement: {edge} = {list(found[edge])} moves a {edges[edge]} edge in a "
                    "direction that is not held"
                )
    for side, end in itertools.product(("left", "right"), ("bottom", "top")):
        both = set(held_components(edges, side)) & set(held_components(edges, end))
        if any(found[side][component] != found[end][component] for component in both):
            raise ValueError(
                f"displacement: {side} and {end} move the corner between them to different places"
            )
    return Edges(tuple(found[edge] for edge in EDGES))


def held_components(edges: Mapping[str, str], edge: str) -> tuple[int, ...]:
    """Components of the displacement, 0 (x) and 1 (y), that the condition of an edge prescribes."""
    return {"roller": (AXIS[edge],), "fixed": (0, 1)}.get(edges[edge], ())
