"""The JSON schema of a case file and the options of a run."""

import ast
import dataclasses
import functools
import inspect
import sys
from typing import Any

from .._validation import (
    FLAG,
    NUMBER,
    PAIR,
    POSITIVE,
    TEXT,
    check_options,
    entry_of,
    exactly_one,
    listed,
    not_both,
    option,
    tabled,
    whole,
    word,
)
from ..continuation import SweepOptions
from ..discretisation import DiscretisationOptions
from ..geometry import CONDITIONS, EDGES, KINDS, KINEMATICS, OBSTACLES, Plate
from ..io import IMAGE, MASK, OUTLINE
from ..materials import Gel, Pnipam, Polyelectrolyte, named_parameters
from ..mechanics import Loads
from ..transient import BathOptions, TimeOptions
from .samples import sample_names

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def _number_or_picture(number):
    return {"type": ["number", "object"], "if": {"type": "object"}, "then": MASK, "else": number}


GELS = {kind.__name__.lower(): kind for kind in (Gel, Pnipam, Polyelectrolyte)}
PARAMETERS = {
    "Nv": _number_or_picture(POSITIVE)
    | {"description": "Chains per dry volume times the volume of a solvent molecule."},
    "chi": _number_or_picture(NUMBER | {"exclusiveMaximum": 2.0})
    | {"description": "Flory's parameter of mixing; 0 in an athermal solvent."},
    "temperature": _number_or_picture(NUMBER | {"minimum": 0.0, "maximum": 100.0})
    | {"description": "Temperature, degrees Celsius."},
    "pH": _number_or_picture(NUMBER | {"minimum": 0.0, "maximum": 14.0})
    | {"description": "pH of the bath."},
    "salt": _number_or_picture(NUMBER | {"minimum": 0.0})
    | {"description": "Salt concentration of the bath, mol/l."},
    "acid_fraction": _number_or_picture(NUMBER | {"minimum": 0.0, "maximum": 1.0})
    | {"description": "Acidic groups in the volume of a solvent molecule of dry polymer."},
    "pKa": _number_or_picture(NUMBER) | {"description": "pKa of the acidic groups."},
    "solvent_volume": _number_or_picture(POSITIVE)
    | {"description": "Volume of a solvent molecule, nm^3."},
}  # of all kinds of gel
GEL = {name: PARAMETERS[name] for name in ("Nv", "chi")}
ELASTOMER = {
    "Nv": _number_or_picture(POSITIVE) | {"description": "Shear modulus, kT/v."},
    "bulk": _number_or_picture(POSITIVE) | {"description": "Bulk modulus, kT/v."},
}
ENERGY = {
    "type": "string",
    "pattern": r"^[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*$",
    "title": "text of the form module:function",
    "description": (
        "Own energy: module:function, called with all numbers of this section; returns the gel."
    ),
}


