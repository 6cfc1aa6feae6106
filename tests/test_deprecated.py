"""Names of version 0.2: the warning or error at the user's line, and the tables of CHANGELOG.md."""

import ast
import importlib
import inspect
import re
import tomllib
import warnings
from pathlib import Path

import pytest

import jaxgel
from jaxgel._deprecated import RENAMED, RENAMED_ARGUMENTS, OldAttribute
from jaxgel._removed import ARGUMENTS, CALLS, OPTIONS, REMOVED
from jaxgel.cases import Case, load_case
from jaxgel.cli.parser import parse

ROOT = Path(__file__).parents[1]
CLASSES = {
    "Path": jaxgel.Path,
    "CriticalPoint": jaxgel.CriticalPoint,
    "Loop": jaxgel.Loop,
    "Case": Case,
    "Plate": jaxgel.Plate,
    "Topology": jaxgel.cloud.Topology,
}
ATTRIBUTES = {
    f"{owner}.{name}": kept
    for owner, one in CLASSES.items()
    for name, kept in vars(one).items()
    if isinstance(kept, OldAttribute)
}
SECTION = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1]
RENAMED_ROWS, REMOVED_ROWS, OTHERS = SECTION.split("| 0.2 | 0.3 |\n|---|---|\n")[1:]


def found(name):
    """The object of a dotted name of `jaxgel`, a package of it or `jaxgel` itself."""
    home, _, last = name.rpartition(".")
    return getattr(importlib.import_module(f"jaxgel.{home}" if home else "jaxgel"), last)


def functions():
    """Functions and methods of jaxgel that take arguments of version 0.2, by their names."""
    for name in {*ARGUMENTS, *(name for name, _ in RENAMED_ARGUMENTS)}:
        owner, _, method = name.rpartition(".")
        packages = [
            importlib.import_module(f"jaxgel.{file.parent.name}")
            for file in (ROOT / "jaxgel").glob("*/__init__.py")
        ]
        homes = [
            package for package in packages if (owner or name) in getattr(package, "__all__", ())
        ]
        one = getattr(homes[0], owner or name)
        yield name, getattr(one, method) if owner else one


def left_of(rows):
    """Names in the left column of a table; arguments as ``function(argument=)``."""
    for row in rows.splitlines():
        if row.startswith("| "):
            left, right = row.split(" | ", 1)
            for code in re.findall(r"`([^`]+)`", left):
                call = re.fullmatch(r"([\w.]+)\(((?:\w+=(?:, )?)+)\)", code)
                names = (
                    [f"{call[1]}({part})" for part in call[2].split(", ")]
                    if call
                    else [code.split("(")[0]]
                )
                yield from ((name, right) for name in names)


@pytest.mark.parametrize("text", ["jaxgel.materials.voigt", "from jaxgel.materials import voigt"])
def test_a_renamed_name_is_the_new_one_with_a_warning_at_the_users_line(text):
    code = compile(f"\n\n{text}", "study.py", "exec")
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        exec(code, {"jaxgel": jaxgel})
    assert [(one.filename, one.lineno, one.category) for one in given] == [
        ("study.py", 3, FutureWarning)
    ]
    assert str(given[0].message) == (
        "jaxgel.materials.voigt is jaxgel.paper.voigt since jaxgel 0.3; the old name goes in 0.5"
    )


def test_every_renamed_name_is_its_successor():
    for old, new in RENAMED.items():
        with pytest.warns(
            FutureWarning, match=re.escape(f"jaxgel.{old} is jaxgel.{new} since")
        ) as given:
            assert found(old) is found(new)
        assert given[0].filename == __file__


@pytest.mark.parametrize("name", REMOVED)
def test_a_removed_name_says_what_replaces_it(name):
    says = re.escape(
        f"jaxgel.{name} is gone since jaxgel 0.3; "
        + (f"use {REMOVED[name]}" if REMOVED[name] else "nothing")
    )
    with pytest.raises(AttributeError, match=says):
        found(name)
    home, _, last = f"jaxgel.{name}".rpartition(".")
    with pytest.raises(ImportError, match=says):
        exec(f"from {home} import {last}")


def test_names_that_never_were_have_pythons_own_errors():
    with pytest.raises(AttributeError, match=r"module 'jaxgel\.waves' has no attribute 'wave'"):
        _ = jaxgel.waves.wave
    with pytest.raises(ImportError, match=r"cannot import name 'wave' from 'jaxgel\.waves'"):
        from jaxgel.waves import wave  # noqa: F401
    assert not hasattr(jaxgel, "wave")
    assert not hasattr(jaxgel.materials, "largest_mu")


