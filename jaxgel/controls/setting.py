"""Setting at one value of a control: chemical potential, gel, motion of the edges and loads.

A control is a function of its value s and the gel, written in JAX, that says what acts there: the
chemical potential, the gel with the parameters that it has there, the motion of the plate's edges
and loads.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import jax
import numpy as np

from .._tracing import is_traced
from .._types import Array, Chemical, Float
from .._validation import Inadmissible
from ..geometry import EDGES
from ..materials import check_gel, named_parameters, varies


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Setting:
    """Chemical potential, gel, motions and loads at one value of a control; a user's `Driven` makes
    it.

    A pytree.
    """

    mu: Chemical
    """Chemical potential, kT."""
    gel: Any
    """The gel, with its parameters at this value."""
    deformation: Float[Array, "2 2"] | None = None
    """Macroscopic deformation that the edges follow, dimensionless; None for the plate's own."""
    displacement: Mapping[str, Float[Array, " 2"]] | None = None
    """Displacement of held edges by name, mm; the plate's own for those that are not named."""
    loads: Float[Array, "n 2"] | None = None
    """Dead nodal loads besides those of the sweep, kT/v mm."""
    obstacles: Mapping[int, Float[Array, " 2"]] | None = None
    """Displacement of obstacles by number, mm; the others are at rest."""


@runtime_checkable
class Control(Protocol):
    """A function of its value and the gel; a pytree with differentiable leaves."""

    name: str
    """Of the column in tables, and of the axis in figures."""
    unit: str
    """Of its value; empty for a dimensionless one."""
    scale: float
    """Change equivalent to one kT of the chemical potential: scale of steps and arc lengths."""

    def __call__(self, value: Chemical, gel: Any) -> Setting:
        """What acts at a ``value``."""
        ...


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Driven:
    """Control by a user's function `path_of(value, gel, *parameters)` to a `Setting`.

    The user makes it for a `Problem`. Define the function once, at the top of a module: a new
    function object compiles anew. What is to be differentiated goes into the `parameters`.
    """

    path_of: Callable[..., Setting] = dataclasses.field(metadata={"static": True})
    """The function of the value, the gel and the parameters; it returns a `Setting`."""
    parameters: tuple = ()
    """Further arguments, a pytree of numbers and arrays."""
    name: str = dataclasses.field(default="control", kw_only=True, metadata={"static": True})
    """Name in tables and figures."""
    unit: str = dataclasses.field(default="", kw_only=True, metadata={"static": True})
    """Unit of the value; empty if dimensionless."""
    scale: float = dataclasses.field(default=1.0, kw_only=True, metadata={"static": True})
    """Change of the value that counts as much as one kT of mu, for steps and arc lengths."""

    def __call__(self, value: Chemical, gel: Any) -> Setting:
        """See `Control`."""
        return self.path_of(value, gel, *self.parameters)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ChemicalPotential:
    """The chemical potential of the solvent, kT, of a gel at rest: the default control."""

    name: ClassVar[str] = "mu"
    unit: ClassVar[str] = "kT"
    scale: ClassVar[float] = 1.0

    def __call__(self, value: Chemical, gel: Any) -> Setting:
        """What acts at a ``value`` of the chemical potential."""
        return Setting(value, gel)


def check_is_control(control: object) -> None:
    """Raise ValueError, one line, for what is no control."""
    if not isinstance(control, Control):
        raise ValueError(
            f"control: {control!r} is not accepted, it must have a name, a unit and a scale, see "
            "jaxgel.controls"
        )


@dataclasses.dataclass(frozen=True)
class Changes:
    """What a control changes besides the chemical potential."""

    edges: bool
    """Whether it moves the edges of the plate."""
    loads: bool
    """Whether it has loads of its own."""
    gel: bool
    """Whether it changes parameters of the gel."""
    stiffness: bool
    """Whether Nv is among these."""
    obstacles: bool = False
    """Whether it moves obstacles."""


