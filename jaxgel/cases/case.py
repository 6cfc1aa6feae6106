"""Cases: the input of one run, from a built-in name, a TOML file, or the table of a run.

A table has the sections of a case file, all but ``plate`` optional:

    [plate]            sample = "sample-1", or width, height (mm), edges = {left = "roller", ...},
                       deformation = [[1.1, 0.0], [0.0, 1.0]] (of held and periodic edges; of a
                       periodic cell "free", or components that are), displacement = {top = [0.0,
                       0.5], ...} (mm, of held edges), and other fields of `geometry.Plate`; either
                       with kinematics = "plane stress" for a film, and in time with wet = {top =
                       false} or bath = {top = {mu = -0.5}} of free edges
    [[holes]]          kind = "ellipse" and the hole's own parameters, its angle in radians or as
                       angle_deg in degrees; as many as there are holes, none with a sample; or
                       kind = "outline", file = "hole.dxf" (.csv, .svg), see `hole_table`; or all
                       holes of a picture of the plate, kind = "image", file = "holes.png", see
                       `hole_tables`; in time with wet = false or bath = {mu, times, ramp}, what
                       differs from the section bath
    [[regions]]        outlines as of holes, of parts with a material of their own: gel = {Nv, chi
                       ...}, what differs from the plate's, or elastomer = {Nv, bulk}, which takes
                       no solvent
    [[obstacles]]      rigid bodies outside the gel: kind = "half-plane" (point, normal), "disc"
                       (centre, radius) or "polyline" (points)
    [[moved]]          parameters that replace those of a hole, one section for each hole; the cloud
                       is the former plate's, placed
    [gel]              kind = "gel", "pnipam" (with temperature instead of chi) or "polyelectrolyte"
                       (with pH, salt, acid_fraction, pKa and solvent_volume besides); Nv, chi and
                       the others each a number, a grey picture {file = "mask.png", low, high} that
                       covers the plate, or the {values} of its pixels, see `io.masks`; energy =
                       "module:function" and numbers that the function takes, see `user_energy`
    [loads]            body_force = [x, y] (kT/v per mm), traction = {top = [x, y], ...} (kT/v)
    [sweep]            mu_start, mu_end, steps ("auto" or a number), or mu = [list]; or control =
                       "temperature" ..., from, to, steps, or values = [list], at_mu; back = true;
                       branch, imperfection, contact
    [time]             swelling in time: end, steps_per_decade, first, or times = [list]; D (mm^2
                       per unit of time), unit = "h"; with it [sweep] has mu_start, the gel's
                       equilibrium before time 0, and branch
    [bath]             mu (kT) of what wets holes and free edges from time 0 on; times, rising, if
                       mu = [list]; or ramp, the time in which it goes from mu_start to mu; needed
                       with [time]
    [discretisation]   spacing (mm), nodes_per_hole, across, basis, dmax
    [output]           figures, animation, paraview (true or false)
    [uncertainty]      standard deviations of inputs, as Nv = "5 %", semi_axes = 0.1 (of every
                       hole), "holes[1].angle_deg" = 2.0, see `uncertain`

Every table is checked against `schema.case_schema` first.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

from .._deprecated import OldAttribute, old_arguments
from .._validation import check, entry_of, with_changes
from ..bifurcation import (
    CriticalPoint,
    Loop,
    critical_points,
    loop,
    problem_by_options,
    sweep_by_options,
)
from ..cloud import Cloud
from ..continuation import Path, SweepOptions
from ..controls import CONTROLS
from ..discretisation import DiscretisationOptions, Model
from ..equilibrium import UNOBSERVED, Observer
from ..geometry import Plate, check_plate
from ..io import read_toml
from ..materials import (
    AnyGel,
    Composite,
    PixelField,
    WithHoles,
    check_gel,
    matrix_of,
    named_parameters,
)
from ..mechanics import Loads, Problem, check_edges, check_room
from ..transient import (
    Bath,
    BathOptions,
    TimeOptions,
    check_numbers,
    check_swelling,
    resolved_time,
    step_times,
    swell,
)
from .baths import baths, check_time, start_entries
from .materials import gel_of_table, material_of_region, parameter_value
from .plates import moved_plate, outline_tables, pixel_tables, plate_of_tables
from .samples import built_in
from .schema import OF_TIME, OPTIONS, PARAMETERS, OutputOptions, case_schema

ENDS: dict[str, Callable] = {"low": min, "high": max}  # of the values of a picture
PARTS = ("plate", "holes", "regions", "obstacles", "moved")
SECTIONS = (
    *(*PARTS, "gel", "loads", "sweep", "time", "bath"),
    *("discretisation", "output", "uncertainty"),
)


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A plate, its gel and the options of a run."""

    name: str
    """Built-in name, or the case file's name without its ending."""
    plate: Plate
    """Plate with its holes."""
    gel: AnyGel
    """Material, or those of the plate and its regions."""
    loads: Loads
    """Body force and tractions."""
    sweep: SweepOptions
    """Control, its values and branch; of swelling in time the chemical potential at its start."""
    time: TimeOptions | None
    """Times of a gel that swells in time; None for equilibria."""
    bath: BathOptions | None
    """Bath of a gel that swells in time; None for equilibria."""
    discretisation: DiscretisationOptions
    """Cloud and discretisation."""
    output: OutputOptions
    """Files to write."""
    source: dict
    """Sections ``plate``, ``holes``, ``regions`` and ``moved`` of its source.

    The section ``gel`` is among them if it names an energy.
    """
    uncertainty: dict[str, float | str] = dataclasses.field(default_factory=dict)
    """Standard deviations of inputs, see `uncertain`."""

    def cloud(self) -> Cloud:
        """The cloud of the plate, or of the plate from which it was moved.

        ValueError if it cannot be made.
        """
        return self.discretisation.cloud(self.plate.reference or self.plate)

    def model(self, cloud: Cloud | None = None) -> Model:
        """The discretised plate.

        ValueError for edges, a cloud or a support that the case does not allow. A plate whose holes
        have moved gets the cloud that it had before, placed, if that is good enough (see
        `placed`) and a new one if it is not; ``cloud`` is that former one if it was made
        already.
        """
        check_edges(self.plate)
        if not CONTROLS[self.sweep.control].moves_edges:
            check_room(self.plate)
        cloud = self.cloud() if cloud is None else cloud
        if self.plate.reference is not None:
            check_plate(self.plate)
            return self.discretisation.placed(cloud, self.plate)
        return self.discretisation.model(cloud)

    control = OldAttribute(instead="Case.problem(model).control")

    def problem(self, model: Model, *, imperfect: bool = True) -> Problem:
        """The `Problem` of the case on its ``model``, with its imperfection if ``imperfect``.

        It has the case's gel, control, contact and loads. ValueError for what swelling in time does
        not cover, and a bath that is too dry for the gel.
        """
        options = self.sweep if imperfect else dataclasses.replace(self.sweep, imperfection=0.0)
        problem = problem_by_options(model, self.gel, options, loads=self.loads.of(model))
        if self.time is None:
            return problem
        baths = self.baths()
        check_swelling(problem)
        check_numbers(problem, baths.values(), self.time.D)
        return problem.replace(control=self.time.control(baths))

    @old_arguments
    def path(self, model: Model, *, observer: Observer = UNOBSERVED) -> Path:
        """`Path` of the case's sweep, or swelling in time, on its ``model``."""
        problem = self.problem(model)
        if self.time is None:
            return sweep_by_options(problem, self.sweep, observer=observer)
        return self.swell(problem, observer=observer)

    def swell(
        self, problem: Problem, *, before: Path | None = None, observer: Observer = UNOBSERVED
    ) -> Path:
        """`Path` of the case's `problem` in time.

        It begins with the states of the path ``before``, if that is given.
        """
        start = self.sweep.mu_start if before is None else before
        options = {
            "D": self.time.D,
            "unit": self.time.unit,
            "branch": self.sweep.branch,
            "observer": observer,
        }
        return swell(problem, self.baths(), self.time.values, start=start, **options)

    def baths(self) -> dict[str | int, Bath]:
        """The `Bath` of each wetted hole, by its number, and free edge, by its name."""
        return baths(self.source, self.plate, self.bath, self.sweep.mu_start, self.time.last)

    def times(self, problem: Problem) -> list[float]:
        """The times of the states after the first one."""
        return step_times(problem, self.baths(), self.time.values, self.time.D).tolist()

    def resolved_time(self, problem: Problem) -> float:
        """`transient.resolved_time` of the case's `problem`."""
        return resolved_time(problem, self.baths(), self.sweep.mu_start, self.time.D)

    def check_equilibrium(self, command: str) -> None:
        """Raise ValueError, one line, for a case in time, which a ``command`` does not support."""
        if self.time is not None:
            raise ValueError(
                f"time: is not accepted by jaxgel {command}, which is for equilibria; remove "
                "[time] and [bath]"
            )

    def critical_points(
        self, model: Model, *, most: int = 4, observer: Observer = UNOBSERVED
    ) -> list[CriticalPoint]:
        """`critical_points` between the ends of the sweep on the branch of the dry ``model``.

        The search chooses its own steps. ValueError for an imperfection, under which no branch
        bifurcates.
        """
        self.check_equilibrium("critical")
        if self.sweep.imperfection:
            raise ValueError(
                f"sweep.imperfection: {self.sweep.imperfection:g} removes the bifurcations that "
                "are looked for; set it to 0"
            )
        return critical_points(self.problem(model), self.sweep.ends, most=most, observer=observer)

    @old_arguments
    def loop(self, model: Model, *, observer: Observer = UNOBSERVED) -> Loop:
        """`Loop` between the ends of the case's sweep, up and down, with steps of its own.

        ValueError for an imperfection, whose load is that of one branch.
        """
        self.check_equilibrium("loop")
        if self.sweep.imperfection:
            raise ValueError(
                f"sweep.imperfection: {self.sweep.imperfection:g} is not accepted here, it "
                "belongs to one branch; set it to 0"
            )
        if self.sweep.branch != "stable":
            raise ValueError(
                f"sweep.branch: {self.sweep.branch!r} is not accepted here, a loop follows the "
                "stable branch"
            )
        until_contact = self.sweep.contact == "stop"
        options = {
            "symmetry": self.sweep.symmetry,
            "until_contact": until_contact,
            "observer": observer,
        }
        return loop(self.problem(model), self.sweep.ends, **options)

    def pictures(self) -> dict[str, tuple[PixelField | WithHoles, float, float]]:
        """Pictures of the gel by parameter: the field, and its values for black and white."""
        found = {
            name: own for name, own in self.source.get("gel", {}).items() if isinstance(own, dict)
        }
        ends = {
            name: [
                own[end] if end in own else of(map(of, own["values"])) for end, of in ENDS.items()
            ]
            for name, own in found.items()
        }
        return {
            name: (parameter_value(f"gel.{name}", own, self.plate), *ends[name])
            for name, own in found.items()
        }

    def table(self) -> dict:
        """The case as a table that `from_table` reads, with every default written out.

        JSON and TOML can hold it.
        """
        matrix = matrix_of(self.gel)
        known = {
            name: own
            for name, own in named_parameters(matrix).items()
            if name in PARAMETERS and not callable(own)
        }
        numbers = {name: float(own) for name, own in known.items()}
        gel = self.source.get("gel", {}) | numbers
        options = {
            section: _given(getattr(self, section))
            for section in OPTIONS
            if getattr(self, section) is not None
        }
        if self.time is not None:
            options["sweep"] = {"mu_start": self.sweep.mu_start}
        options |= {"uncertainty": self.uncertainty}
        return (
            self.source
            | {"gel": gel}
            | {section: given for section, given in options.items() if given}
        )


