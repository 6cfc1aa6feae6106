"""Closing without turning: four holes close at mu = -0.9178 kT while the core stays straight.

Problem: radius, place and outline (Fourier modes) of one hole, the others being its quarter turns;
core rotation below 1 degree, a tangent whose lowest eigenvalue keeps a margin to instability, no
crease. Round holes of sample 4 buckle: Deng et al. (2020),
https://doi.org/10.1016/j.enganabound.2019.12.004
"""

from pathlib import Path

from jaxgel.cases import load_study, run_study

study = load_study(Path(__file__).with_suffix(".toml"))

if __name__ == "__main__":
    design, verified = run_study(study, Path("out") / study.name, quiet=False)
    print(design.text)
    for name in ("start", "best"):
        found, last = verified[name], verified[name]["last"]
        print(
            f"{name}: {100 * last['area_reduction']:.2f} % area reduction, surface ratio "
            f"{found['surface_ratio']:.2f}, {found['reason']}"
        )
