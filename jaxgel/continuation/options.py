"""Options of a sweep."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from .._validation import (
    FLAG,
    NUMBER,
    PAIR,
    POSITIVE,
    Inadmissible,
    check_options,
    entry_of,
    listed,
    option,
    whole,
    word,
)
from ..controls import CONTROLS, DIRECTIONS, Control, check_control, check_values, turning_points
from ..geometry import Plate
from ..materials import SMALLEST_SWELLING, AnyGel, check_gel, gel_in_groups, osmotic, takes_solvent
from ..mechanics import Problem, check_driven, check_room
from .follow import BRANCHES, SYMMETRY
from .steps import Adaptive

CONTACT = ("on", "off", "stop")
# least network stiffness over the round-off of the bulk stiffness: two digits of it are left in the
# tangent
DIGITS = 100.0
LOW_MU = -12.0  # kT: above it J - 1 is far above round-off
STEPS = 40  # values of a sweep if none are given
# fields that say nothing of the other controls
OF_MU, OF_OTHERS = ("mu_start", "mu_end", "mu"), ("value_list", "start", "end", "at_mu")


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """What drives a sweep, between which values, and how it follows its branch.

    Checked when they are made. A field's ``stage`` says what takes it: "values" is part of `values`
    or the control, "loads" of the loads, "problem" of the problem, and "sweep" is a keyword of
    `sweep`.
    """

    control: str = option("mu", word(tuple(CONTROLS)), "values")
    """The control: mu, a parameter of the gel, a stretch, a load factor, or an obstacle"""
    mu_start: float | None = option(None, NUMBER, "values", filled=-4.9678)
    """First value of mu, kT."""
    mu_end: float | None = option(None, NUMBER, "values", filled=-0.9178)
    """Last value of mu, kT, or the one at which it turns."""
    start: float | None = option(None, NUMBER, "values", entry="from")
    """First value of another control."""
    end: float | None = option(None, NUMBER, "values", entry="to")
    """Last value of another control, or the one at which it turns."""
    back: bool = option(False, FLAG, "values")
    """Whether the control goes back to its first value."""
    steps: str | int | None = option(
        None, {"anyOf": [{"const": "auto"}, whole(2)]}, "values", filled=STEPS
    )
    """"auto", or the number of equally spaced values on each way with both ends included."""
    mu: tuple | None = option(None, listed(NUMBER, least=1), "values")
    """The values of mu themselves; then its ends and steps are not used. They may rise and fall."""
    value_list: tuple | None = option(None, listed(NUMBER, least=1), "values", entry="values")
    """The values of another control themselves, instead of from and to. They may rise and fall."""
    at_mu: float | None = option(None, NUMBER, "values", filled=0.0)
    """Chemical potential, kT, at which another control is driven."""
    direction: str | None = option(None, word(DIRECTIONS), "values", filled="both")
    """Along which a stretch acts"""
    obstacle: int | None = option(None, whole(0), "values", filled=0)
    """Number of the obstacle that a punch moves, from 0."""
    displacement: tuple | None = option(None, PAIR, "values")
    """Its displacement at the value 1 of the control, mm."""
    branch: str = option("stable", word(BRANCHES), "sweep")
    """Branch to follow if the plate is symmetric"""
    imperfection: float = option(0.0, NUMBER, "loads")
    """Amplitude of the load along the first mode, as displacement in spacings; 0 for none.

    The mode is that of the first bifurcation.
    """
    contact: str = option("on", word(CONTACT), "problem")
    """Where hole boundaries meet, keep them apart, let them overlap, or stop"""
    contact_range: float | None = option(None, POSITIVE, "problem")
    """Distance below which surfaces repel each other, mm; default 1/80 of the shorter side."""
    symmetry: str = option("auto", word(SYMMETRY), "sweep")
    """Find symmetric states on a fundamental region, all on the whole plate, or a group's name"""
    eigenvalues: bool = option(False, FLAG, "sweep")
    """Whether every state gets its lowest eigenvalue, in a column of the history.

    It costs a quarter of a sweep.
    """

    def __post_init__(self) -> None:
        check_options("sweep", self)
        self._check_entries()
        kind = CONTROLS[self.control]
        fields = ["mu_start", "mu_end"] if self.control == "mu" else ["at_mu"]
        fields += ["direction"] * kind.moves_edges + ["obstacle"] * kind.moves_obstacle
        fields += ["steps"] * (not self.listed)
        for field in dataclasses.fields(self):
            if field.name in fields and getattr(self, field.name) is None:
                object.__setattr__(self, field.name, field.metadata["filled"])
        numbers = check_values(self.numbers, self.control, kind.unit)
        if kind.moves_edges and numbers.min() <= 0:
            raise ValueError(
                f"{self.control}: {numbers.min():g} is not accepted, it must be above 0"
            )
        if kind.moves_obstacle and not np.any(self.displacement or 0.0):
            wrong = "is missing" if self.displacement is None else "[0, 0] is at rest"
            raise ValueError(f"sweep.displacement: {wrong}; give two numbers in mm, as [0.0, -1.0]")

    def _check_entries(self):
        """ValueError for entries incompatible with the control or each other, and missing ends."""
        entries = {field.name: entry_of(field) for field in dataclasses.fields(self)}
        kind = CONTROLS[self.control]
        foreign = [
            *(OF_OTHERS if self.control == "mu" else OF_MU),
            *["direction"] * (not kind.moves_edges),
        ]
        foreign += ["obstacle", "displacement"] * (not kind.moves_obstacle)
        known = (
            "mu_start, mu_end, steps and back, or mu"
            if self.control == "mu"
            else "from, to, steps and back, or values; and at_mu"
        )
        for name in foreign:
            if (value := getattr(self, name)) is not None:
                raise ValueError(
                    f"sweep.{entries[name]}: {value!r} does not go with control = "
                    f"{self.control!r}, which takes {known}"
                )
        own = "mu" if self.control == "mu" else "value_list"
        given = [name for name in ("start", "end") if getattr(self, name) is not None]
        if getattr(self, own) is None:
            for name in ("start", "end") if self.control != "mu" else ():
                if name not in given:
                    raise ValueError(
                        f"sweep.{entries[name]}: is missing; control = {self.control!r} takes "
                        f"{known}"
                    )
        # files of version 0.2 have the default beside their list
        elif given or self.back or self.steps not in (None, STEPS):
            name = given[0] if given else "back" if self.back else "steps"
            value = getattr(self, name)
            raise ValueError(
                f"sweep.{entries[name]}: {value!r} does not go with a list of values, which may "
                "rise and fall"
            )

    @property
    def values(self) -> list[float] | Adaptive:
        """What `sweep` takes: the values, or the ends and the turning point of chosen steps."""
        return self.numbers if self.given else Adaptive(*self.numbers)

    @property
    def numbers(self) -> list[float]:
        """The values, or the ends and the turning point of chosen steps."""
        if self._own is not None:
            return list(self._own)
        first, last = (
            (self.mu_start, self.mu_end) if self.control == "mu" else (self.start, self.end)
        )
        way = (
            [first, last] if self.steps == "auto" else np.linspace(first, last, self.steps).tolist()
        )
        return [*way, *way[-2::-1]] if self.back else way

    @property
    def listed(self) -> bool:
        """Whether the values were given one by one."""
        return self._own is not None

    @property
    def given(self) -> bool:
        """Whether all values are known beforehand."""
        return self.listed or self.steps != "auto"

    @property
    def turns(self) -> list[float]:
        """The first value, those at which the control turns, and the last."""
        return turning_points(self.numbers)

    @property
    def ends(self) -> tuple[float, float]:
        """The first value and that at which the first way ends."""
        first, *others = self.turns
        return first, (others or [first])[0]

    @property
    def _own(self):
        """The values if they are given one by one."""
        return self.mu if self.control == "mu" else self.value_list

    def at(self, values: Sequence[float]) -> "SweepOptions":
        """The options with these values, one by one, in place of their own."""
        if self.control == "mu":
            return dataclasses.replace(self, mu=tuple(values), steps=None, back=False)
        return dataclasses.replace(
            self, value_list=tuple(values), steps=None, start=None, end=None, back=False
        )

    def check(self, gel: AnyGel, plate: Plate, *, loaded: bool) -> None:
        """ValueError, one line, for a control that gel, edges of the ``plate`` or loads lack."""
        stretches = CONTROLS[self.control].moves_edges
        if stretches and set(plate.edges.values()) == {"free"}:
            fixed = (
                "moves edges that are fixed, roller or periodic, and all edges of the plate are "
                "free"
            )
            raise ValueError(f"sweep.control: {self.control!r} {fixed}")
        along = {"x": {(0, 0)}, "y": {(1, 1)}}.get(self.direction or "", {(0, 0), (1, 1)})
        if stretches and along & set(plate.free_strains):
            raise ValueError(
                f"sweep.direction: the stretch along {self.direction!r} is free in this periodic "
                "cell, and cannot be driven"
            )
        if self.obstacle is not None and self.obstacle >= len(plate.obstacles):
            count = len(plate.obstacles)
            known = (
                f"the plate has {count}, numbered from 0"
                if count
                else "the plate has none; give [[obstacles]]"
            )
            raise ValueError(f"sweep.obstacle: {self.obstacle} is not an obstacle, {known}")
        driver = self.driver(np.zeros((1, 2)) if loaded else None)
        try:
            check_control(driver, gel, np.array(self.numbers))
        except ValueError as problem:
            raise type(problem)(f"sweep.{problem}") from None

    def driver(self, loads: Float[Array, "n 2"] | None) -> Control:
        """The control; ``loads`` (n, 2), kT/v mm, are those that a load factor multiplies.

        ValueError for one without any.
        """
        own = {
            "mu": 0.0 if self.at_mu is None else self.at_mu,
            "direction": self.direction or "both",
            "loads": loads,
        }
        own |= {"obstacle": self.obstacle, "displacement": self.displacement}
        return CONTROLS[self.control].make(own)


