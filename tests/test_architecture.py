"""The rules of the package's structure (docs/architecture.md), read from its source by ``ast``.

Every rule is a function of the modules that gives one line for each place that breaks it; each is also tried on a small bad example.
"""

import ast
import graphlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1] / "jaxgel"
PACKAGES = [
    *("materials", "geometry", "linalg", "controls", "cloud", "discretisation", "mechanics", "symmetry", "equilibrium", "continuation"),
    *("bifurcation", "waves", "observables", "io", "design", "plotting", "cases", "paper", "cli"),
]
INDEPENDENT = ("materials", "geometry", "linalg")  # know none of the others
MODULE_LINES, FUNCTION_LINES = 300, 70
FEWEST, MOST = 3, 18  # modules of a package besides its face
CONTAINERS = {
    "list",
    "dict",
    "set",
    "deque",
    "defaultdict",
    "OrderedDict",
    "Counter",
    "WeakKeyDictionary",
    "WeakValueDictionary",
    "WeakSet",
}
CHANGES = {
    *("append", "appendleft", "extend", "extendleft", "insert", "remove", "pop", "popleft", "popitem", "clear", "sort", "reverse"),
    *("add", "discard", "update", "difference_update", "intersection_update", "setdefault", "move_to_end", "__setitem__", "__delitem__"),
}
WHERE = {  # who may import a library: packages, or single modules
    "matplotlib": {"plotting", "paper", "cli"},
    "jsonschema": {"cases", "_validation"},
    "argparse": {"cli"},
}
LARGE = {"topology", "cloud", "model", "plate", "path", "case", "problem", "state"}  # arguments that a cache must not keep alive
PUBLIC_UNDERSCORES = {"_asdict", "_fields", "_make", "_replace"}  # of a named tuple


class Module(NamedTuple):
    """A module by its dotted name inside ``jaxgel``; that of ``jaxgel/__init__.py`` is empty."""

    name: str
    is_package: bool
    text: str
    tree: ast.Module

    @property
    def package(self) -> str:
        """First part of the name."""
        return self.name.split(".")[0]


class Import(NamedTuple):
    """``from module import name``, with ``module`` inside jaxgel; ``name`` is empty for ``import jaxgel.module``."""

    module: str
    name: str
    bound: str
    line: int


def modules_of(sources: dict[str, str]) -> dict[str, Module]:
    """Modules by name, from their texts by path below ``jaxgel/``."""
    made = {}
    for path, text in sources.items():
        parts = path.removesuffix(".py").split("/")
        is_package = parts[-1] == "__init__"
        name = ".".join(parts[:-1] if is_package else parts)
        made[name] = Module(name, is_package, text, ast.parse(text))
    return made


@pytest.fixture(scope="session")
def modules():
    """All modules of the package."""
    return modules_of({file.relative_to(ROOT).as_posix(): file.read_text(encoding="utf-8") for file in sorted(ROOT.rglob("*.py"))})


def imports(module: Module, modules: dict[str, Module]) -> Iterator[Import]:
    """What a module imports from jaxgel, by relative or absolute imports, at its top or inside functions; not for type checkers alone."""
    typing = {
        id(part)
        for node in ast.walk(module.tree)
        if isinstance(node, ast.If) and dotted(node.test) == "TYPE_CHECKING"
        for part in ast.walk(node)
    }
    for node in ast.walk(module.tree):
        if id(node) in typing:
            continue
        if isinstance(node, ast.ImportFrom):
            if node.level:
                parts = module.name.split(".") if module.name else []
                parts = parts[: len(parts) - node.level + module.is_package]
                target = ".".join([*parts, *(node.module.split(".") if node.module else [])])
            elif node.module == "jaxgel" or (node.module or "").startswith("jaxgel."):
                target = node.module.removeprefix("jaxgel").removeprefix(".")
            else:
                continue
            for alias in node.names:
                inner = f"{target}.{alias.name}".removeprefix(".")
                here, name = (inner, "") if inner in modules else (target, alias.name)
                yield Import(here, name, alias.asname or alias.name, node.lineno)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name == "jaxgel" or alias.name.startswith("jaxgel."):
                    yield Import(alias.name.removeprefix("jaxgel").removeprefix("."), "", alias.asname or "jaxgel", node.lineno)


