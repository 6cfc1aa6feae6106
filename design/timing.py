"""Prescribed time: a plate in a bath whose core turns by 15 degrees at t = 0.5.

It is an inverse problem of transient swelling. Problem: semi-axes, centre and tilt of one ellipse,
the others being its quarter turns; ligaments of at least 0.8 mm, no self-contact. Start: sample 1
of Deng et al. (2020), https://doi.org/10.1016/j.enganabound.2019.12.004, whose core turns more
slowly.
"""

from pathlib import Path

from jaxgel.cases import load_study, run_study

study = load_study(Path(__file__).with_suffix(".toml"))

if __name__ == "__main__":
    design, verified = run_study(study, Path("out") / study.name, quiet=False)
    print(design.text)
    for name in ("start", "best"):
        found = verified[name]
        rotation = found["last"]["core_rotation"]
        print(
            f"{name}: {rotation:.2f} degrees at t = 0.5, {found['nodes']} nodes, {found['reason']}"
        )