def test_renamed_arguments_and_attributes_have_the_warning_too():
    class State:
        mu = -1.0
        potential = OldAttribute("mu")

    says = "the argument mu_end of continue_branch is end since"
    with pytest.warns(FutureWarning, match=says) as given, pytest.raises(ValueError, match="path"):
        jaxgel.continue_branch([], mu_end=-2.0)
    assert given[0].filename == __file__
    with pytest.warns(FutureWarning, match="State.potential is mu since") as given:
        assert State().potential == -1.0
    assert given[0].filename == __file__


def test_old_arguments_of_every_function_are_told_or_taken():
    for name, function in functions():
        parameters = inspect.signature(function).parameters
        for argument, instead in ARGUMENTS.get(name, {}).items():
            assert argument not in parameters
            with pytest.raises(
                TypeError,
                match=re.escape(
                    f"{argument} of {name} is gone since jaxgel 0.3; {'use ' * bool(instead)}"
                ),
            ):
                function(**{argument: None})
        assert {new for (of, _), new in RENAMED_ARGUMENTS.items() if of == name} <= set(parameters)
    for name, called in CALLS.items():
        with pytest.raises(
            TypeError, match=re.escape(f"{name} has other arguments since jaxgel 0.3: {called}")
        ):
            getattr(jaxgel, name)(*range(5))


def test_every_old_attribute_has_its_successor():
    for name, kept in ATTRIBUTES.items():
        owner = CLASSES[name.split(".")[0]]
        fields = {*dir(owner), *getattr(owner, "__dataclass_fields__", ())}
        assert kept.new in fields if kept.new else kept.instead
        if not kept.new:
            with pytest.raises(AttributeError, match=f"{name} is gone since jaxgel 0.3; use"):
                getattr(object.__new__(owner), name.split(".")[1])


def test_options_and_entries_that_are_gone_say_so(tmp_path):
    for option in (option for option in OPTIONS if option.startswith("--")):
        with pytest.raises(
            ValueError, match=re.escape(f"is not an option of run; {OPTIONS[option]}")
        ):
            parse(["run", "sample-1", option, "x"])
    for entry in (option for option in OPTIONS if not option.startswith("--")):
        section, key = entry.split(".")
        file = tmp_path / "case.toml"
        header = "" if section == "plate" else f"[{section}]\n"
        file.write_text(f'[plate]\nwidth = 4.0\nheight = 4.0\n{header}{key} = "x"\n')
        with pytest.raises(
            ValueError, match=re.escape(f"{section}: unknown entry {key!r}; {OPTIONS[entry]}")
        ):
            load_case(file)


def test_the_changes_name_what_was_renamed_and_nothing_else():
    renamed = {*RENAMED, *(name for name, kept in ATTRIBUTES.items() if kept.new)}
    renamed |= {f"{name}({old}=)" for name, old in RENAMED_ARGUMENTS}
    assert {name for name, _ in left_of(RENAMED_ROWS)} == renamed


def test_the_changes_name_what_was_removed_and_nothing_else():
    removed = {*REMOVED, *OPTIONS, *(name for name, kept in ATTRIBUTES.items() if not kept.new)}
    removed |= {f"{name}({old}=)" for name, gone in ARGUMENTS.items() for old in gone}
    named = dict(left_of(REMOVED_ROWS))
    of_problem = {
        name for name in removed if re.search(r"\((model|gel|loads|control|contact)=\)", name)
    }  # one row has them for all
    assert removed - of_problem <= set(named)
    assert set(named) - removed <= {"mu=", 'axial_stretch="free"'}
    without = {name for name in REMOVED if not REMOVED[name]}
    assert all(named[name].startswith("none") for name in without)


def test_no_file_of_the_project_has_an_old_name():
    """By reading: doctests, notebooks and studies raise errors only if they run."""
    old = {tuple(name.split(".")) for name in (*RENAMED, *REMOVED) if "." in name}
    last = {(package, name) for package, name in old}
    for folder in ("jaxgel", "benchmarks", "design", "docs", "tests"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            if file == Path(__file__):
                continue
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom):
                    home = (node.module or "").split(".")[-1]
                    assert not {(home, alias.name) for alias in node.names} & last, file
                if isinstance(node, ast.Attribute) and isinstance(
                    node.value, (ast.Name, ast.Attribute)
                ):
                    home = node.value.id if isinstance(node.value, ast.Name) else node.value.attr
                    assert (home, node.attr) not in last, (file, node.lineno)
    for file in [
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "notebooks").glob("*.ipynb"),
        ROOT / "README.md",
    ]:
        text = file.read_text(encoding="utf-8")
        # ahead: in a.b.c there are two pairs
        assert not set(re.findall(r"\b(\w+)(?=\.(\w+))", text)) & last, file


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {project['version']}\n" in citation
    assert SECTION.startswith(f"{project['version']}\n")