def libraries(module: Module) -> Iterator[tuple[str, int]]:
    """Dotted names that a module imports from elsewhere: ``from jax import lax`` is ``jax.lax``."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield from ((f"{node.module}.{alias.name}", node.lineno) for alias in node.names)


def dotted(node: ast.AST) -> str:
    """``a.b.c`` of an expression of names and attributes; what is neither is left out."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def place(module: Module, line: int) -> str:
    """``jaxgel.cloud.cells:12``."""
    return f"jaxgel{'.' * bool(module.name)}{module.name}:{line}"


def rank(name: str) -> int:
    """Position in the order of imports: private modules are first, ``jaxgel/__init__`` and ``__main__`` last."""
    head = name.split(".")[0]
    if head in PACKAGES:
        return PACKAGES.index(head) + 1
    return 0 if head.startswith("_") and not head.startswith("__") else len(PACKAGES) + 1


# The rules.


def unknown_packages(modules: dict[str, Module]) -> list[str]:
    """Public modules that are in none of the packages."""
    return [
        f"jaxgel.{name}: not one of the packages"
        for name in modules
        if name.strip("_") == name and name and name.split(".")[0] not in PACKAGES
    ]


def against_the_order(modules: dict[str, Module]) -> list[str]:
    """Imports of a package further right; materials, geometry and linalg import private modules only."""
    broken = []
    for module in modules.values():
        for found in imports(module, modules):
            head = found.module.split(".")[0]
            outside = module.package != head and module.package in INDEPENDENT and rank(found.module) > 0
            if outside or rank(found.module) > rank(module.name):
                broken.append(f"{place(module, found.line)} imports jaxgel.{found.module}")
    return broken


def circles(modules: dict[str, Module]) -> list[str]:
    """A circle of modules that import each other, also inside functions; one at a time."""
    graph = {
        module.name: {found.module for found in imports(module, modules) if found.module != module.name} for module in modules.values()
    }
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return [" -> ".join(f"jaxgel.{name}" for name in reversed(error.args[1]))]
    return []


def private_names(modules: dict[str, Module]) -> list[str]:
    """Names with a leading underscore that are taken from another package, by an import or as an attribute of what is imported."""
    broken = []
    for module in modules.values():
        bound = {}
        for found in imports(module, modules):
            parts = found.module.split(".")
            if parts[0] == module.package and rank(found.module):
                continue
            bound[found.bound] = found
            if any(part.startswith("_") for part in (*parts[1:], found.name)):
                broken.append(f"{place(module, found.line)} takes {found.name or parts[-1]} from jaxgel.{found.module}")
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in bound:
                private = node.attr.startswith("_") and not node.attr.startswith("__") and node.attr not in PUBLIC_UNDERSCORES
                if private and not (node.value.id == "jaxgel" and node.attr in modules):
                    broken.append(f"{place(module, node.lineno)} takes {dotted(node)} from jaxgel.{bound[node.value.id].module}")
    return broken


def listed(module: Module) -> list[str]:
    """The names in ``__all__``."""
    for node in module.tree.body:
        if isinstance(node, ast.Assign) and any(isinstance(target, ast.Name) and target.id == "__all__" for target in node.targets):
            return list(ast.literal_eval(node.value))
    return []


def past_the_face(modules: dict[str, Module]) -> list[str]:
    """Imports from another package that its ``__init__`` does not list."""
    broken = []
    for module in modules.values():
        for found in imports(module, modules):
            head = found.module.split(".")[0]
            if head not in PACKAGES or head == module.package:
                continue
            if found.module != head:
                broken.append(f"{place(module, found.line)} imports from jaxgel.{found.module}, not from jaxgel.{head}")
            elif found.name and found.name not in listed(modules[head]):
                broken.append(f"{place(module, found.line)} imports {found.name}, which jaxgel.{head} does not list")
    return broken


