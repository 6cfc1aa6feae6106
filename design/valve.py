"""Soft valve: one bore that closes by 40 % at mu = -0.6678 kT, without creasing.

Problem: semi-axes and exponent of a superelliptic bore in a 22 mm plate, so that its area falls by
40 % while the surface stretch ratio stays below 2.4, where the surface of a gel creases: Hong, Zhao
& Suo (2009), https://doi.org/10.1063/1.3211917
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
