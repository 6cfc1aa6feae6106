"""Rules of the package's structure (docs/architecture.md): imports and sources.

Contracts of imports are in pyproject.toml; the sources are checked here. Every rule gives one line
for each place that breaks it, and is tried on a copy of the package with bad modules.
"""

import ast
import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import jaxgel

ROOT = Path(__file__).parents[1]
MODULE_LINES, FUNCTION_LINES = 400, 90
CHANGES = {
    *(
        "append",
        "appendleft",
        "extend",
        "extendleft",
        "insert",
        "remove",
        "pop",
        "popleft",
        "popitem",
        "clear",
        "sort",
        "reverse",
    ),
    *(
        "add",
        "discard",
        "update",
        "difference_update",
        "intersection_update",
        "setdefault",
        "move_to_end",
        "__setitem__",
        "__delitem__",
    ),
}
CONTAINERS = re.compile(r"list|dict|set|deque|defaultdict|OrderedDict|Counter|Weak\w+")
DISPLAYS = (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp)
# arguments that a cache must not keep alive
LARGE = {"topology", "cloud", "model", "plate", "path", "case", "problem", "state"}
ENVIRONMENT = re.compile(
    r"environ\[[^\]]*\] *=[^=]|del .*environ\[|environ\.(pop|update|clear|setdefault)|environ "
    r"*\|=|putenv|unsetenv"
)


