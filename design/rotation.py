"""Maximum rotation: four alternating ellipses in a 22 mm plate at mu = -0.9178 kT.

They turn the midline as far as they can. Problem: semi-axes, centre and tilt of one ellipse, the
others being its quarter turns; ligaments of at least 1 mm, no self-contact, and no deeper creases
than the start has. Start: sample 1 of Deng, He, Sun, Yi & Dai (2020),
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
            f"{name}: {last['rotation']:.2f} degrees, surface ratio {found['surface_ratio']:.2f}, "
            f"{found['reason']}"
        )
