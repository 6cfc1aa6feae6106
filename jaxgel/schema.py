"""The JSON schema of a case file, which every case is checked against: also for editors, and for whoever writes cases by program.

It holds for every entry by itself; what two entries must have to do with each other (an order, a hole outside the plate) is left to
`cases` and to the geometry.
"""

import ast
import dataclasses
import functools
import inspect
import sys

from .geometry import Plate
from .outline_files import OUTLINE
from .rules import NUMBER, POSITIVE, listed, tabled, word
from .samples import sample_names
from .sections import HOLES, OPTIONS, PLATE

DIALECT = "https://json-schema.org/draft/2020-12/schema"
GEL = {
    "Nv": POSITIVE | {"description": "Chains per dry volume times the volume of a solvent molecule."},
    "chi": NUMBER | {"exclusiveMinimum": 0.0, "exclusiveMaximum": 2.0, "description": "Flory's parameter of mixing."},
}
ENERGY = {
    "type": "string",
    "pattern": r"^[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*$",
    "title": "text of the form module:function",
    "description": "Own energy: module:function, called with all numbers of this section; returns the gel.",
}


@functools.cache
def case_schema():
    """The JSON schema (draft 2020-12) of a case file, a dict."""
    sections = {"plate": _plate(), "holes": listed(_hole()), "gel": _gel()}
    sections["moved"] = listed({"type": "object"}) | {"description": "Parameters that replace those of each hole."}
    sections |= {section: _options(kind) for section, kind in OPTIONS.items()}
    title = "A jaxgel case: lengths in mm, angles in radians, mu in kT"
    return {"$schema": DIALECT, "title": title} | tabled(sections, ["plate"])


@functools.cache
def field_texts(cls):
    """Field -> what is written under it in the source of a dataclass, in one line."""
    texts, name = {}, None
    for line in _classes(cls.__module__)[cls.__name__].body:
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            name = line.target.id
        elif name is not None and isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant):
            texts[name], name = " ".join(str(line.value.value).split()), None
        else:
            name = None
    return texts


@functools.cache
def _classes(module):
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _plate():
    """A sample's name, or a plate of one's own."""
    name = word(sample_names())
    own = {key: rule | {"description": field_texts(Plate)[key]} for key, rule in PLATE.items()}
    own = tabled({"sample": name} | own, ["width", "height"])
    return {"type": "object", "if": {"required": ["sample"]}, "then": tabled({"sample": name}), "else": own}


def _hole():
    """The kind decides about the other entries."""
    kinds = {kind: _parameters(kind) for kind in HOLES} | {"outline": OUTLINE}
    rules = [{"if": {"properties": {"kind": {"const": kind}}}, "then": rule} for kind, rule in kinds.items()]
    return {"type": "object", "required": ["kind"], "properties": {"kind": word(kinds)}, "allOf": rules}


def _parameters(kind):
    cls = HOLES[kind]
    properties = {
        name: _array(shape, POSITIVE if name in cls.positive else NUMBER) | {"description": field_texts(cls)[name]}
        for name, shape in cls.shapes.items()
    }
    required = [field.name for field in dataclasses.fields(cls) if field.default is dataclasses.MISSING]
    return tabled({"kind": {"const": kind}} | properties, ["kind", *required])


def _array(shape, item):
    for length in reversed(shape):
        item = listed(item, length, length) if isinstance(length, int) else listed(item)
    return dict(item)


def _gel():
    """Without an energy of one's own only Nv and chi are known."""
    own = {"type": "object", "properties": GEL | {"energy": ENERGY}, "additionalProperties": NUMBER}
    return {"type": "object", "if": {"required": ["energy"]}, "then": own, "else": tabled(GEL | {"energy": ENERGY})}


def _options(cls):
    properties = {}
    for field in dataclasses.fields(cls):
        properties[field.name] = field.metadata.get("schema", {}) | {"description": field_texts(cls).get(field.name, "")}
        properties[field.name] |= {} if field.default in (None, dataclasses.MISSING) else {"default": field.default}
    return tabled(properties)
