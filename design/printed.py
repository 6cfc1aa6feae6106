"""Holes and gel together: four ellipses and a field of Nv for the largest midline rotation.

The chemical potential is -0.9178 kT; the field is printed. Problem: semi-axes, centre and tilt of
one ellipse, the others being its quarter turns, and the 40 x 40 pixels of Nv on the plate; the hole
area, ligaments, gaps and creases are bounded as in rotation.toml, and the mean Nv is that of the
samples. Start: the holes that turn the farthest in a uniform gel.
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