def changes_of(control: Control, gel: Any) -> Changes:
    """What a control changes, without computing anything."""
    if isinstance(control, ChemicalPotential):  # JAX need not trace it
        return Changes(edges=False, loads=False, gel=False, stiffness=False)
    found = []

    def ask(value):
        setting = control(value, gel)
        edges = setting.deformation is not None or setting.displacement is not None
        gel_changes = setting.gel is not gel
        stiffness = gel_changes and setting.gel.Nv is not gel.Nv
        found.append(
            Changes(
                edges,
                setting.loads is not None,
                gel_changes,
                stiffness,
                setting.obstacles is not None,
            )
        )

    jax.eval_shape(ask, 0.0)
    return found[0]


def check_fields(control: Control, gel: Any) -> None:
    """Raise ValueError, one line, for a control of a parameter that varies over the plate.

    A control that makes one vary is refused, too.
    """
    kept = [part for part in named_parameters(gel).values() if varies(part)]
    wrong = []

    def find(value):
        driven = control(value, gel).gel
        if driven is gel:
            return
        driven = named_parameters(driven)
        wrong.extend(
            name
            for name, part in driven.items()
            if varies(part) and not any(part is one for one in kept)
        )
        wrong.extend(
            name
            for name, part in named_parameters(gel).items()
            if varies(part) and driven.get(name) is not part
        )

    jax.eval_shape(find, 0.0)
    if wrong:
        raise ValueError(
            f"control: {wrong[0]!r} varies over the plate, only a parameter that is one number "
            "can be driven"
        )


def check_control(control: Control, gel: Any, values: Float[np.ndarray, " k"]) -> None:
    """Raise ValueError, one line, for a control without `Setting` at ``values``, or a jump.

    Unusable numbers at one of the values are refused, too. A path jumps if halving the distance
    between two values again and again leaves as large a change of what acts. Traced values pass.
    """
    if isinstance(control, ChemicalPotential) or is_traced(control, gel):
        return
    numbers = [_numbers(control, value, gel) for value in values]
    for before, after, first, last in zip(values, values[1:], numbers, numbers[1:], strict=False):
        _check_continuous(control, gel, (before, after), (first, last))


def _numbers(control, value, gel):
    """All numbers (m,) of the setting at a ``value``, checked."""
    setting = control(float(value), gel)
    if not isinstance(setting, Setting):
        raise ValueError(
            f"{control.name}: the control gives {type(setting).__name__} at {value:g}, it must "
            "give a Setting"
        )
    try:
        check_gel(setting.gel, setting.mu)
    except ValueError as problem:
        raise type(problem)(f"{control.name} = {value:g}: {problem}") from None
    motion = [
        np.ravel(leaf)
        for leaf in jax.tree.leaves(
            (setting.deformation, setting.displacement, setting.loads, setting.obstacles)
        )
    ]
    if setting.displacement is not None and not set(setting.displacement) <= set(EDGES):
        raise ValueError(
            f"{control.name}: displacement of {sorted(setting.displacement)} is not accepted, "
            f"edges are {', '.join(EDGES)}"
        )
    own = np.concatenate([np.zeros(0), *motion])
    if not np.isfinite(own).all():
        raise Inadmissible(f"{control.name}: what acts at {value:g} is not finite")
    return np.concatenate(
        [
            own,
            *(
                np.ravel(np.asarray(leaf, float))
                for leaf in jax.tree.leaves((setting.mu, setting.gel))
            ),
        ]
    )


HALVINGS = 40  # of the distance between two values: until it is round-off
CONTINUOUS = 0.5  # of a change that is left after all halvings: more is a jump


def _check_continuous(control, gel, between, numbers):
    """ValueError if what acts jumps ``between`` two values with these ``numbers``."""
    (low, high), (first, last) = between, numbers
    whole = np.abs(last - first).max(initial=0.0)
    for _ in range(HALVINGS if whole > 0 else 0):
        middle = 0.5 * (low + high)
        there = _numbers(control, middle, gel)
        changes = np.abs(there - first).max(), np.abs(last - there).max()
        if max(changes) < CONTINUOUS * whole:
            return
        low, first, high, last = (
            (low, first, middle, there) if changes[0] >= changes[1] else (middle, there, high, last)
        )
    if whole > 0:
        raise Inadmissible(
            f"{control.name}: what acts jumps at {0.5 * (low + high):.6g}, the path must be "
            "continuous"
        )
