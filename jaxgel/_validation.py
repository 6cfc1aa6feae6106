"""Validation of user input, with error messages that state the accepted values."""

import dataclasses
import difflib
import functools
import sys
import tomllib
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ._removed import OPTIONS


class Inadmissible(ValueError):
    """A plate, cloud, gel or control without a result.

    In a search it is an invalid design, which is logged. Every other ValueError is a mistake in a
    program, and ends the search.
    """


MAX_TOML = 2**24  # bytes of a file that a person writes


def did_you_mean(name: object, known: Iterable[str], section: str = "") -> str:
    """End of an error message for an unknown ``name``: the nearest ``known`` one, and all.

    Of an option, or an entry of a ``section`` of case files, that is gone, what replaces it.
    """
    if gone := OPTIONS.get(f"{section}{name}"):
        return gone
    known = list(known)
    alike = [one for one in known if one.lower() == str(name).lower()]
    near = alike or difflib.get_close_matches(str(name), known, n=1, cutoff=0.5)
    return (f"did you mean {near[0]!r}? " if near else "") + "accepted: " + ", ".join(known)


def finite_numbers(value: object, shape: tuple[int, ...], field: str) -> tuple:
    """``value`` as nested tuples of floats of ``shape``.

    ValueError that starts with ``field`` for what is not finite numbers.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{field}: {value!r} is not {' x '.join(map(str, shape))} finite numbers")
    return tuple(map(tuple, array.tolist())) if len(shape) == 2 else tuple(array.tolist())


def check_kind(name: str, value: object, kinds: type | tuple[type, ...], wanted: str) -> None:
    """Raise ValueError, one line with the value and what is ``wanted``, for an unexpected type.

    The class itself is refused, too.
    """
    if not isinstance(value, kinds):
        raise ValueError(f"{name}: {kind_in_words(value)} is not accepted; give {wanted}")


def kind_in_words(value: object) -> str:
    """What an argument is, for a message: the class ``Gel``, or a dict."""
    return (
        f"the class {value.__name__}"
        if isinstance(value, type)
        else f"an argument of the kind {type(value).__name__}"
    )


def read_toml(file: Path, field: str) -> dict[str, Any]:
    """The table of a TOML file.

    ValueError, one line that begins with ``field``, for a file that cannot be read or is not TOML.
    """
    try:
        content = file.read_bytes() if file.stat().st_size <= MAX_TOML else b"="
        return tomllib.loads(content.decode("utf-8-sig"))
    except OSError as problem:
        raise ValueError(f"{field}: cannot read {str(file)!r}: {problem.strerror}") from None
    # also for a number of thousands of digits, or brackets within brackets
    except (ValueError, RecursionError) as problem:
        raise ValueError(
            f"{field}: {str(file)!r} is not TOML: {' '.join(str(problem).split())}"
        ) from None


def is_number(word: str) -> bool:
    """Whether a word can be read as a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


NUMBER, POSITIVE = {"type": "number"}, {"type": "number", "exclusiveMinimum": 0.0}
FLAG, TEXT = {"type": "boolean"}, {"type": "string"}
NAMES = {
    "number": "finite number",
    "integer": "whole number",
    "string": "text",
    "object": "table",
    "array": "list",
}
BOUNDS = {
    "exclusiveMinimum": "above",
    "minimum": "of at least",
    "exclusiveMaximum": "below",
    "maximum": "of at most",
}


def word(choices: Iterable[str]) -> dict:
    """One of some names."""
    return {"type": "string", "enum": list(choices)}


MOST = 100_000  # of a whole number that says how many: more would fill the memory


def whole(least: int, most: int | None = MOST) -> dict:
    """A whole number; ``most`` None is any of at least ``least``."""
    return {"type": "integer", "minimum": least} | ({} if most is None else {"maximum": most})


def listed(item: dict, least: int = 0, most: int | None = None) -> dict:
    """A list of ``item``; ``most`` None is any number of them."""
    return (
        {"type": "array", "items": item}
        | ({"minItems": least} if least else {})
        | ({} if most is None else {"maxItems": most})
    )