@functools.cache
def case_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a case file, a dict."""
    wetted, filled = _hole(WETTED_HOLE, {}), _hole(MATERIAL, exactly_one(tuple(MATERIAL)))
    sections = {
        "plate": _plate(),
        "holes": listed(wetted),
        "regions": listed(filled),
        "gel": _gel(),
    }
    sections["obstacles"] = listed(_obstacle())
    sections["moved"] = listed({"type": "object"} | not_both(("angle", "angle_deg"))) | {
        "description": "Parameters that replace those of each hole."
    }
    sections |= {section: _options(kind) for section, kind in OPTIONS.items()} | {"bath": _bath()}
    sections["uncertainty"] = UNCERTAINTY
    title = "A jaxgel case: lengths in mm, angle in radians or angle_deg in degrees, mu in kT"
    needed = {"dependentRequired": {"time": ["bath"], "bath": ["time"]}}
    return {"$schema": DIALECT, "title": title} | tabled(sections, ["plate"]) | needed


@functools.cache
def field_texts(cls: type) -> dict[str, str]:
    """Field -> what is written under it in the source of a dataclass, in one line."""
    texts, name = {}, None
    for line in _classes(cls.__module__)[cls.__name__].body:
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            name = line.target.id
        elif (
            name is not None and isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)
        ):
            texts[name], name = " ".join(str(line.value.value).split()), None
        else:
            name = None
    return texts


def hole_texts(kind: str) -> dict[str, str]:
    """Entry of a hole of a kind -> what it means."""
    texts = field_texts(KINDS[kind])
    return texts | (
        {"angle_deg": texts["angle"].replace("rad.", "degrees.")} if "angle" in texts else {}
    )


@functools.cache
def _classes(module):
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _plate():
    """A sample's name, or a plate of one's own."""
    name = word(sample_names())
    own = {
        key: rule | {"description": field_texts(Plate)[key]} for key, rule in PLATE.items()
    } | WETTED_EDGES
    own = tabled({"sample": name} | own, ["width", "height"])
    return {
        "type": "object",
        "if": {"required": ["sample"]},
        "then": tabled(
            {"sample": name}
            | {
                key: own["properties"][key]
                for key in ("kinematics", "axial_stretch", *WETTED_EDGES)
            }
        ),
        "else": own,
    }


def _hole(others, rule):
    """The kind decides about an outline's own entries.

    The ``others`` and the ``rule`` of these are those of holes or of regions.
    """
    kinds = {kind: _parameters(kind) for kind in KINDS} | {"outline": OUTLINE, "image": IMAGE}
    of_any_kind: dict = {key: {} for key in others}  # what they may be is said once, for all kinds
    kinds = {
        kind: rule | {"properties": rule["properties"] | of_any_kind}
        for kind, rule in kinds.items()
    }
    rules = [
        {"if": {"properties": {"kind": {"const": kind}}}, "then": rule}
        for kind, rule in kinds.items()
    ]
    return {
        "type": "object",
        "required": ["kind"],
        "properties": {"kind": word(kinds)} | others,
        "allOf": rules,
    } | rule


def _bath():
    """A bath; its mu is needed."""
    return _options(BathOptions) | {"required": ["mu"]} | not_both(("times", "ramp"))


def _obstacle():
    """The kind decides about an obstacle's own entries."""
    rules = []
    for kind, cls in OBSTACLES.items():
        entries = {
            name: _array(shape, NUMBER) | {"description": field_texts(cls)[name]}
            for name, shape in cls.shapes.items()
        }
        rule = tabled({"kind": {"const": kind}} | entries, ["kind", *cls.shapes])
        rules.append({"if": {"properties": {"kind": {"const": kind}}}, "then": rule})
    return {
        "type": "object",
        "required": ["kind"],
        "properties": {"kind": word(OBSTACLES)},
        "allOf": rules,
    }


def _parameters(kind):
    cls = KINDS[kind]
    properties = {
        name: _array(shape, POSITIVE if name in cls.positive else NUMBER)
        | {"description": field_texts(cls)[name]}
        for name, shape in cls.shapes.items()
    }
    required = [
        field.name for field in dataclasses.fields(cls) if field.default is dataclasses.MISSING
    ]
    degrees = (
        {"angle_deg": NUMBER | {"description": hole_texts(kind)["angle_deg"]}}
        if "angle" in properties
        else {}
    )
    rule = tabled({"kind": {"const": kind}} | properties | degrees, ["kind", *required])
    return rule | not_both(("angle", "angle_deg")) if degrees else rule


def _array(shape, item):
    for length in reversed(shape):
        item = listed(item, length, length) if isinstance(length, int) else listed(item)
    return dict(item)


