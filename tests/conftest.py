"""Strict flags for every test, and one small run that several tests look at."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core already; has to stand before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["MPLBACKEND"] = "Agg"

import jax
import pytest

import jaxgel.cli
from jaxgel.results import load_path

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory):
    """Folder of ``jaxgel run sample-1`` on a coarse cloud at four given mu, with figures."""
    folder = tmp_path_factory.mktemp("run") / "sample-1"
    arguments = ["run", "sample-1", "--spacing", "1.1", "--steps", "4", "--out", str(folder), "--quiet"]
    assert jaxgel.cli.main(arguments) == 0
    return folder


@pytest.fixture(scope="session")
def path(run_folder):
    """The path of ``run_folder``."""
    return load_path(run_folder)