def tabled(properties: dict[str, Any], required: Iterable[str] = ()) -> dict[str, Any]:
    """A table with these entries and no others.

    Unknown ones are found first, then missing ones, then wrong values.
    """
    return {
        "type": "object",
        "additionalProperties": False,
        "required": list(required),
        "properties": properties,
    }


def exactly_one(names: Iterable[str]) -> dict:
    """Rule, to be joined to that of a table, that one of some entries is given."""
    return {"oneOf": [{"required": [name]} for name in names]}


def not_both(names: Iterable[str]) -> dict:
    """Rule, to be joined to that of a table, that not all of some entries are given."""
    return {"not": {"required": list(names)}}


PAIR = listed(NUMBER, 2, 2)


def check(value: object, rule: dict, where: str) -> None:
    """Raise ValueError unless ``value`` obeys the rule: entry, value and what is accepted.

    One line. ``where`` is what the line calls the whole of ``value``.
    """
    error = next(_validator()(rule).iter_errors(value), None)
    if error is not None:
        raise ValueError(_message(error, where))


@functools.cache
def _validator():
    from jsonschema import Draft202012Validator
    from jsonschema.validators import extend

    kinds = {
        "number": lambda _, v: _is_number(v),
        "integer": lambda _, v: type(v) is int and _is_number(v),
        "array": lambda _, v: isinstance(v, list | tuple),
    }
    return extend(
        Draft202012Validator, type_checker=Draft202012Validator.TYPE_CHECKER.redefine_many(kinds)
    )


def _is_number(v):
    """Whether a value is a finite number that a float array takes."""
    return (
        abs(v) < 2**63 if type(v) is int else isinstance(v, float) and abs(v) <= sys.float_info.max
    )


def _message(error, where):
    rule, value, path = error.schema, error.instance, list(error.absolute_path)
    if path:
        where = "".join(
            f".{part}" if str(part).isidentifier() else f"[{part!r}]" for part in path
        ).removeprefix(".")
    if error.validator == "additionalProperties":
        unknown = next(key for key in value if key not in rule["properties"])
        meant = did_you_mean(unknown, rule["properties"], f"{where}.")
        return f"{where}: unknown entry {unknown!r}; {meant}"
    if error.validator in ("required", "dependentRequired"):
        needed = error.validator_value
        needed = (
            needed
            if isinstance(needed, list)
            else [name for key, names in needed.items() if key in value for name in names]
        )
        missing = next(name for name in needed if name not in value)
        own = rule["properties"][missing]
        wanted = f"give {' or '.join(accepted(own))}{_brackets([*path, missing], own)}"
        return f"{where}: {missing} is missing; {own.get('$comment', wanted)}"
    if error.validator == "not":
        return f"{where}: give one of {' and '.join(rule['not']['required'])}, not both"
    if error.validator == "oneOf":
        names = [name for choice in rule["oneOf"] for name in choice["required"]]
        found = ", ".join(name for name in names if name in value) or "none"
        return f"{where}: give one of {', '.join(names[:-1])} and {names[-1]} (found {found})"
    if "enum" in rule:
        return f"{where}: {value!r} is unknown; {did_you_mean(value, rule['enum'])}"
    words = accepted(rule)
    refused = f"neither {' nor '.join(words)}" if len(words) > 1 else f"not {words[0]}"
    return f"{where}: {value!r} is {refused}{_brackets(path, rule)}"


def _brackets(path, rule):
    """How a section is begun in TOML, if it is one."""
    if len(path) != 1 or rule.get("items", rule).get("type") != "object":
        return ""
    return f", written [[{path[0]}]]" if "items" in rule else f", written [{path[0]}]"


