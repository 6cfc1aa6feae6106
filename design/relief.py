"""Relief valve: a buckled strip that snaps open at the load 0.25 and shut at -0.26.

Problem: radius of a hole above the middle line and Nv of the gel, so that both folds of the loop
lie at prescribed loads. The strip swells between two walls, buckles, and snaps through under a
traction on its top edge.
"""

from pathlib import Path

from jaxgel.cases import load_study, run_study

study = load_study(Path(__file__).with_suffix(".toml"))

if __name__ == "__main__":
    design, verified = run_study(study, Path("out") / study.name, quiet=False)
    print(design.text)
    for name in ("start", "best"):
        folds = verified[name]["reported"]
        print(
            f"{name}: opens at {folds['fold_up']:.4f}, shuts at {folds['fold_down']:.4f}, "
            f"{verified[name]['reason']}"
        )