def _gel():
    """The kind decides about the other entries.

    Without an energy of one's own only its parameters are known.
    """
    kind = {
        "kind": word(GELS)
        | {"description": "Gel that follows Flory and Rehner, PNIPAM or a polyelectrolyte."}
    }
    own = {
        "type": "object",
        "properties": kind | GEL | {"energy": ENERGY},
        "additionalProperties": NUMBER,
    }
    rule = {
        "type": "object",
        "if": {"required": ["energy"]},
        "then": own,
        "else": tabled(kind | GEL | {"energy": ENERGY}),
    }
    for name, cls in GELS.items():
        if cls is not Gel:
            parameters = {key: PARAMETERS[key] for key in named_parameters(cls())}
            this = {"properties": {"kind": {"const": name}}, "required": ["kind"]}
            rule = {"type": "object", "if": this, "then": tabled(kind | parameters), "else": rule}
    return rule


def _options(cls):
    properties = {}
    for field in dataclasses.fields(cls):
        default = field.metadata.get("filled") if field.default is None else field.default
        own = field.metadata.get("schema", {}) | {
            "description": field_texts(cls).get(field.name, "")
        }
        properties[entry_of(field)] = own | (
            {} if default in (None, dataclasses.MISSING) else {"default": default}
        )
    return tabled(properties)


def _or_free(kind, rule):
    """What a rule for a kind of values accepts, or "free"."""
    return {
        "type": [kind, "string"],
        "if": {"type": "string"},
        "then": word(["free"]),
        "else": rule,
    }


MATERIAL = {
    "gel": {"type": "object", "properties": PARAMETERS, "additionalProperties": NUMBER}
    | {"description": "The gel of a region: what differs from that of the plate."},
    "elastomer": tabled(ELASTOMER, list(ELASTOMER))
    | {"description": "A passive material in place of a gel; it takes no solvent."},
}
WETTED_HOLE = {
    "wet": FLAG
    | {
        "description": "Whether the bath wets the hole, of swelling in time; false seals it.",
        "default": True,
    },
    "bath": _bath()
    | {"description": "A bath of the hole's own in place of that of the section bath."},
}
WETTED_EDGES = {
    "wet": tabled(dict.fromkeys(EDGES, FLAG))
    | {"description": "Free edge -> false if it is sealed, of swelling in time."},
    "bath": tabled(dict.fromkeys(EDGES, _bath()))
    | {"description": "Free edge -> a bath of its own in place of that of the section bath."},
}
UNCERTAINTY = {
    "type": "object",
    "additionalProperties": {
        "type": ["number", "string"],
        "if": {"type": "number"},
        "then": POSITIVE,
    },
    "description": (
        "Input, such as Nv, semi_axes or holes[1].angle_deg -> its standard deviation, a number "
        "or a share as '5 %'."
    ),
}
_CONDITION = word(CONDITIONS)
PLATE = {
    "width": POSITIVE,
    "height": POSITIVE,
    "edges": {
        "type": ["string", "object"],
        "if": {"type": "object"},
        "then": tabled(dict.fromkeys(EDGES, _CONDITION)),
        "else": _CONDITION,
    },
    "kinematics": word(KINEMATICS),
    "axial_stretch": POSITIVE,
    "deformation": _or_free("array", listed(listed(_or_free("number", NUMBER), 2, 2), 2, 2)),
    "displacement": tabled(dict.fromkeys(EDGES, PAIR)),
    "spacing": POSITIVE,
    "nodes_per_hole": whole(3),
    "core": PAIR,
    "unit": TEXT,
}  # fields of `geometry.Plate`; the first two are required


@dataclasses.dataclass(frozen=True)
class OutputOptions:
    """What a run leaves besides its table, states and summary."""

    figures: bool = option(True, FLAG)
    """pattern.png and curves.png."""
    animation: bool = option(True, FLAG)
    """pattern.gif."""
    paraview: bool = option(True, FLAG)
    """series.pvd with a vtu file per state; with obstacles also obstacles.pvd."""

    def __post_init__(self) -> None:
        check_options("output", self)


OPTIONS = {
    "loads": Loads,
    "sweep": SweepOptions,
    "time": TimeOptions,
    "bath": BathOptions,
    "discretisation": DiscretisationOptions,
    "output": OutputOptions,
}
OF_TIME = ("time", "bath")  # sections that a case in equilibrium does not have
