"""Programs that JAX compiles in one fresh process, stage by stage.

Run it by python benchmarks/programs.py [--functions N]. A stage prints how many programs it
compiled or loaded, and its seconds: in all, of tracing, of lowering, and of compiling (or loading
from a compilation cache, where JAX_COMPILATION_CACHE_DIR names one); then the functions whose
programs took longest, each with its seconds of the three kinds and its number of programs. The two
plates have four holes each and nearly as many nodes; the table is that of ``history.csv``, with the
fields of figures and files. ``--quick`` takes a wide spacing.

With ``--plates N`` that many different plates are swept and differentiated instead. Every tenth
line has programs compiled so far, memory mappings and memory.
"""

import argparse
import collections
import os
import pathlib
import time

import jax
import jax.numpy as jnp
import numpy as np
from jax import monitoring

import jaxgel
from jaxgel import observables
from jaxgel._programs import mappings
from jaxgel.design import DesignProblem, bound, optimise, value_at

KINDS = {
    "jaxpr_trace_duration": "tracing",
    "jaxpr_to_mlir_module_duration": "lowering",
    "backend_compile_duration": "compiling",
}
GEL = jaxgel.Gel(Nv=1e-3, chi=0.2)
VALUES = jnp.linspace(-3.8, -2.9, 4)


class Programs:
    """Spans of time that JAX spends on each kind of work, by function, until `taken`."""

    def __init__(self):
        self.spans = collections.defaultdict(list)
        monitoring.register_event_time_span_listener(self._hear)

    def _hear(self, event, start, end, fun_name="", **_):
        kind = KINDS.get(event.rpartition("/")[2])
        if kind:
            self.spans[kind].append((start, end, fun_name))

    def taken(self):
        """Kind of work -> its spans since the last call."""
        spans, self.spans = self.spans, collections.defaultdict(list)
        return spans


def covered(spans):
    """Seconds that a list of spans covers, those inside others once."""
    total, last = 0.0, 0.0
    for start, end, _ in sorted(spans):
        total += max(0.0, end - max(start, last))
        last = max(last, end)
    return total


def plate(axes, spacing):
    """A plate with four like ellipses."""
    holes = [jaxgel.Ellipse((x, y), axes, 0.3) for x in (-11.0, 11.0) for y in (-11.0, 11.0)]
    return jaxgel.Plate(44, 44, holes, spacing=spacing, core=(1.0, 2.0))


def rotation(made, cloud):
    """Rotation of the core at the last of ``VALUES``, as a function of the holes' semi-axes."""

    def of(axes):
        model = jaxgel.discretise(cloud.at(made.at([{"semi_axes": axes}] * 4)))
        return jaxgel.core_rotation(jaxgel.sweep(jaxgel.Problem(model, GEL), VALUES))[-1]

    return of


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--functions", type=int, default=6, help="functions named for each stage (6)"
    )
    parser.add_argument("--quick", action="store_true", help="a wide spacing")
    parser.add_argument("--plates", type=int, help="number of plates, whose holes differ by 5 %%")
    options = parser.parse_args()
    spacing = 3.0 if options.quick else 1.4
    programs = Programs()
    if options.plates:
        many(options.plates, spacing, programs)
        return
    print(
        f"{'stage':<34} {'programs':>8} {'seconds':>8} {'tracing':>8} {'lowering':>8} "
        f"{'compiling':>9}  nodes"
    )
    clouds, paths = {}, {}
    for name, axes in {"first": (6.0, 4.5), "second": (5.7, 4.9)}.items():
        made = plate(axes, spacing)

        def swept(made=made, name=name):
            clouds[name] = made, jaxgel.make_cloud(made)
            paths[name] = jaxgel.sweep(
                jaxgel.Problem(jaxgel.discretise(clouds[name][1]), GEL), VALUES
            )
            return jaxgel.core_rotation(paths[name])

        stage(
            f"{name} plate: sweep",
            swept,
            programs,
            options.functions,
            lambda name=name: clouds[name][1],
        )
    for name, path in paths.items():
        stage(
            f"{name} plate: table and fields",
            lambda path=path: observed(path),
            programs,
            options.functions,
        )
    for name, axes in {"first": (6.0, 4.5), "second": (5.7, 4.9)}.items():
        of = jax.value_and_grad(rotation(*clouds[name]))
        stage(
            f"{name} plate: gradient",
            lambda of=of, axes=axes: of(jnp.array(axes)),
            programs,
            options.functions,
        )
    for name in clouds:
        problem = jaxgel.Problem(jaxgel.discretise(clouds[name][1]), GEL)
        stage(
            f"{name} plate: critical points",
            lambda p=problem: jaxgel.critical_points(p, (-4.0, -2.5)),
            programs,
            options.functions,
        )

    def again():
        moved = plate((6.2, 4.4), spacing)
        return jax.value_and_grad(rotation(moved, jaxgel.make_cloud(moved)))(jnp.array([6.2, 4.4]))

    stage("a cloud made anew: gradient", again, programs, options.functions)
    for name, (made, _) in clouds.items():
        stage(
            f"{name} plate: evaluation of a study",
            lambda made=made: evaluated(made),
            programs,
            options.functions,
        )


