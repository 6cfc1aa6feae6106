"""JAX's numbers have 64 bits in every order of imports; no variable is set."""

import json
import os
import subprocess
import sys

import pytest

import jaxgel
from jaxgel.cli import environment

UNSET = ("JAX_COMPILATION_CACHE_DIR", "JAX_PLATFORMS", "NPROC", "XLA_FLAGS")


def python(code, *arguments, folder=None, **variables):
    """What a new process prints, of Python ``code``."""
    own = {name: value for name, value in os.environ.items() if name not in UNSET}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(
        command, env=own | variables, cwd=folder, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.parametrize(
    "imports",
    [
        "import jaxgel, jax",
        *(
            pytest.param(line, marks=pytest.mark.slow)
            for line in (
                "import jax, jaxgel",
                "import jaxgel, jax.numpy",
                "import jaxgel.linalg, jax",
            )
        ),
    ],
)
def test_jax_has_64_bits_in_every_order_of_imports(imports):
    assert python(f"{imports}\nprint(jax.numpy.zeros(()).dtype)") == "float64"


def test_every_public_name_can_be_had():
    for name in jaxgel.__all__:
        assert getattr(jaxgel, name) is not None
    assert set(jaxgel.__all__) <= set(dir(jaxgel))


PREPARED = """
import json, os, sys
import jax
from jaxgel.cli.environment import prepare_environment
clean, told = dict(os.environ), []
for cache, variables in json.loads(sys.argv[1]):
    os.environ.clear()
    os.environ.update(clean | variables)
    prepare_environment(cache)
    names = "JAX_COMPILATION_CACHE_DIR", "JAX_PLATFORMS", "XLA_FLAGS"
    settings = jax.config.jax_compilation_cache_dir, jax.config.jax_platforms
    told.append([*(os.environ.get(name) for name in names), *settings])
print(json.dumps(told))
"""


@pytest.mark.thorough
def test_the_process_is_prepared_and_variables_of_the_user_are_kept(tmp_path):
    """Defaults: programs in the user's cache folder, CPU, XLA's flags, unless told otherwise."""
    home, flag = (
        {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")},
        "--xla_backend_optimization_level=1",
    )
    given = [
        (None, home),
        (None, home | {"JAXGEL_CACHE": str(tmp_path / "own")}),
        ("given", home | {"JAXGEL_CACHE": "own"}),
        (None, home | {"JAXGEL_CACHE": "own", "JAX_COMPILATION_CACHE_DIR": "users"}),
        ("off", home),
        (None, home | {"JAXGEL_CACHE": "off"}),
        ("off", {"XLA_FLAGS": flag, "JAX_PLATFORMS": "cuda"}),
    ]
    folders, platforms, flags, *settings = zip(
        *json.loads(python(PREPARED, json.dumps(given))), strict=True
    )
    assert folders[0].startswith(str(tmp_path))
    assert folders[1:] == (str(tmp_path / "own"), "given", "users", None, None, None)
    assert platforms == ("cpu",) * 6 + ("cuda",)
    assert flags[0].split() == environment.quick_flags() and flags[-1].split() == [
        flag,
        *environment.quick_flags()[1:],
    ]
    assert settings == [folders, platforms]


def test_importing_the_package_and_calling_a_command_leave_the_process_alone():
    code = (
        "import os, jax; before = dict(os.environ); import jaxgel; jaxgel.sweep; from jaxgel.cli "
        "import main; main(['samples']); "
    )
    told = (
        "jax.config.jax_compilation_cache_dir, jax.config.jax_platforms, jax.devices()[0].platform"
    )
    assert python(code + f"print(before == dict(os.environ), {told})").split()[-4:] == [
        "True",
        "None",
        "None",
        "cpu",
    ]
