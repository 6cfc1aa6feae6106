"""Texts, lists and refusals come without the packages; JAX's numbers have 64 bits in every order of imports; no variable is set."""

import json
import os
import subprocess
import sys

import pytest

import jaxgel
from jaxgel.cli import environment, generated

UNSET = ("JAX_COMPILATION_CACHE_DIR", "JAX_PLATFORMS", "NPROC", "XLA_FLAGS")


def python(code, *arguments, folder=None, **variables):
    """What a new process prints, of Python ``code``."""
    own = {name: value for name, value in os.environ.items() if name not in UNSET}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, env=own | variables, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


ALONE = """
import contextlib, io, sys
from jaxgel.cli import main
with contextlib.redirect_stdout(io.StringIO()):
    try:
        code = main(sys.argv[1:])
    except SystemExit as end:
        code = end.code
print(code, sorted({"jaxgel.cases", "jaxgel.cloud", "matplotlib", "shapely"} & sys.modules.keys()))
"""


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("--help", 0),
        ("run --help", 0),
        ("--version", 0),
        ("samples", 0),
        ("schema", 0),
        ("init case", 0),
        ("init --from lattice", 0),
        ("run smaple-1", 2),
        ("run sample-1 --spacing -1", 2),
        ("run sample-1 --mu-start -1 --mu-end -1", 2),
        ("run missing.toml", 2),
        ("design missing.toml", 2),
        ("plot nowhere", 2),
        ("resume nowhere", 2),
    ],
)
def test_the_command_line_answers_without_the_packages(line, code, tmp_path):
    found = python(ALONE, *line.split(), folder=tmp_path)
    assert found == f"{code} []"


def test_package_data_is_what_the_code_makes():
    """If not: python -c "from jaxgel.cli import generated; generated.write()"."""
    for name, text in generated.make().items():
        assert json.loads(generated.file(name).read_text(encoding="utf-8")) == json.loads(text), name


@pytest.mark.parametrize(
    "imports",
    [
        "import jaxgel, jax",
        *(pytest.param(line, marks=pytest.mark.slow) for line in ("import jax, jaxgel", "import jaxgel, jax.numpy")),
        "import jaxgel.linalg, jax",
    ],
)
def test_jax_has_64_bits_in_every_order_of_imports(imports):
    assert python(f"{imports}\nprint(jax.numpy.zeros(()).dtype)") == "float64"


def test_importing_the_package_sets_no_variable():
    code = "import os, jax; before = dict(os.environ); import jaxgel; jaxgel.sweep; print(before == dict(os.environ))"
    assert python(code) == "True"


def test_every_public_name_can_be_had():
    for name in jaxgel.__all__:
        assert getattr(jaxgel, name) is not None
    assert set(jaxgel.__all__) <= set(dir(jaxgel))


PREPARE = "import os; from jaxgel.cli.environment import prepare_environment as prepare; "
PREPARED = PREPARE + "prepare({}); print(os.environ.get('JAX_COMPILATION_CACHE_DIR'))"


def test_compiled_programs_lie_in_the_users_cache_folder_unless_told_otherwise(tmp_path):
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    assert python(PREPARED.format("None"), **home).startswith(str(tmp_path))
    assert python(PREPARED.format("None"), JAXGEL_CACHE=str(tmp_path / "own"), **home) == str(tmp_path / "own")
    assert python(PREPARED.format("'given'"), JAXGEL_CACHE="own", **home) == "given"
    assert python(PREPARED.format("None"), JAXGEL_CACHE="own", JAX_COMPILATION_CACHE_DIR="users", **home) == "users"
    assert python(PREPARED.format("'off'"), **home) == "None"
    assert python(PREPARED.format("None"), JAXGEL_CACHE="off", **home) == "None"


def test_the_users_flags_are_kept():
    code = PREPARE + "prepare('off'); print(os.environ['XLA_FLAGS'])"
    mine = "--xla_backend_optimization_level=1"
    assert python(code, XLA_FLAGS=mine).split() == [mine, *environment.quick_flags()[1:]]


def test_the_command_line_computes_on_the_cpu_unless_told_otherwise():
    code = PREPARE + "prepare('off'); print(os.environ['JAX_PLATFORMS'])"
    assert python(code) == "cpu" and python(code, JAX_PLATFORMS="cuda") == "cuda"


def test_the_process_is_prepared_and_one_that_calls_a_command_is_left_alone(tmp_path):
    told = "import jax; print(jax.config.jax_compilation_cache_dir, jax.config.jax_platforms, jax.devices()[0].platform)"
    assert python(PREPARE + "prepare('there'); " + told).split() == ["there", "cpu", "cpu"]
    code = "import os, jax; before = dict(os.environ); from jaxgel.cli import main; main(['samples']); print(before == dict(os.environ)); "
    assert python(code + told).split()[-4:] == ["True", "None", "None", "cpu"]
