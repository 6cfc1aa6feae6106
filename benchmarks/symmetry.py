"""Time of sweeps and gradients on a part of a symmetric plate beside the whole plate.

    python benchmarks/symmetry.py [--cases sample-1 ...] [--spacing MM] [--runs 5] [--gradient]
        [--program]

Prints, for each case and branch on its default cloud or with the given spacing: nodes, the groups
of its states, the median seconds of 30 states to -0.9178 kT with ``symmetry="off"`` and "auto",
taken in turn, their ratio, and how far states and energies are apart; with ``--gradient`` also the
seconds of the area reduction of the last state with its derivatives by all holes, on the stable
branch; with ``--program`` the same sweep inside ``jax.jit``, a function of Nv and chi, over the
values before the symmetric branch buckles, and the host's sweep over these. Run it under
``taskset -c 0`` with ``NPROC=1`` for one thread.
"""  # fmt: skip

import argparse
import collections
import dataclasses
import functools
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel

MU = np.linspace(-4.9678, -0.9178, 30)  # kT
CASES = {
    "sample-1": "stable",
    "sample-4": "symmetric",
    "sample-7": "symmetric",
    "lattice": "symmetric",
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=list(CASES), help="built-in names")
    parser.add_argument("--spacing", type=float, help="of the nodes, mm (the case's own)")
    parser.add_argument("--runs", type=int, default=5, help="timed runs of each (5)")
    parser.add_argument(
        "--gradient", action="store_true", help="time a value with its gradient, too"
    )
    parser.add_argument("--program", action="store_true", help="time compiled sweeps, too")
    options = parser.parse_args()
    times = f"{'off/s':>7} {'auto/s':>7} {'ratio':>6}"
    print(
        f"{'case':10} {'branch':10} {'nodes':>6} {'states':20} {times} {'x, mm':>8} {'energy':>8} "
        f"{'pivots':>6}"
    )
    for name in options.cases:
        plate, branch = jaxgel.sample(name), CASES.get(name, "stable")
        cloud = jaxgel.make_cloud(plate, spacing=options.spacing)
        model = jaxgel.discretise(cloud)

        def path(symmetry, model=model, gel=plate.gel, branch=branch):
            return jaxgel.sweep(jaxgel.Problem(model, gel), MU, branch=branch, symmetry=symmetry)

        (off, whole), (auto, part) = in_turn(path, options.runs)
        k = min(len(whole), len(part))
        groups = ", ".join(
            f"{count} {group}" for group, count in collections.Counter(part.symmetry).items()
        )
        apart = (
            np.abs(part.x[:k] - whole.x[:k]).max(),
            np.abs(part.energy[:k] / whole.energy[:k] - 1).max(),
        )
        pivots = (
            "equal" if np.array_equal(part.negative_pivots, whole.negative_pivots) else "differ"
        )
        times = f"{off:7.3f} {auto:7.3f} {off / auto:6.2f}"
        print(
            (
                f"{name:10} {branch:10} {model.n_nodes:6d} {groups:20} {times} {apart[0]:8.1e} "
                f"{apart[1]:8.1e} {pivots:>6}"
            ),
            flush=True,
        )
        if options.gradient:

            def gradient(symmetry, cloud=cloud, plate=plate):
                def value(theta):
                    model = jaxgel.discretise(cloud.at(plate.at(theta)))
                    return jaxgel.area_reduction(
                        jaxgel.sweep(jaxgel.Problem(model, plate.gel), MU, symmetry=symmetry)
                    )[-1]

                return jax.block_until_ready(jax.value_and_grad(value)(plate.theta))

            (off, (_, one)), (auto, (_, two)) = in_turn(gradient, options.runs)
            pairs = zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True)
            apart = max(float(np.abs(a - b).max()) for a, b in pairs) / max(
                float(np.abs(a).max()) for a in jax.tree.leaves(one)
            )
            print(
                (
                    f"{'':10} value and gradient{'':21} {off:7.3f} {auto:7.3f} {off / auto:6.2f} "
                    f"{apart:8.1e} of the largest derivative"
                ),
                flush=True,
            )
        if options.program:
            stable = MU[: int(np.argmax([*(part.negative_pivots > 0), True]))]
            compiled_sweeps(model, plate.gel, stable, options.runs)


def compiled_sweeps(model, gel, mu, runs):
    """Prints the seconds of compiled sweeps to values ``mu``, beside the host's sweep."""
    programs, spent = {}, {}
    for symmetry in ("off", "auto"):

        def states(numbers, symmetry=symmetry):
            own = dataclasses.replace(gel, Nv=numbers[0], chi=numbers[1])
            return jaxgel.sweep(jaxgel.Problem(model, own), mu, symmetry=symmetry)

        numbers, begin = jnp.array([gel.Nv, gel.chi]), time.perf_counter()
        compiled = jax.jit(states).lower(numbers).compile()
        spent[symmetry] = time.perf_counter() - begin
        programs[symmetry] = functools.partial(compiled, numbers)
    (off, whole), (auto, part) = in_turn(
        lambda symmetry: jax.block_until_ready(programs[symmetry]()), runs
    )
    (_, _), (host, by_host) = in_turn(
        lambda symmetry: jaxgel.sweep(jaxgel.Problem(model, gel), mu, symmetry=symmetry), runs
    )
    apart = [float(np.abs(np.asarray(one.x) - by_host.x).max()) for one in (whole, part)]
    print(
        (
            f"{'':10} program of {len(mu)} states, {part.symmetry[0]:17} {off:7.3f} {auto:7.3f} "
            f"{off / auto:6.2f} {max(apart):8.1e} mm from the host's, {host:.3f} s; compiled in "
            f"{spent['off']:.0f} and {spent['auto']:.0f} s"
        ),
        flush=True,
    )


def in_turn(function, runs):
    """(median seconds, last result) with "off" and with "auto", after a first run of each."""
    times, results = collections.defaultdict(list), {}
    for _ in range(runs + 1):
        for symmetry in ("off", "auto"):
            begin = time.perf_counter()
            results[symmetry] = function(symmetry)
            times[symmetry].append(time.perf_counter() - begin)
    return [
        (statistics.median(times[symmetry][1:]), results[symmetry]) for symmetry in ("off", "auto")
    ]


if __name__ == "__main__":
    main()
