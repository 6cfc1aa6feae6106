"""Several searches at once, whose designs one compiled program evaluates in batches.

Every search is that of `optimise`, whatever its method: it runs until it asks for the values of a
design, and when all of them wait, one program makes plates, sweeps and all gradients of their
designs on the devices of JAX, see `continuation.Batched`. It serves designs on a cloud that all
searches begin with. What it does not, a design that this cloud cannot carry, and whose state is
lost, unstable or touches itself, is left to the search, as if it were alone.
"""

import dataclasses
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from ..bifurcation import problem_by_options
from ..cloud import Cloud
from ..continuation import Batched, Device, check_for_batches, group_of_sweep
from ..equilibrium import Status
from ..geometry import Plate
from .problem import DesignProblem


class Member:
    """One of the searches of a `Together`, a thread of its own: only one of all runs at a time."""

    def __init__(self, together: "Together", search: Callable[["Member"], Any]) -> None:
        self.together, self.vector, self.ended = together, None, False
        self._search, self._found, self._fault = search, None, None
        self._answer: Any = None
        self._turn, self._rest = threading.Semaphore(0), threading.Semaphore(0)
        threading.Thread(target=self._run, daemon=True).start()

    def cloud_for(self, plate: Plate) -> Cloud | None:
        """The cloud that the searches share, None if it cannot carry the ``plate``."""
        shared = self.together.cloud
        return shared if self.together.problem.options.carries(shared, plate) else None

    def values(self, vector: Float[Array, " d"]) -> tuple[np.ndarray, np.ndarray] | None:
        """Objective and path constraints (1 + w,) of a design on the shared cloud, and gradients.

        These are (1 + w, d), scaled as in `Search`. None if the search has to evaluate it.
        """
        self.vector = np.array(vector)
        self._rest.release()
        self._turn.acquire()
        if isinstance(self._answer, BaseException):
            raise self._answer
        return self._answer

    def go_on(self, answer: Any) -> None:
        """Let the search run with an ``answer`` until it asks again or ends; or raise one in it."""
        self._answer = answer
        self._turn.release()
        self._rest.acquire()

    def result(self) -> Any:
        """What the search that has ended returned, or raises what it raised."""
        if self._fault is not None:
            raise self._fault
        return self._found

    def _run(self):
        self._turn.acquire()
        try:
            if isinstance(self._answer, BaseException):
                raise self._answer
            self._found = self._search(self)
        except BaseException as problem:  # raised by `result`, in the thread that asks for it
            self._fault = problem
        self.ended = True
        self._rest.release()


class Together:
    """Searches of one design problem from different starts, evaluated by one program.

    ``cloud`` is the one that they share, for instance that of the problem's own start, and
    ``devices`` those of JAX, see `continuation.devices_of`. ValueError, one line, for a problem
    that no program evaluates.

    Example: docs/howto/many.md.
    """

    def __init__(self, problem: DesignProblem, cloud: Cloud, devices: list[Device]) -> None:
        check_for_batches(problem.sweep)
        for field, refused in (
            ("time", problem.time is not None),
            ("spread", problem.spread is not None),
            ("reported", bool(problem.reported)),
        ):
            if refused:
                raise ValueError(
                    f"device: a problem with {field} is for searches one by one alone; leave "
                    "--device out"
                )
        self.problem, self.cloud = problem, cloud
        parameters = problem.parameters(problem.vector)
        model = problem.options.model(cloud.at(problem.plate(parameters)))
        dry = problem_by_options(
            model, problem.gel_at(parameters), problem.sweep, loads=problem.loads.of(model)
        )
        # of the designs so far: a program finds out which of them lack it
        self._group = group_of_sweep(dry, problem.sweep.symmetry)
        self._program = Batched(self._sheet, dry.prepared, devices)

    def run(self, searches: Mapping[Any, Callable[[Member], Any]]) -> Iterator[tuple[Any, Any]]:
        """Key and result of every search, a function of its `Member`, as soon as it has ended.

        An error of one ends all of them; an interruption reaches each as a KeyboardInterrupt.
        """
        active = {key: Member(self, search) for key, search in searches.items()}
        answers = dict.fromkeys(active)
        try:
            while active:
                for key, answer in answers.items():
                    active[key].go_on(answer)
                for key in [key for key, member in active.items() if member.ended]:
                    yield key, active.pop(key).result()
                answers = self._answers({key: member.vector for key, member in active.items()})
        finally:
            for member in active.values():
                while not member.ended:
                    member.go_on(KeyboardInterrupt())

    def _answers(self, vectors):
        """Key -> `Member.values` of the designs that searches wait for."""
        found, keys = dict.fromkeys(vectors), list(vectors)
        while keys:
            group = self._group
            values, rows, status = self._program(group, np.stack([vectors[key] for key in keys]))
            finite = np.isfinite(values).all(axis=1) & np.isfinite(rows).all(axis=(1, 2))
            reached = np.all(status == Status.CONVERGED, axis=1) & finite
            found |= {key: (values[k], rows[k]) for k, key in enumerate(keys) if reached[k]}
            lacking = np.any(status == Status.ASYMMETRIC, axis=1)
            keys = [key for k, key in enumerate(keys) if lacking[k] and group]
            self._group = () if keys else group
        return found

    def _sheet(self, symmetry, vector):
        """Values (1 + w,) of a design, their gradients (1 + w, d), and the statuses of states."""
        problem = dataclasses.replace(
            self.problem, sweep=dataclasses.replace(self.problem.sweep, symmetry=symmetry)
        )

        def values(vector):
            found, (path, *_), _ = problem.judged(vector, self.cloud)
            return found, path.status

        found, pullback, status = jax.vjp(values, vector, has_aux=True)
        return found, jax.vmap(pullback)(jnp.eye(len(found)))[0], status
