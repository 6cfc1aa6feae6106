"""Order of closing: a plate in a bath whose two ellipses lose half of their area before its two circles do, at two prescribed times.

Problem: semi-axes of the ellipses and radius of the circles; ligaments of at least 0.9 mm, no self-contact.
"""

from pathlib import Path

from jaxgel.cases import load_study, run_study

study = load_study(Path(__file__).with_suffix(".toml"))

if __name__ == "__main__":
    design, verified = run_study(study, Path("out") / study.name, quiet=False)
    print(design.text)
    for name in ("start", "best"):
        found = verified[name]
        times = ", ".join("none" if time is None else f"{time:.3f}" for time in found["reported"].values())
        print(f"{name}: half of the area at t = {times}, {found['nodes']} nodes, {found['reason']}")