def contracts(folder):
    """import-linter's report on ``jaxgel`` in a folder, by the contracts in pyproject.toml."""
    command = [
        sys.executable,
        "-c",
        "from importlinter.cli import lint_imports_command as c; c()",
        "--no-cache",
        "--no-logo",
    ]
    done = subprocess.run(
        [*command, str(ROOT / "pyproject.toml")],
        cwd=folder,
        env={"COLUMNS": "500"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def dotted(node):
    """``a.b.c`` of an expression of names and attributes; what is neither is left out."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def faults(root):
    """Places of a package in the folder ``root`` that break a rule, one line each."""
    found = []
    for file in sorted(root.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        tree, inside = ast.parse(text), file.relative_to(root)
        lines = [*_of_imports(tree, file.parent), *_of_names(tree), *_of_functions(tree)]
        if file.name == "__init__.py" and len(inside.parts) == 2:
            lines += _of_a_face(tree, file.parent)
        if inside.parts[0] != "cli":
            lines += [
                (text.count("\n", 0, part.start()) + 1, "changes the environment")
                for part in ENVIRONMENT.finditer(text)
            ]
        if text.count("\n") > MODULE_LINES:
            lines.append((1, "a module of more than one subject"))
        found += [f"{inside.as_posix()}:{line} {what}" for line, what in lines]
    return found


def _of_imports(tree, folder):
    """Names of packages come from their public ``__init__``, those of modules from modules.

    A module takes none from the ``__init__`` of its own package.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            of_package = node.level == 2 and (node.module or "").split(".")[0]
            if of_package and "." in node.module:
                yield node.lineno, f"takes names from inside {node.module}"
            if node.level == 1 and not node.module and folder.name != "jaxgel":
                inside = [
                    alias.name
                    for alias in node.names
                    if not (folder / alias.name).exists()
                    and not (folder / f"{alias.name}.py").exists()
                ]
                yield from (
                    (node.lineno, f"takes {name} from the face of its own package")
                    for name in inside
                )
            private = [
                alias.name for alias in node.names if alias.name.startswith("_") and node.module
            ]
            if private and (of_package or node.module.startswith("_")):
                yield node.lineno, f"takes the private {private[0]} from {node.module}"


def _of_names(tree):
    """Containers at the top of a module that it changes: state that no caller sees."""
    held = set()
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
            call = isinstance(node.value, ast.Call) and CONTAINERS.fullmatch(
                dotted(node.value.func).split(".")[-1]
            )
            if call or isinstance(node.value, DISPLAYS):
                held |= {
                    name.id
                    for name in (node.targets if isinstance(node, ast.Assign) else [node.target])
                    if isinstance(name, ast.Name)
                }
    held -= {"__all__"}
    for function in ast.walk(tree):
        if not isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            continue
        shared = held - {
            n.id
            for n in ast.walk(function)
            if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
        }
        for node in ast.walk(function):
            owner = None
            if isinstance(node, ast.Subscript) and not isinstance(node.ctx, ast.Load):
                owner = node.value
            elif (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr in CHANGES
            ):
                owner = node.func.value
            elif isinstance(node, ast.Global):
                yield node.lineno, f"changes {node.names[0]}"
            if owner is not None and dotted(owner) in shared:
                yield node.lineno, f"changes {dotted(owner)}"


def _of_functions(tree):
    """Functions that fit a screen; caches that keep nothing large alive.

    Types of the arguments of public functions.
    """
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            arguments = [part for part in ast.walk(node.args) if isinstance(part, ast.arg)]
            words = {
                word.lower()
                for part in arguments
                for word in (part.arg, dotted(part.annotation or part).split(".")[-1])
            }
            if words & LARGE and {
                dotted(getattr(d, "func", d)).split(".")[-1] for d in node.decorator_list
            } & {"cache", "lru_cache"}:
                yield node.lineno, f"keeps {', '.join(sorted(words & LARGE))}"
            if node.end_lineno - node.lineno + 1 > FUNCTION_LINES:
                yield node.lineno, f"{node.name} does not fit a screen"
    public = [
        tree,
        *(
            node
            for node in tree.body
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        ),
    ]
    for node in (
        node
        for part in public
        for node in part.body
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    ):
        arguments = [
            *node.args.posonlyargs,
            *node.args.args,
            *node.args.kwonlyargs,
            *filter(None, (node.args.vararg, node.args.kwarg)),
        ]
        bare = [
            part.arg
            for part in arguments
            if part.annotation is None and part.arg not in ("self", "cls")
        ]
        if bare and (not node.name.startswith("_") or node.name in ("__init__", "__call__")):
            yield node.lineno, f"{node.name}: {', '.join(bare)} without a type"


def _of_a_face(tree, folder):
    """``__init__`` of a package is a sentence, the imports of its names and their sorted list.

    No module is named like one of them.
    """
    names = next(
        (ast.literal_eval(node.value) for node in tree.body if isinstance(node, ast.Assign)), []
    )
    imports = [
        node
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module != "_deprecated"
    ]
    bound = {alias.asname or alias.name for node in imports for alias in node.names}
    if names != sorted(
        bound, key=lambda name: (0 if name.isupper() else 1 if name[0].isupper() else 2, name)
    ):
        yield 1, "__all__ is not the sorted list of what is imported"
    if not ast.get_docstring(tree) or any(
        not isinstance(node, (ast.ImportFrom, ast.Assign)) for node in tree.body[1:]
    ):
        yield 1, "is not a sentence and names"
    yield from (
        (1, f"{name} is a module and a name") for name in names if (folder / f"{name}.py").exists()
    )


BAD = {  # module -> text, and the faults
    "tools.py": ("", ["jaxgel.tools"]),
    "cloud/b1.py": (
        "def f():\n    from ..design import optimise",
        ["jaxgel.cloud.b1 -> jaxgel.design"],
    ),
    "linalg/b2.py": ("from ..geometry import Plate", ["jaxgel.linalg.b2 -> jaxgel.geometry"]),
    "_memo.py": (
        "from .cloud import make_cloud\n_kept = KEPT = []",
        ["jaxgel._memo -> jaxgel.cloud"],
    ),
    "cloud/b3.py": ("from .b4 import x", ["No cycles are allowed in jaxgel.cloud."]),
    "cloud/b4.py": ("def f():\n    from jaxgel.cloud.b3 import y", [".b4 -> .b3"]),
    "waves/b5.py": (
        "from . import lattice_onset\nfrom jaxgel import sweep",
        ["jaxgel.waves.b5 -> jaxgel ", "waves/b5.py:1 takes lattice_onset from the face"],
    ),
    "io/b6.py": (
        "def f():\n    import matplotlib.pyplot\n    import argparse",
        ["jaxgel.io.b6 -> matplotlib", "jaxgel.io.b6 -> argparse"],
    ),
    "cli/b7.py": ("from matplotlib import pyplot", ["jaxgel.cli.b7 -> matplotlib"]),
    "design/a1.py": (
        "from ..cloud.cells import x",
        ["design/a1.py:1 takes names from inside cloud.cells"],
    ),
    "design/a2.py": ("from ..cloud import _cut", ["design/a2.py:1 takes the private _cut"]),
    "design/a3.py": ("from .._memo import _kept", ["design/a3.py:1 takes the private _kept"]),
    "c1/__init__.py": (
        '"""X."""\nfrom .a import b\n__all__ = ["b"]\nprint(b)',
        ["c1/__init__.py:1 is not a sentence"],
    ),
    "c2/__init__.py": (
        '"""X."""\nfrom .b import b\n__all__ = ["b", "a"]',
        ["c2/__init__.py:1 __all__", "c2/__init__.py:1 b is a module"],
    ),
    "c2/b.py": ("", []),
    "c3.py": ("import os\nos.environ['A'] = '1'", ["c3.py:2 changes the env"]),
    "c4.py": ("import os\ndel os.environ['A']", ["c4.py:2 changes the env"]),
    "c5.py": ("from os import environ\nenviron.setdefault('A', '1')", ["c5.py:2 changes the env"]),
    "c6.py": ("K = {}\ndef f(x: int):\n    K[x] = 1", ["c6.py:3 changes K"]),
    "c7.py": ("K: list = []\ndef f(x: int):\n    K.append(x)", ["c7.py:3 changes K"]),
    "c8.py": (
        "import collections\nK = collections.deque()\ndef f():\n    K.popleft()",
        ["c8.py:4 changes K"],
    ),
    "c9.py": ("K = []\ndef f():\n    global K\n    K = [1]", ["c9.py:3 changes K"]),
    "d1.py": (
        "import functools\n@functools.cache\ndef f(topology: str): ...",
        ["d1.py:3 keeps topology"],
    ),
    "d2.py": (
        "import functools\n@functools.lru_cache(maxsize=8)\ndef f(x: Model): ...",
        ["d2.py:3 keeps model"],
    ),
    "d3.py": ("def f(x: int, y, *, z=1): ...", ["d3.py:1 f: y, z without"]),
    "d4.py": ("class A:\n    def f(self, *y): ...", ["d4.py:2 f: y without"]),
    "d5.py": ("x = 1\n" * 401, ["d5.py:1 a module of more than one subject"]),
    "d6.py": ("def f():\n" + "    x = 1\n" * 90, ["d6.py:1 f does not fit"]),
}
GOOD = {
    "_kept.py": "import functools\n@functools.cache\ndef once(): ...",
    "e1.py": "NAMES = ['a']\ndef cut(p: str):\n    NAMES = []\n    NAMES.append(p)",
    "e2.py": "import os\nsize = os.environ.get('SIZE') or os.environ['SIZE'] == '1'",
    "cli/e3.py": "import os\nos.environ['A'] = 'b'",
    "cloud/e4.py": "from ..geometry import Plate\nfrom .cells import _part",
}


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """A copy of the package with modules of ``BAD`` and ``GOOD``, both reports."""
    folder = tmp_path_factory.mktemp("broken")
    shutil.copytree(
        ROOT / "jaxgel", folder / "jaxgel", ignore=shutil.ignore_patterns("__pycache__")
    )
    for name, text in [(name, text) for name, (text, _) in BAD.items()] + list(GOOD.items()):
        (folder / "jaxgel" / name).parent.mkdir(exist_ok=True)
        (folder / "jaxgel" / name).write_text(text + "\n")
    code, report = contracts(folder)
    return code, report, faults(folder / "jaxgel")


def test_the_package_keeps_the_contracts_of_its_imports():
    code, report = contracts(ROOT)
    assert code == 0, report


def test_the_package_keeps_the_rules_of_its_source():
    assert faults(ROOT / "jaxgel") == []


def unnamed(function):
    """Parameters of a function that its docstring does not name in backquotes."""
    named = re.findall(r"`+([^`]+)`+", inspect.getdoc(function) or "")
    return [name for name in inspect.signature(function).parameters if name not in named]


def test_docstrings_of_public_functions_name_their_arguments():
    functions = {name: getattr(jaxgel, name) for name in jaxgel.__all__}
    functions = {
        name: function for name, function in functions.items() if not inspect.isclass(function)
    }
    assert len(functions) > 50
    assert {
        name: unnamed(function) for name, function in functions.items() if unnamed(function)
    } == {}


def test_an_argument_without_a_line_in_the_docstring_is_reported():
    def scaled(field, factor, *, origin):
        """The `field` times a factor about the ``origin``."""

    assert unnamed(scaled) == ["factor"]


@pytest.mark.thorough
def test_every_broken_rule_is_reported_and_nothing_else(broken):
    code, report, found = broken
    everything = [*report.splitlines(), *found]
    missed = [
        part
        for _, parts in BAD.values()
        for part in parts
        if not any(part in f"{line} " for line in everything)
    ]
    assert code != 0 and not missed, "\n".join([*missed, report, *found])
    assert len(found) == sum(":" in part for _, parts in BAD.values() for part in parts)
    assert not any(
        name.removesuffix(".py").replace("/", ".") + " ->" in report
        for name in GOOD
        if not name.startswith("cloud")
    )
