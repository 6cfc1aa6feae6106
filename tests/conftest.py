"""Strict flags for every test, and one small run that several tests look at."""

import contextlib
import ctypes
import functools
import gc
import os
import re
import sys
import time
from importlib.metadata import version
from pathlib import Path

# before anything imports NumPy or JAX: the test processes share the cores, and what one of them has
# compiled
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".cache" / "jax")
)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# XLA mistakes its own tuning flags for missing processor features in that cache
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
os.environ["MPLBACKEND"] = "Agg"

if os.environ.get("JAXGEL_CHECK_SHAPES", "0") != "0":  # before jaxgel is imported
    sys.path.insert(0, str(Path(__file__).parent))
    import shape_checks

    shape_checks.install()

from jaxgel.cli.environment import quick_flags

# read when the first program is compiled: most tests compile more than they compute, and a program
# in parts is more work
os.environ.setdefault(
    "XLA_FLAGS",
    " ".join(
        [flag.replace("level=2", "level=0") for flag in quick_flags()]
        + ["--xla_cpu_parallel_codegen_split_count=1"] * version("jaxlib").startswith("0.10.")
    ),
)

import jax
import numpy as np
import pytest

import jaxgel
import jaxgel.cli.command_line
from jaxgel.cases import load_path
from jaxgel.io import write_atomically

ROOM = 1.5  # GiB that a test process may fill from one module to the next


def pytest_xdist_auto_num_workers(config):
    """Workers of ``-n auto``: one per core, each with 3 GiB, of which it fills 2."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return max(1, min(os.cpu_count() or 1, memory // (3 * 2**30)))


LONG = (
    "bifurcation/branches.py",
    "bifurcation/deflation.py",
    "bifurcation/search.py",
    "design/criteria.py",
    "materials/phases.py",
    "observables/wrinkling.py",
)
IN_TIME = ("observables/solvent.py", "observables/times.py", "transient/swelling.py")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """How-to and extension pages run with the slow tests; smaller plates test them, too.

    So do docstring examples of the modules ``IN_TIME``; those of ``LONG`` are thorough.
    """
    for item in items:
        module = "/".join(item.path.parts[-2:])
        if item.path.parent.name in ("howto", "extend") or module in IN_TIME:
            item.add_marker("slow")
        elif module in LONG:
            item.add_marker("thorough")


def pytest_collection_finish():
    """Python's collector skips imported objects and comes less often: tracing makes many."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture(scope="session")
def refused():
    """Function that asserts of rows (*input, message) a ValueError of one line.

    Raised by ``attempt(*input)``, with the message. Rows that fail are printed together. A message
    is a regular expression, or the text itself if it is ``literal``; with ``start`` the line begins
    with it, with ``whole`` it is the line.
    """

    def check(attempt, rows, *, literal=False, start=False, whole=False):
        faults = []
        for *given, message in rows:
            text = re.escape(message) if literal else message
            pattern = f"{'^' * (start or whole)}(?:{text}){'$' * whole}"
            try:
                made = attempt(*given)
            except ValueError as problem:
                if not re.search(pattern, str(problem)) or "\n" in str(problem):
                    faults.append(f"{given!r} is refused by {str(problem)!r}, not {message!r}")
            else:
                faults.append(f"{given!r} gives {made!r}, not {message!r}")
        assert rows and not faults, "\n".join(faults)

    return check


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory):
    """Folder of ``jaxgel run sample-1`` on a coarse cloud at four given mu, with figures.

    One run serves all test processes.
    """
    shared = tmp_path_factory.getbasetemp()
    shared = shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared
    folder, done = shared / "small-run" / "sample-1", shared / "small-run" / "exit-code"
    try:
        folder.parent.mkdir()
    except FileExistsError:  # another process is at it
        deadline = time.monotonic() + 300
        while not done.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
    else:
        arguments = [
            "run",
            "sample-1",
            "--spacing",
            "1.1",
            "--steps",
            "4",
            "--out",
            str(folder),
            "--quiet",
        ]
        code = "an exception"
        try:
            code = jaxgel.cli.main(arguments)
        finally:  # or the other processes would wait
            write_atomically(done, lambda stream: stream.write(str(code).encode()))
    assert done.read_text() == "0"
    return folder


@pytest.fixture(scope="session")
def path(run_folder):
    """The path of ``run_folder``."""
    return load_path(run_folder)


@pytest.fixture(scope="session")
def in_time():
    """Path of a quarter of the tiny plate, 39 nodes, in two baths: a jump and a ramp to 0.1."""
    plate = jaxgel.Plate(1.0, 1.0, [jaxgel.Circle((0.025, -0.05), 0.275)], edges={"top": "free"})
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.2, nodes_per_hole=8))
    baths = {0: -1.5, "top": jaxgel.Bath([-2.5, -1.5], times=[0.0, 0.1])}
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1), contact=False)
    return jaxgel.swell(
        problem, baths, jaxgel.TimeSteps(10.0, first=1e-3, per_decade=3), start=-3.0
    )


