"""Target curve: a midline rotation proportional to mu - mu0 between -2 and -1 kT.

It is an inverse problem on the whole sweep. Problem: semi-axes, centre and tilt of one ellipse, the
others being its quarter turns, so that the rotation is 18 (mu + 2.5) degrees. Start: sample 1 of
Deng et al. (2020), https://doi.org/10.1016/j.enganabound.2019.12.004, whose rotation grows ever
faster.
"""

from pathlib import Path

from jaxgel.cases import load_study, run_study

study = load_study(Path(__file__).with_suffix(".toml"))

if __name__ == "__main__":
    design, verified = run_study(study, Path("out") / study.name, quiet=False)
    print(design.text)
    for name in ("start", "best"):
        found = verified[name]
        print(
            f"{name}: off by {found['value'] ** 0.5:.3f} degrees (root mean square), "
            f"{found['nodes']} nodes, {found['reason']}"
        )