def by_kind(name: str) -> tuple[int, str]:
    """Order of names in ``__all__``: constants, classes, functions."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2), name


def faces(modules: dict[str, Module]) -> list[str]:
    """``__init__`` of a package holds a sentence, the imports of its names and their sorted list; no module is named like one of them."""
    broken = []
    for module in modules.values():
        if not (module.is_package and module.name):  # names of jaxgel itself are imported when they are used, from __init__.pyi
            continue
        where, names = place(module, 1), listed(module)
        if not ast.get_docstring(module.tree):
            broken.append(f"{where} has no docstring")
        bound = [alias.asname or alias.name for node in module.tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
        if names != sorted(set(names), key=by_kind) or set(names) - set(bound) or set(bound) - set(names):
            broken.append(f"{where}: __all__ is not the sorted list of what is imported")
        rest = [node for node in module.tree.body[1:] if not isinstance(node, (ast.ImportFrom, ast.Assign))]
        if module.name and rest:
            broken.append(f"{place(module, rest[0].lineno)} is more than names")
        broken += [f"jaxgel.{module.name}.{name} is a module and a name" for name in names if f"{module.name}.{name}" in modules]
    return broken


def environment_changes(modules: dict[str, Module]) -> list[str]:
    """Environment variables that are set or deleted outside the command line."""
    broken = []
    for module in modules.values():
        for node in ast.walk(module.tree):
            changed = isinstance(node, ast.Subscript) and not isinstance(node.ctx, ast.Load) and dotted(node.value).endswith("environ")
            changed |= isinstance(node, ast.AugAssign) and dotted(node.target).endswith("environ")
            if isinstance(node, ast.Call):
                owner, _, method = dotted(node.func).rpartition(".")
                changed |= (owner.endswith("environ") and method in CHANGES) or method in ("putenv", "unsetenv")
            if changed and module.package != "cli":
                broken.append(f"{place(module, node.lineno)} changes the environment")
    return broken


def cleared_caches(modules: dict[str, Module]) -> list[str]:
    """``jax.clear_caches`` in library code, which throws away what the user has compiled; a command's process is its own."""
    broken = []
    for module in modules.values():
        if module.name.split(".")[0] == "cli":
            continue
        for node in ast.walk(module.tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.ImportFrom) else [getattr(node, "attr", "")]
            if "clear_caches" in names:
                broken.append(f"{place(module, node.lineno)} clears JAX's caches")
    return broken


def containers(module: Module) -> set[str]:
    """Names that a module binds to a list, dict, set or the like."""
    names = set()
    for node in module.tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        value = getattr(node, "value", None)
        literal = isinstance(value, (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp))
        call = isinstance(value, ast.Call) and dotted(value.func).split(".")[-1] in CONTAINERS
        if literal or call:
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


