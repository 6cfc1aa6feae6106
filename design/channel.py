"""Seal: a gel post with four bores, free of its channel's walls when dry, pressing them when wet.

It is free at mu = -1 kT and presses at -0.3 kT. Problem: semi-axes of elliptic bores that open as
far as possible, under a lower bound of the sealing force; valves of hydrogel posts in channels
after Beebe et al. (2000), https://doi.org/10.1038/35007047. A quarter of the post is computed, the
wall is a half-plane.
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
            f"{name}: bores {-100 * last['area_reduction']:.0f} % wider, force "
            f"{last['obstacle_force']:.5f} kT/v mm, {found['reason']}"
        )
