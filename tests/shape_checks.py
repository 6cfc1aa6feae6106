"""Run-time checks of jaxgel's annotations, shapes of arrays included, while its tests run.

``install()`` before jaxgel is imported: from then on every function at the top of a module or class
that has an annotation is checked by jaxtyping and beartype at each call, and a dataclass where it
is made. A dataclass that JAX fills is left alone, since JAX puts placeholders and stacked arrays in
its fields. Functions inside functions are left alone too: they are made anew at every call, which
is why this is not jaxtyping's own import hook.
"""

import ast
import dataclasses
import functools
import importlib.abc
import importlib.machinery
import sys
import typing

import jaxtyping
from beartype import BeartypeConf, beartype

CONFIGURATION = BeartypeConf(is_pep484_tower=True)  # an int is a float


def install():
    """Check the annotations of every module of jaxgel that is imported from here on."""
    sys.meta_path.insert(0, _Finder())


def checked(function):
    """The function with its annotations checked at every call.

    What the function itself refuses is left to it.
    """
    strict = jaxtyping.jaxtyped(function, typechecker=beartype(conf=CONFIGURATION))

    @functools.wraps(function)
    def call(*args, **kwargs):
        try:
            return strict(*args, **kwargs)
        except jaxtyping.TypeCheckError:
            function(*args, **kwargs)
            raise

    return call


def checked_class(made):
    """The class; fields of a dataclass are checked wherever jaxgel or a test makes one."""
    if getattr(made, "_is_protocol", False):
        return typing.runtime_checkable(made)
    if not dataclasses.is_dataclass(made) or "__init__" not in made.__dict__:
        return made
    plain, strict = made.__init__, checked(made.__init__)

    @functools.wraps(plain)
    def __init__(self, *args, **kwargs):  # noqa: N807
        of_jax = sys._getframe(1).f_globals.get("__name__", "").startswith(("jax.", "jaxlib"))
        (plain if of_jax else strict)(self, *args, **kwargs)

    made.__init__ = __init__
    return made


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the modules of jaxgel."""

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] != "jaxgel":
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    """Compiles a module with the checks; nothing of that is kept on disk."""

    def get_code(self, fullname):
        return self.source_to_code(self.get_data(self.path), self.path)

    def source_to_code(self, data, path, *, _optimize=-1):
        tree = ast.parse(data, path)
        _decorate(tree.body)
        after = 1 + max(
            [-1, *(place for place, node in enumerate(tree.body[:2]) if _comes_first(node))]
        )
        tree.body.insert(after, ast.parse("import shape_checks as _shape_checks").body[0])
        return compile(
            ast.fix_missing_locations(tree), path, "exec", dont_inherit=True, optimize=_optimize
        )


def _comes_first(node):
    """Whether it is the docstring or an import from the future."""
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return docstring or (isinstance(node, ast.ImportFrom) and node.module == "__future__")


def _decorate(body):
    """Put the check next to functions, below JAX's wrappers, and above class decorators."""
    for node in body:
        if isinstance(node, ast.ClassDef):
            _decorate(node.body)
            node.decorator_list.insert(0, _name("checked_class", node))
        elif isinstance(node, ast.FunctionDef) and _annotated(node):
            node.decorator_list.append(_name("checked", node))


def _annotated(function):
    arguments = [part for part in ast.walk(function.args) if isinstance(part, ast.arg)]
    return function.returns is not None or any(part.annotation is not None for part in arguments)


def _name(name, node):
    return ast.copy_location(
        ast.Attribute(ast.Name("_shape_checks", ast.Load()), name, ast.Load()), node
    )
