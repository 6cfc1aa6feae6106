"""``jaxgel doctor``: versions, float64, devices, threads, kept programs, two known results.

A released jaxlib sums float64 numbers wrongly beyond 16,384 rows, without an error; so both are
computed at more points than that, on every device. The command line itself runs on the CPU; a
process of its own looks at the other devices.
"""

import os
import platform
import subprocess
import sys
from argparse import Namespace
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_info

from .._kept import KEPT, PROGRAM, WAITING, start_trial
from .._threads import usable_cores
from ..cases import sample, sample_names
from ..cloud import make_cloud
from ..continuation import sweep
from ..discretisation import discretise
from ..materials import Gel, free_swelling
from ..mechanics import Problem
from ..observables import history, rotation_angle
from .environment import DONE, STOPPED

POINTS = 16_385
FIRST_MU = -4.0  # kT: of the state for whose sake programs are compiled
# relative: round-off stays below 1e-11, a wrong program is wrong in the first digits
AGREEMENT = 1e-9
ON_ACCELERATORS = (
    "from jaxgel.cli.doctor import check_accelerators; raise SystemExit(check_accelerators())"
)
SWOLLEN = 1.073959312922861  # free-swelling stretch of Gel(Nv=1e-3, chi=0.2) at mu = -1


def doctor(args: Namespace) -> int:
    """``jaxgel doctor``: what is installed, and errors of known results; the exit code.

    With ``--warm`` the programs of the built-in cases are compiled and kept.
    """
    packages = ("jaxgel", "jax", "jaxlib", "numpy", "scipy", "shapely", "matplotlib", "optax")
    pools = {
        f"{pool.get('internal_api', pool['user_api'])} {pool['num_threads']}"
        for pool in threadpool_info()
    }
    print(f"Python {platform.python_version()} on {platform.platform()}")
    print(", ".join(f"{name} {version(name)}" for name in packages))
    x64 = jnp.zeros(()).dtype == jnp.float64
    print(f"float64: {'on' if x64 else 'OFF: something switched jax_enable_x64 off'}")
    print(
        f"commands and sweeps run on the CPU: {usable_cores()} cores; threads: "
        f"{', '.join(sorted(pools))}"
    )
    if args.warm:
        compile_samples()
        start_trial(wait=True)
    print(f"kept programs: {kept_programs()}")
    wrong = check("CPU")
    environment = os.environ | {"JAX_PLATFORMS": ""}
    command = [sys.executable, "-c", ON_ACCELERATORS]
    accelerators = subprocess.run(  # noqa: S603
        command, env=environment, stdout=subprocess.PIPE, text=True, check=False
    )
    print(accelerators.stdout, end="")
    if wrong:
        print(
            (
                f"jaxgel: this installation computes wrongly: {', '.join(wrong)}; install another "
                "jaxlib"
            ),
            file=sys.stderr,
        )
    return STOPPED if wrong or accelerators.returncode else DONE


def check(device: str) -> list[str]:
    """Print the `differences` on the default device, which is called ``device``.

    The names of those that are wrong.
    """
    found = differences()
    print(
        *(
            f"{device}, {name}: relative difference {difference:.1e}"
            for name, difference in found.items()
        ),
        sep="\n",
        flush=True,
    )
    # nan is wrong
    return [name for name, difference in found.items() if not difference < AGREEMENT]


def check_accelerators() -> int:
    """Print the accelerators of JAX, each with its `check`; the exit code.

    The user's own programs (``jax.jit``, ``jax.vmap``) run on these.
    """
    devices, wrong = [device for device in jax.devices() if device.platform != "cpu"], []
    for device in devices:
        with jax.default_device(device):
            found = check(f"{device.platform} {device.id} ({device.device_kind})")
            print(
                f"programs of jax.jit and jax.vmap run on {device.platform} {device.id}; float64: "
                f"{'on' if not found else 'WRONG'}"
            )
            wrong += found
    if not devices:
        print(
            "programs of jax.jit and jax.vmap run on the CPU, too: JAX sees no accelerator (for "
            "NVIDIA's: pip install 'jaxgel[cuda]')"
        )
    return STOPPED if wrong else DONE


def kept_programs() -> str:
    """Number, size and folder of the programs that are kept for processes like this one."""
    if KEPT.root is None or KEPT.folder is None:
        return "none"
    sizes = [
        file.stat().st_size for file in KEPT.folder.iterdir() if file.suffix in (PROGRAM, WAITING)
    ]
    return f"{len(sizes)}, {sum(sizes) / 1e6:.1f} MB, in {KEPT.folder}"


def compile_samples() -> None:
    """Sweep each built-in plate to one state and differentiate its rotation, for the programs."""
    for name in sample_names():
        plate = sample(name)
        cloud = make_cloud(plate)

        def rotation(plate, cloud=cloud):
            return rotation_angle(
                sweep(Problem(discretise(cloud.at(plate)), plate.gel), [FIRST_MU])
            )[-1]

        print(f"compiling {name}", flush=True)
        history(sweep(Problem(discretise(cloud), plate.gel), [FIRST_MU]))
        jax.grad(rotation, allow_int=True)(plate)


def differences() -> dict[str, float]:
    """Name -> largest relative error of a known result at ``POINTS`` points; nan if not finite."""
    rng = np.random.default_rng(5)
    rows, matrix = rng.normal(size=(POINTS, 3)), rng.normal(size=(3, 3))
    sums = jax.jit(jax.vmap(lambda row: jnp.sum((matrix @ row) ** 2)))(rows)
    stretches = jax.jit(jax.vmap(lambda mu: free_swelling(mu, Gel(Nv=1e-3, chi=0.2))))(
        np.full(POINTS, -1.0)
    )
    known = {
        "sums of three squares": (sums, np.sum((rows @ matrix.T) ** 2, axis=1)),
        "free swelling": (stretches, SWOLLEN),
    }
    return {
        name: float(np.max(np.abs(found / expected - 1)))
        for name, (found, expected) in known.items()
    }
