"""Many sheets at once: one compiled program sweeps them in batches on the devices of JAX.

It serves sheets on one cloud, with the states that `sweep` finds inside ``jax.jit`` (see
docs/howto/many.md): all others are left to the host's sweep. Sheets that have symmetries in common
are swept on a region of the plate.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from .._sizes import padded
from .._threads import few_threads
from ..mechanics import Problem
from ..symmetry import NAMES
from .options import SweepOptions
from .path import SCALARS, Path

DEVICES = ("cpu", "gpu", "auto")
ON_CPU, MOST = 16, 256  # sheets of a batch on each device: of a CPU, and of others at most
SHARE, COPIES = 0.8, 6  # of a device's memory that is used; arrays like those of a problem
COLUMNS = ("x", "pressure", *SCALARS)
GROUPS = tuple(NAMES.values())  # a program gives the number of a state's symmetry group
Device = Any  # of JAX, whose own type is no class for type checkers


def devices_of(name: str | None) -> list[Device]:
    """The devices on which ``name`` sweeps sheets in batches; none for the host's sweep.

    ``name`` is one of ``DEVICES``; "auto" takes the accelerators that JAX sees, if any. ValueError
    for another name, and for "gpu" if there is none.
    """
    if name is None:
        return []
    if name not in DEVICES:
        raise ValueError(f"device: {name!r} is not accepted; give one of {', '.join(DEVICES)}")
    if name == "cpu":
        return jax.local_devices(backend="cpu")
    found = [device for device in jax.local_devices() if device.platform != "cpu"]
    if name == "gpu" and not found:
        raise ValueError(
            "device: 'gpu' is not accepted, JAX sees the CPU only; give cpu or auto (for "
            "NVIDIA's: pip install 'jaxgel[cuda]')"
        )
    return found


def check_for_batches(sweep: SweepOptions) -> None:
    """Raise ValueError, one line, for a sweep that no compiled program follows."""
    for name, refused in (
        ("steps", sweep.steps == "auto" and not sweep.listed),
        ("branch", sweep.branch != "stable"),
        ("imperfection", sweep.imperfection != 0),
        ("contact", sweep.contact == "stop"),
        ("eigenvalues", sweep.eigenvalues),
    ):
        if refused:
            raise ValueError(
                f"device: sweep.{name} = {getattr(sweep, name)!r} is for the host's sweep alone; "
                "leave --device out"
            )


class Batched:
    """A function of a sheet, evaluated for many at once.

    One program for each group of symmetries. Sheets like a ``problem``, whose arrays say how many a
    device holds, are given by arguments of the function ``sheet(symmetry, *arguments)``.
    """

    def __init__(self, sheet: Callable, problem: Problem, devices: list[Device]) -> None:
        self.sheet, self.devices, self._unknowns = sheet, devices, 2 * problem.model.n_nodes
        self.size = _room(problem, devices[0]) * len(devices)
        self._programs: dict[tuple[str, ...], Callable] = {}

    def __call__(self, group: tuple[str, ...], *given: Any) -> Any:
        """Results of sheets that have a ``group`` of symmetries; arguments have axis b first.

        They are evaluated ``size`` at a time, a smaller number repeats the last sheet. Fewer are
        at a time from where memory is exhausted on.
        """
        count, size, program = len(jax.tree.leaves(given)[0]), self.size, self._program(group)

        def part(k):
            rows = jax.tree.map(lambda array: padded(np.asarray(array)[k : k + size], size), given)
            return jax.device_get(program(*rows))

        try:
            with few_threads(self._unknowns):
                parts = [part(k) for k in range(0, count, size)]
        except jax.errors.JaxRuntimeError as problem:
            if "RESOURCE_EXHAUSTED" not in str(problem) or size // 2 < len(self.devices):
                raise
            self.size = size // 2
            return self(group, *given)
        return jax.tree.map(lambda *arrays: np.concatenate(arrays)[:count], *parts)

    def _program(self, group):
        if group not in self._programs:
            sheet = functools.partial(self.sheet, NAMES[group] if group else "off")
            over = PartitionSpec("sheets")
            self._programs[group] = jax.jit(
                jax.shard_map(
                    jax.vmap(sheet),
                    mesh=Mesh(np.array(self.devices), ("sheets",)),
                    in_specs=over,
                    out_specs=over,
                    check_vma=False,
                )
            )
        return self._programs[group]


def columns_of(path: Path) -> dict[str, Any]:
    """What a program returns of a path: arrays, and the number of each state's symmetry group."""
    columns = {name: getattr(path, name) for name in COLUMNS}
    return columns | {"symmetry": jnp.array([GROUPS.index(name) for name in path.symmetry])}


def _room(problem, device):
    """Sheets of a batch on one device, a power of 2."""
    if device.platform == "cpu":
        return ON_CPU
    limit = (device.memory_stats() or {}).get("bytes_limit")
    if limit is None:
        return MOST
    each = COPIES * sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(problem.shared))
    return 2 ** int(np.log2(np.clip(SHARE * limit / each, 1, MOST)))
