"""The JSON schema of a case file, made from the fields that `cases` checks: for editors, and for whoever writes cases by program.

It holds for every entry by itself; what two entries must have to do with each other (an order, a hole outside the plate) is left to
`cases` and to the geometry.
"""

import ast
import dataclasses
import functools
import inspect
import textwrap

from .cases import HOLES, NUMBER, OPTIONS, PLATE, POSITIVE
from .edges import CONDITIONS, EDGES
from .geometry import Plate
from .samples import sample_names

DIALECT = "https://json-schema.org/draft/2020-12/schema"
GEL = {
    "Nv": POSITIVE | {"description": "Chains per dry volume times the volume of a solvent molecule."},
    "chi": NUMBER | {"exclusiveMinimum": 0.0, "exclusiveMaximum": 2.0, "description": "Flory's parameter of mixing."},
}
ENERGY = {
    "type": "string",
    "pattern": r"^[^:]+:[^:]+$",
    "description": "Own energy: module:function, called with all numbers of this section; returns the gel.",
}


def case_schema():
    """The JSON schema (draft 2020-12) of a case file, a dict."""
    sections = {"plate": _plate(), "holes": {"type": "array", "items": {"oneOf": [_hole(kind) for kind in HOLES]}}, "gel": _gel()}
    sections["moved"] = {"type": "array", "items": {"type": "object"}, "description": "Parameters that replace those of each hole."}
    sections |= {section: _options(kind) for section, kind in OPTIONS.items()}
    title = "A jaxgel case: lengths in mm, angles in radians, mu in kT"
    return {"$schema": DIALECT, "title": title} | _object(sections, ["plate"])


@functools.cache
def field_texts(cls):
    """Field -> what is written under it in the source of a dataclass, in one line."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
    texts, name = {}, None
    for line in getattr(body, "body", ()):
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            name = line.target.id
        elif name is not None and isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant):
            texts[name], name = " ".join(str(line.value.value).split()), None
        else:
            name = None
    return texts


def _object(properties, required=()):
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def _plate():
    condition = {"type": "string", "enum": list(CONDITIONS)}
    edges = {"anyOf": [condition, _object(dict.fromkeys(EDGES, condition))]}
    rules = PLATE | {"edges": edges}
    own = _object({key: rule | {"description": field_texts(Plate)[key]} for key, rule in rules.items()}, ("width", "height"))
    return {"oneOf": [_object({"sample": {"type": "string", "enum": sample_names()}}, ["sample"]), own]}


def _hole(kind):
    cls = HOLES[kind]
    properties = {
        name: _array(shape, POSITIVE if name in cls.positive else NUMBER) | {"description": field_texts(cls)[name]}
        for name, shape in cls.shapes.items()
    }
    required = [field.name for field in dataclasses.fields(cls) if field.default is dataclasses.MISSING]
    return _object({"kind": {"const": kind}} | properties, ["kind", *required]) | {"title": kind}


def _array(shape, item):
    for length in reversed(shape):
        item = {"type": "array", "items": item} | ({"minItems": length, "maxItems": length} if isinstance(length, int) else {})
    return dict(item)


def _gel():
    """Without an energy of one's own only Nv and chi are known."""
    own = {"type": "object", "properties": GEL | {"energy": ENERGY}, "required": ["energy"], "additionalProperties": NUMBER}
    return {"oneOf": [_object(GEL), own]}


def _options(cls):
    properties = {}
    for field in dataclasses.fields(cls):
        properties[field.name] = field.metadata.get("schema", {}) | {"description": field_texts(cls).get(field.name, "")}
        properties[field.name] |= {} if field.default in (None, dataclasses.MISSING) else {"default": field.default}
    return _object(properties)