@pytest.fixture(scope="session")
def cloud_of():
    """Function: name of a sample -> its cloud at twice the paper's spacing; made once.

    The lattice's and the square's are at their own spacing.
    """

    @functools.cache
    def make(name):
        plate = jaxgel.sample(name)
        return jaxgel.make_cloud(
            plate, spacing=plate.spacing * (1 if name in ("lattice", "square") else 2)
        )

    return make


@pytest.fixture(scope="session")
def coarse_model(cloud_of):
    """Sample 1 with 321 nodes and the default options."""
    return jaxgel.discretise(cloud_of("sample-1"))


@pytest.fixture(scope="session")
def coarse_path(coarse_model):
    """Sample 1 with 321 nodes from the dry nodes to mu = -0.9178."""
    return jaxgel.sweep(
        jaxgel.Problem(coarse_model, coarse_model.cloud.plate.gel),
        np.linspace(-4.9678, -0.9178, 10),
    )


@pytest.fixture(scope="session")
def tiny_plate():
    """A plate of 4 x 4 mm with one round hole, free at the top; its gel is that of the samples."""
    hole = jaxgel.Circle(centre=(0.1, -0.2), radius=1.1)
    return jaxgel.Plate(
        4,
        4,
        [hole],
        edges={"top": "free"},
        spacing=0.5,
        nodes_per_hole=12,
        gel=jaxgel.Gel(Nv=1e-3, chi=1e-4),
    )


@pytest.fixture(scope="session")
def tiny_model(tiny_plate):
    """The tiny plate with 79 nodes, small enough for dense Hessians."""
    return jaxgel.discretise(jaxgel.make_cloud(tiny_plate))


@pytest.fixture(scope="session")
def tilted_plate():
    """A plate of 8 x 8 mm with one tilted ellipse: its core turns without a bifurcation.

    Half as large it is the plate of the examples in docs/, which takes the same programs.
    """
    hole = jaxgel.Ellipse((0.3, -0.2), (2.4, 1.6), 0.4)
    return jaxgel.Plate(
        8,
        8,
        [hole],
        spacing=1.2,
        nodes_per_hole=8,
        core=(3.2, 3.0),
        gel=jaxgel.Gel(Nv=1e-3, chi=1e-4),
    )


@pytest.fixture(scope="session")
def tilted_cloud(tilted_plate):
    """The tilted plate with 63 nodes."""
    return jaxgel.make_cloud(tilted_plate)


@pytest.fixture(scope="session")
def square_model(cloud_of):
    """The paper's unit square with 7 x 7 nodes and the default options."""
    return jaxgel.discretise(cloud_of("square"))


@pytest.fixture(scope="session")
def buckling_model(cloud_of):
    """Sample 4 on a coarse cloud: its symmetric state buckles."""
    return jaxgel.discretise(cloud_of("sample-4"))


@pytest.fixture(scope="session")
def buckling_point(buckling_model):
    """The bifurcation of ``buckling_model``."""
    return jaxgel.critical_points(
        jaxgel.Problem(buckling_model, buckling_model.cloud.plate.gel), (-1.8, -1.5)
    )[0]


@pytest.fixture(scope="session")
def pillars_model():
    """Sample 4 with 101 nodes: it buckles at mu = -1.07; 64 constant pressure patches."""
    return jaxgel.discretise(jaxgel.make_cloud(jaxgel.sample("sample-4"), spacing=2.2))


@pytest.fixture(scope="session")
def pillars_point(pillars_model):
    """The bifurcation of ``pillars_model``."""
    return jaxgel.critical_points(
        jaxgel.Problem(pillars_model, pillars_model.cloud.plate.gel), (-1.2, -1.0)
    )[0]


@pytest.fixture(scope="module", autouse=True)
def _forget_compiled_programs():
    """Programs that JAX keeps fill gigabytes over a whole run.

    The cache on disk has them for the next module. The C library keeps most of what is freed;
    unless it is told to give that back, every module from here on would begin without programs.
    Kept to the end (``ROOM = math.inf``) they filled 4.3 GiB, and the tests took as long.
    """
    yield
    if _resident() > ROOM:
        jax.clear_caches()
        gc.collect()
        if sys.platform == "linux":
            with contextlib.suppress(AttributeError):  # another C library
                ctypes.CDLL(None).malloc_trim(0)


def _resident():
    """GiB that this process fills; without bound where the system does not tell."""
    file = Path("/proc/self/statm")
    return (
        int(file.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**30
        if file.exists()
        else float("inf")
    )