def accepted(rule: dict, number: str = "a") -> list[str]:
    """What a piece of schema accepts in words, a list with one text for each alternative.

    ``number`` of it, "a", "2" or "1 or more".
    """
    kind = rule.get("type")
    if "anyOf" in rule or isinstance(kind, list):
        return [
            words
            for choice in rule.get("anyOf") or [{"type": name} for name in kind or ()]
            for words in accepted(choice, number)
        ]
    if "const" in rule or kind == "boolean":
        return [repr(rule["const"])] if "const" in rule else ["true", "false"]
    if "enum" in rule:
        return [f"one of {', '.join(rule['enum'])}"]
    noun = rule["title"] if "pattern" in rule else NAMES.get(kind, "value")
    text = f"{number} {noun}{'' if number == 'a' else 's'}".lstrip()
    text += " and".join(f" {name} {rule[key]:g}" for key, name in BOUNDS.items() if key in rule)
    if "items" in rule:
        least, most = rule.get("minItems", 0), rule.get("maxItems")
        count = str(least) if least == most else f"{least} or more" if least else ""
        text += f" of {accepted(rule['items'], count)[0]}"
    return [text]


def one_of(name: str, value: object, known: Collection[str]) -> None:
    """Raise ValueError, one line from ``name`` on, for a ``value`` not among the ``known`` ones."""
    if value not in known:
        raise ValueError(f"{name}: {value!r} is not one of {', '.join(known)}")


def option(
    default: Any, rule: dict, stage: str = "", *, entry: str = "", filled: Any = None
) -> Any:
    """Field of a section: its default, the rule of its values (JSON schema), and its ``stage``.

    The stage takes it as a keyword. None, if that is the default, stands for an entry that is not
    given; ``filled`` is what the class puts there then, if it does. ``entry`` is the name in files
    if that is not the field's.
    """
    return dataclasses.field(
        default=default, metadata={"schema": rule, "stage": stage, "entry": entry, "filled": filled}
    )


def entry_of(field: dataclasses.Field) -> str:
    """The name that a field of a section has in case files."""
    return field.metadata.get("entry") or field.name


def check_options(section: str, options: Any) -> None:
    """Raise ValueError, naming section and key, for a value that its field does not accept."""
    fields = dataclasses.fields(options)
    given = {
        entry_of(f): value
        for f in fields
        if (value := getattr(options, f.name)) is not None or f.default is not None
    }
    check(
        {section: given},
        tabled({section: tabled({entry_of(f): f.metadata["schema"] for f in fields})}),
        section,
    )


def keywords_of(options: Any, stage: str) -> dict[str, Any]:
    """Name -> value of the fields of ``options`` that a stage takes as its keywords."""
    return {
        f.name: getattr(options, f.name)
        for f in dataclasses.fields(options)
        if f.metadata.get("stage") == stage
    }


# lists of a sweep -> the entries that they take the place of
LISTS = {"mu": ("mu_start", "mu_end"), "values": ("from", "to")}


def with_changes(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A case's table with ``changes``, section -> entries, in place of its own.

    A list takes the place of the case's own. Another control of the sweep replaces the former one's
    values, a list of values its ends and way back, and two ends its list. ValueError for one end,
    steps or a way back that change nothing, because the case lists its values.
    """
    changed = dict(table)
    for section, entries in changes.items():
        old = table.get(section, {})
        if not isinstance(entries, dict):
            changed[section] = entries
        elif isinstance(old, dict):
            old = _of_control(old, entries) if section == "sweep" else old
            changed[section] = old | entries
    return changed


def _of_control(sweep, entries):
    """The entries of a ``sweep`` that stay if ``entries`` replace some."""
    control = entries.get("control", sweep.get("control", "mu"))
    if control != sweep.get("control", "mu"):
        of_values = {
            "back",
            "direction",
            "obstacle",
            "displacement",
            *LISTS,
            *(end for ends in LISTS.values() for end in ends),
        } | ({"at_mu"} if control == "mu" else set())
        of_values |= {"steps"} if entries.keys() & LISTS else set()
        return {key: value for key, value in sweep.items() if key not in of_values}
    name = "mu" if control == "mu" else "values"
    ends = LISTS[name]
    if name in entries:
        return {key: value for key, value in sweep.items() if key not in (*ends, "steps", "back")}
    if all(end in entries for end in ends):
        return {key: value for key, value in sweep.items() if key != name}
    for key in (*ends, "steps", "back"):
        if key in entries and name in sweep:
            text = (
                f"{entries[key]!r} has no effect, as the case lists its values of {control}; "
                "change that list"
            )
            raise ValueError(f"sweep.{key}: {text}")
    return sweep