def local_names(function: ast.AST) -> set[str]:
    """Arguments and names that a function binds itself."""
    if not isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
        return set()
    shared = {name for node in ast.walk(function) if isinstance(node, ast.Global) for name in node.names}
    bound = {node.arg for node in ast.walk(function.args) if isinstance(node, ast.arg)}
    bound |= {node.id for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return bound - shared


def changes(node: ast.AST, names: set[str]) -> Iterator[tuple[str, int]]:
    """Which of the names are changed in a piece of code, and where."""
    names = names - local_names(node)
    owner = None
    if isinstance(node, ast.Subscript) and not isinstance(node.ctx, ast.Load):
        owner = node.value
    elif isinstance(node, ast.AugAssign):
        owner = node.target
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CHANGES:
        owner = node.func.value
    if isinstance(node, ast.Global):
        yield from ((name, node.lineno) for name in node.names if name in names)
    if owner is not None and dotted(owner).split(".")[-1] in names:
        yield dotted(owner), node.lineno
    for child in ast.iter_child_nodes(node):
        yield from changes(child, names)


def changed_containers(modules: dict[str, Module]) -> list[str]:
    """Containers at the top of a module that the package changes: state that no caller sees."""
    of = {module.name: containers(module) for module in modules.values()}
    broken = []
    for module in modules.values():
        names = of[module.name] - {"__all__"}
        names |= {found.bound for found in imports(module, modules) if found.name in of.get(found.module, ())}
        rest = [node for node in module.tree.body if not isinstance(node, ast.AugAssign)]  # a long list may be bound by two statements
        found = [change for node in rest for change in changes(node, names)]
        broken += [f"{place(module, line)} changes {name}" for name, line in found]
    return broken


def caches_of_large_objects(modules: dict[str, Module]) -> list[str]:
    """``functools.cache`` and ``lru_cache`` of functions of a topology, a model or the like, which live as long as the cache then."""
    broken = []
    for module in modules.values():
        for node in ast.walk(module.tree):
            if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                continue
            arguments = [part for part in ast.walk(node.args) if isinstance(part, ast.arg)]
            words = {word.lower() for part in arguments for word in (part.arg, dotted(part.annotation or part).split(".")[-1])}
            decorators = {dotted(getattr(part, "func", part)).split(".")[-1] for part in node.decorator_list}
            if words & LARGE and decorators & {"cache", "lru_cache"}:
                broken.append(f"{place(module, node.lineno)} {node.name} keeps {', '.join(sorted(words & LARGE))}")
    return broken


def jax_internals(modules: dict[str, Module]) -> list[str]:
    """``jax.interpreters``, ``jax.extend`` and ``jax._src``, which change between releases, in more than one module."""
    inner = ("jax.interpreters", "jax.extend", "jax._src")
    users = set()
    for module in modules.values():
        named = [name for name, _ in libraries(module)]
        named += [dotted(node) for node in ast.walk(module.tree) if isinstance(node, ast.Attribute)]
        if any(f"{name}.".startswith(f"{part}.") for name in named for part in inner):
            users.add(f"jaxgel.{module.name}")
    return [f"{name} uses JAX's internals" for name in sorted(users)] if len(users) > 1 else []


def misplaced_libraries(modules: dict[str, Module]) -> list[str]:
    """Libraries outside the packages that may use them; the command line only chooses Matplotlib's backend."""
    broken = []
    for module in modules.values():
        for name, line in libraries(module):
            allowed = WHERE.get(name.split(".")[0])
            if allowed is not None and not {module.package, module.name} & allowed:
                broken.append(f"{place(module, line)} imports {name}")
            if module.package == "cli" and name.startswith("matplotlib."):
                broken.append(f"{place(module, line)} imports {name}")
        if module.package == "cli":
            used = [node for node in ast.walk(module.tree) if isinstance(node, ast.Attribute) and dotted(node).startswith("matplotlib.")]
            broken += [f"{place(module, node.lineno)} uses {dotted(node)}" for node in used if dotted(node) != "matplotlib.use"]
    return broken


def functions(module: Module) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Public functions of a module, and public methods and constructors of its public classes."""
    for node in module.tree.body:
        inside = node.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_") else []
        for function in (node, *inside):
            if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)) and (
                not function.name.startswith("_") or function.name in ("__init__", "__call__")
            ):
                yield (function.name if function is node else f"{node.name}.{function.name}"), function


def unannotated_arguments(modules: dict[str, Module]) -> list[str]:
    """Arguments of public functions without a type."""
    broken = []
    for module in modules.values():
        for name, function in functions(module):
            own = function.args
            every = [*own.posonlyargs, *own.args, *own.kwonlyargs, *filter(None, (own.vararg, own.kwarg))]
            bare = [part.arg for part in every if part.annotation is None and part.arg not in ("self", "cls")]
            if bare:
                broken.append(f"{place(module, function.lineno)} {name}({', '.join(bare)})")
    return broken


def long_modules(modules: dict[str, Module]) -> list[str]:
    """Modules that do not fit one subject."""
    return [
        f"jaxgel.{module.name} has {lines} lines" for module in modules.values() if (lines := len(module.text.splitlines())) > MODULE_LINES
    ]


def crowded_packages(modules: dict[str, Module]) -> list[str]:
    """Packages with too few modules to be one, or too many to be taken in at a glance."""
    broken = []
    for package in (module.name for module in modules.values() if module.is_package and module.name):
        inside = [name for name in modules if name.startswith(f"{package}.")]
        if not FEWEST <= len(inside) <= MOST:
            broken.append(f"jaxgel.{package} has {len(inside)} modules, not {FEWEST} to {MOST}")
    return broken


def long_functions(modules: dict[str, Module]) -> list[str]:
    """Functions that do not fit a screen."""
    return [
        f"{place(module, node.lineno)} {node.name} has {lines} lines"
        for module in modules.values()
        for node in ast.walk(module.tree)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and (lines := node.end_lineno - node.lineno + 1) > FUNCTION_LINES
    ]


FACE = '"""Clouds."""\nfrom .cells import cut\n__all__ = ["cut"]'
BAD = [
    (unknown_packages, {"tools.py": ""}, "jaxgel.tools: not one"),
    (
        against_the_order,
        {"cloud/cells.py": "from ..design import optimise", "design/__init__.py": ""},
        "cloud.cells:1 imports jaxgel.design",
    ),
    (
        against_the_order,
        {"cloud/cells.py": "def f():\n    import jaxgel.design", "design/__init__.py": ""},
        "cloud.cells:2 imports jaxgel.design",
    ),
    (against_the_order, {"cloud/cells.py": "from jaxgel import sweep", "__init__.py": ""}, "cloud.cells:1 imports jaxgel."),
    (
        against_the_order,
        {"linalg/factors.py": "from ..geometry import Plate", "geometry/__init__.py": ""},
        "linalg.factors:1 imports jaxgel.geom",
    ),
    (against_the_order, {"_memo.py": "from .cloud import cut", "cloud/__init__.py": FACE}, "_memo:1 imports jaxgel.cloud"),
    (circles, {"cloud/a.py": "from .b import x", "cloud/b.py": "def f():\n    from jaxgel.cloud.a import y"}, "jaxgel.cloud.a"),
    (circles, {"cloud/__init__.py": "from .a import x", "cloud/a.py": "from . import x"}, "jaxgel.cloud.a"),
    (private_names, {"design/a.py": "from ..cloud import _cut", "cloud/__init__.py": ""}, "design.a:1 takes _cut"),
    (private_names, {"design/a.py": "from .. import cloud\ncloud._cut()", "cloud/__init__.py": ""}, "design.a:2 takes cloud._cut"),
    (private_names, {"design/a.py": "from .._memo import _kept", "_memo.py": ""}, "design.a:1 takes _kept"),
    (past_the_face, {"design/a.py": "from ..cloud.cells import cut", "cloud/cells.py": ""}, "design.a:1 imports from jaxgel.cloud.cells"),
    (past_the_face, {"design/a.py": "from ..cloud import other", "cloud/__init__.py": FACE}, "design.a:1 imports other, which"),
    (faces, {"cloud/__init__.py": FACE + "\nx = 1\nprint(x)"}, "cloud:5 is more than names"),
    (faces, {"cloud/__init__.py": FACE.replace("[", "['a', ")}, "cloud:1: __all__"),
    (faces, {"cloud/__init__.py": FACE, "cloud/cut.py": ""}, "jaxgel.cloud.cut is a module and a name"),
    (environment_changes, {"cloud/a.py": "import os\nos.environ['A'] = '1'"}, "cloud.a:2"),
    (environment_changes, {"cloud/a.py": "import os\ndel os.environ['A']"}, "cloud.a:2"),
    (environment_changes, {"cloud/a.py": "from os import environ\nenviron.setdefault('A', '1')"}, "cloud.a:2"),
    (cleared_caches, {"cloud/a.py": "import jax\njax.clear_caches()"}, "cloud.a:2"),
    (cleared_caches, {"cloud/a.py": "from jax import clear_caches"}, "cloud.a:1"),
    (changed_containers, {"cloud/a.py": "KEPT = {}\ndef f(x):\n    KEPT[x] = 1"}, "cloud.a:3 changes KEPT"),
    (changed_containers, {"cloud/a.py": "KEPT: list = []\ndef f(x):\n    KEPT.append(x)"}, "cloud.a:3 changes KEPT"),
    (
        changed_containers,
        {"cloud/a.py": "import collections\nKEPT = collections.deque()\ndef f(x):\n    KEPT.popleft()"},
        "cloud.a:4 changes KEPT",
    ),
    (changed_containers, {"cloud/a.py": "KEPT = []\ndef f(x):\n    global KEPT\n    KEPT = [x]"}, "cloud.a:3 changes KEPT"),
    (changed_containers, {"cloud/a.py": "KEPT = {}", "cloud/b.py": "from .a import KEPT\nKEPT.clear()"}, "cloud.b:2 changes KEPT"),
    (caches_of_large_objects, {"cloud/a.py": "import functools\n@functools.cache\ndef f(topology): ..."}, "cloud.a:3 f keeps"),
    (
        caches_of_large_objects,
        {"cloud/a.py": "import functools\n@functools.lru_cache(maxsize=8)\ndef f(x: Model): ..."},
        "cloud.a:3 f keeps",
    ),
    (jax_internals, {"cloud/a.py": "from jax.interpreters import ad", "cloud/b.py": "import jax\njax.extend.core"}, "jaxgel.cloud.a uses"),
    (misplaced_libraries, {"cloud/a.py": "def f():\n    import matplotlib.pyplot as plt"}, "cloud.a:2 imports matplotlib.pyplot"),
    (misplaced_libraries, {"cli/a.py": "from matplotlib import pyplot"}, "cli.a:1 imports matplotlib.pyplot"),
    (misplaced_libraries, {"io/run.py": "import argparse"}, "io.run:1 imports argparse"),
    (unannotated_arguments, {"cloud/a.py": "def f(x: int, y, *, z=1): ..."}, "cloud.a:1 f(y, z)"),
    (unannotated_arguments, {"cloud/a.py": "class A:\n    def f(self, *y): ..."}, "cloud.a:2 A.f(y)"),
    (long_modules, {"cloud/a.py": "x = 1\n" * 301}, "jaxgel.cloud.a has 301 lines"),
    (crowded_packages, {"cloud/__init__.py": FACE, "cloud/a.py": "", "cloud/cells.py": ""}, "jaxgel.cloud has 2 modules"),
    (crowded_packages, {"cloud/__init__.py": FACE} | {f"cloud/m{k}.py": "" for k in range(19)}, "jaxgel.cloud has 19 modules"),
    (long_functions, {"cloud/a.py": "def f():\n" + "    x = 1\n" * 70}, "cloud.a:1 f has 71 lines"),
]
RULES = list(dict.fromkeys(rule for rule, _, _ in BAD))
GOOD = {
    "__init__.py": '"""The package."""\nfrom .cloud import cut\n__all__ = ["cut"]',
    "_memo.py": "import functools\n@functools.cache\ndef once(): ...",
    "cloud/__init__.py": FACE,
    "cloud/cloud.py": "from .cells import cut",
    "cloud/quadtree.py": "",
    "cloud/cells.py": "from ..geometry import Plate\nNAMES = ['a']\ndef cut(p: Plate):\n    NAMES = []\n    NAMES.append(p)",
    "design/search.py": "import os\nfrom .. import _memo\nfrom ..cloud import cut\nsize = os.environ.get('SIZE')",
    "geometry/__init__.py": '"""Plates."""\nfrom .plate import Plate\n__all__ = ["Plate"]',
    "geometry/holes.py": "",
    "geometry/outline.py": "",
    "geometry/plate.py": "class Plate:\n    def _pieces(self, k): ...\n",
    "plotting/patterns.py": "import matplotlib.pyplot as plt\nimport jax",
    "cli/main.py": "import matplotlib\nmatplotlib.use('Agg')\nfrom jax.extend import core\nimport os\nos.environ['A'] = 'b'",
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_package_keeps_the_rule(rule, modules):
    broken = rule(modules)
    assert not broken, "\n".join([f"{len(broken)} of {rule.__name__}: {rule.__doc__}", *broken])


@pytest.mark.parametrize(("rule", "sources", "line"), BAD, ids=[f"{rule.__name__}-{number}" for number, (rule, _, _) in enumerate(BAD)])
def test_a_broken_rule_is_found(rule, sources, line):
    assert any(line in found for found in rule(modules_of(sources)))


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_what_keeps_the_rules_is_not_reported(rule):
    assert rule(modules_of(GOOD)) == []


def test_every_package_of_the_order_exists(modules):
    assert {module.package for module in modules.values() if module.is_package and module.name} == set(PACKAGES)