def load_case(case: str | File, changes: dict[str, Any] | None = None) -> Case:
    """The `Case` of a built-in name or of a TOML file.

    ``changes`` maps sections to entries that replace its own. Raises ValueError for an unknown
    name, a file that cannot be read or is not TOML, and every wrong entry.

    >>> load_case("sample-1", {"sweep": {"steps": 3}}).sweep.values
    [-4.9678, -2.9428, -0.9178]
    """
    found, name, folder = _read(case)
    return from_table(with_changes(found, changes or {}), name, folder)


def from_table(table: dict[str, Any], name: str, folder: str | File | None = None) -> Case:
    """The `Case` of a table as described at the top of this module.

    ValueError names the section and key of a wrong entry. Drawings and a module that the table
    names are looked for in ``folder``, the module also in the working folder and where Python looks
    for modules. Without ``folder`` a table cannot name drawings.
    """
    check(table, case_schema(), "case file")
    check_time(table)
    plate, moved = table["plate"], table.get("moved", [])
    gel = pixel_tables(table.get("gel", {}), folder, "gel")
    if "sample" in plate and table.get("holes"):
        raise ValueError(
            f"holes: plate.sample = {plate['sample']!r} has its own; drop one of the two"
        )
    holes, regions = (
        outline_tables(table.get(section, []), folder, plate, section)
        for section in ("holes", "regions")
    )
    obstacles = table.get("obstacles", [])
    found = moved_plate(plate_of_tables(plate, holes, regions, obstacles, name), moved)
    material = gel_of_table(gel, found, folder or ".")
    whole = {
        key: gel[key] if callable(own) else float(own)
        for key, own in named_parameters(material).items()
    }
    regions = [
        region | ({"gel": whole | region["gel"]} if "gel" in region else {}) for region in regions
    ]
    source = {
        key: value
        for key, value in zip(PARTS, (plate, holes, regions, obstacles, moved), strict=True)
        if value
    }
    source |= (
        {"gel": gel}
        if {"energy", "kind"} & gel.keys() or any(isinstance(own, dict) for own in gel.values())
        else {}
    )
    given = {section: table.get(section, {}) for section in OPTIONS} | (
        {"sweep": start_entries(table)} if "time" in table else {}
    )
    options = {
        section: _options(kind, given[section])
        for section, kind in OPTIONS.items()
        if section in table or section not in OF_TIME
    }
    options = dict.fromkeys(OF_TIME) | options
    if regions:
        own = [
            material_of_region(region, f"regions[{i}]", material, found)
            for i, region in enumerate(regions)
        ]
        material = Composite(material, tuple(own))
    check_gel(material)
    options["sweep"].check(
        material, found, loaded=bool(options["loads"].body_force or options["loads"].traction)
    )
    case = Case(
        name, found, material, source=source, uncertainty=table.get("uncertainty", {}), **options
    )
    if case.time is not None:
        case.baths()  # ValueError for one that cannot be
    return case


def _read(case):
    """The table of a case, its name and its folder."""
    file = File(case)
    if file.suffix != ".toml" and not file.is_file():
        return built_in(case), case, "."
    return read_toml(file, "case"), file.stem, file.parent


def _options(kind, table):
    names = {entry_of(field): field.name for field in dataclasses.fields(kind)}
    values = {key: tuple(v) if isinstance(v, list) else v for key, v in table.items()}
    return kind(**{names[key]: value for key, value in values.items()})


def _given(options):
    own = {entry_of(field): getattr(options, field.name) for field in dataclasses.fields(options)}
    return {
        key: list(v) if isinstance(v, tuple) else v for key, v in own.items() if v not in (None, {})
    }