def check_sweep(problem: Problem, values: Float[np.ndarray, " k"], *, field: str = "mu") -> None:
    """Raise ValueError, one line, for a gel, control ``values`` or edges that no sweep can use.

    ``field`` names mu in the text.
    """
    check_gel(problem.gel)
    check_control(problem.control, problem.gel, values)
    _check_round_off(problem, values, field)
    if not problem.moves_edges:
        check_room(problem.model.cloud.plate)
    check_driven(problem, values)


def _check_round_off(problem, values, field):
    """ValueError for a mu so low that the tangent loses the network's stiffness to round-off.

    It has hardly a digit of Nv beside the bulk stiffness 1 / (J - 1). J is that under the pressure
    -Nv of the gel that swells least.
    """
    for value in values:
        now, mu = problem.at(value)
        lowest = np.min(mu)
        if lowest > LOW_MU:
            continue
        gel = gel_in_groups(now.gel)
        resolved = jnp.maximum(SMALLEST_SWELLING, DIGITS * np.finfo(float).eps / gel.Nv)  # J - 1
        least = jnp.where(
            takes_solvent(gel), osmotic(1 + resolved, 0.0, gel) + gel.Nv, -jnp.inf
        ).max()
        if lowest < least:
            where = (
                "" if problem.control.name == "mu" else f" at {problem.control.name} = {value:g}"
            )
            raise Inadmissible(
                f"{field}: {lowest:g}{where} is too low, J - 1 would be lost in round-off; give "
                f"at least {np.ceil(10 * least) / 10:.1f} kT"
            )