def observed(path):
    """The table of a path, and its fields for figures and files."""
    table = observables.history(path)
    fields = [
        of(path)
        for of in (
            observables.outlines,
            observables.deformed_vertices,
            observables.volume_ratio,
            observables.cauchy_stress,
        )
    ]
    return table["rotation_deg"], fields


def evaluated(made):
    """First evaluation of a rotation study with its gradient.

    The surface ratio and the gap are bounded.
    """
    start = {"axes": np.array(made.holes[0].semi_axes, float)}
    bounds = {"axes": (start["axes"] - 0.5, start["axes"] + 0.5)}
    limits = bound("surface_ratio", below=3.0), bound("gap", above=0.5)

    def plate_of(parameters):
        return made.at([{"semi_axes": parameters["axes"]}] * 4)

    problem = DesignProblem(
        start,
        bounds,
        plate_of,
        GEL,
        VALUES,
        value_at(jaxgel.rotation_angle, VALUES[-1]),
        constraints=limits,
    )
    return optimise(problem, evaluations=1).parameters


def many(count, spacing, programs):
    """Sweep and differentiate ``count`` plates.

    Print what the process has taken by every tenth one.
    """
    print("plate  programs  mappings  GiB")
    compiled = 0
    for k, factors in enumerate(np.random.default_rng(1).uniform(0.95, 1.05, (count, 2))):
        axes = np.array([6.0, 4.5]) * factors
        made = plate(tuple(axes), spacing)
        jax.block_until_ready(
            jax.value_and_grad(rotation(made, jaxgel.make_cloud(made)))(jnp.array(axes))
        )
        compiled += len(programs.taken()["compiling"])
        if k % 10 in (0, 9):
            pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
            print(
                (
                    f"{k + 1:5} {compiled:9} {mappings()[0]:9} "
                    f"{pages * os.sysconf('SC_PAGE_SIZE') / 2**30:4.2f}"
                ),
                flush=True,
            )


def stage(name, run, programs, count, cloud=None):
    """Run a stage and print its line and its dearest functions."""
    programs.taken()
    began = time.perf_counter()
    jax.block_until_ready(run())
    seconds, spans = time.perf_counter() - began, programs.taken()
    compiled = spans["compiling"]
    of_kind = [covered(spans[kind]) for kind in ("tracing", "lowering", "compiling")]
    nodes = "" if cloud is None else len(cloud().nodes)
    print(
        f"{name:<34} {len(compiled):8} {seconds:8.1f} {of_kind[0]:8.1f} {of_kind[1]:8.1f} "
        f"{of_kind[2]:9.1f}  {nodes}"
    )
    by_function = collections.defaultdict(lambda: [0.0] * 3)
    for number, kind in enumerate(("tracing", "lowering", "compiling")):
        for start, end, function in spans[kind]:
            by_function[bare(function)][number] += end - start
    numbers = collections.Counter(bare(function) for _, _, function in compiled)
    dearest = sorted(by_function, key=lambda function: -sum(by_function[function]))[:count]
    told = ("+".join(f"{seconds:.2f}" for seconds in by_function[function]) for function in dearest)
    print(
        "    "
        + ", ".join(
            f"{name} {text} s ({numbers[name]})" for name, text in zip(dearest, told, strict=True)
        ),
        flush=True,
    )


def bare(function):
    """The name of a function, which JAX calls jit(name) when it compiles it."""
    return function.removeprefix("jit(").removesuffix(")")


if __name__ == "__main__":
    main()
