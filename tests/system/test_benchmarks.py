"""Every script in benchmarks/ runs at a small setting.

Those that need an outside package where it is installed.
"""

import pathlib
import subprocess
import sys

import pytest

FOLDER = pathlib.Path(__file__).parents[2] / "benchmarks"
SMALL = {
    "accuracy": ["--rows", "core", "--nodes", "1000"],
    "contact": ["--spacing", "0.9"],
    "convergence": ["--quick"],
    "fields": ["--repeats", "1"],
    "error_bars": ["--quick"],
    "first": ["--quick"],
    "gpu": [
        "--spacing",
        "2.2",
        "--batch",
        "2",
        "--states",
        "3",
        "--repeats",
        "1",
        "--out",
        "gpu.json",
    ],
    "gradient": ["--spacing", "2.2", "--repeats", "1"],
    "howto": ["--quick"],
    "kernels": ["--cases", "sample-7", "--repeats", "1"],
    "kill": ["1", "given"],
    "lattice": ["--quick", "--out", "."],
    "map": ["--points", "2", "--workers", "1", "--spacing", "1.5", "--out", "map.json"],
    "programs": ["--quick"],
    "robust": ["--quick"],
    "scale": ["--nodes", "500", "--out", "scale.json"],
    "solvers": ["--nodes", "800"],
    "swelling": ["--quick"],
    "symmetry": ["--cases", "sample-1", "--spacing", "1.5", "--runs", "1"],
}
LONG = {"waves"}  # minutes at its only setting
ELEMENTS = {
    "barrier", "bloch_elements", "design_step", "finite_elements", "peers", "printed", "references",
    "seal_elements", "studies", "sweep", "switches",
}  # fmt: skip
MODULES = {"ngsolve_gel", "ngsolve_swelling", "ngsolve_sweep", "skfem_gel"}  # what others import
# of the extra "bench"
NEEDS = dict.fromkeys(ELEMENTS | {"waves"}, "ngsolve") | {"solvers": "pyamg"}


def test_every_script_is_listed():
    assert {script.stem for script in FOLDER.glob("*.py")} == set(SMALL) | LONG | ELEMENTS | MODULES


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_script_runs(name, tmp_path):
    pytest.importorskip(NEEDS.get(name, "jaxgel"))
    done = subprocess.run(
        [sys.executable, FOLDER / f"{name}.py", *SMALL[name]],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LONG | ELEMENTS))
def test_script_starts(name, tmp_path):
    """It imports all that it needs."""
    pytest.importorskip(NEEDS.get(name, "jaxgel"))
    loader = (
        f"import sys, importlib; sys.path.insert(0, {str(FOLDER)!r}); "
        f"importlib.import_module({name!r})"
    )
    done = subprocess.run(
        [sys.executable, "-c", loader], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_the_domain_for_mosaic_runs(tmp_path):
    """The onset, where mosaic-bench is installed."""
    pytest.importorskip("mosaic")
    command = [sys.executable, FOLDER / "mosaic" / "run.py", "--quick"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("onset") == 2
