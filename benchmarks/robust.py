"""The rotation study and its robust version as made: python benchmarks/robust.py [--quick]

Option: [--samples 64]. Both start from the best design in design/verified.json; all semi-axes are
uncertain by 1 %. The robust search maximises the mean less three standard deviations over 8
samples. Then both are made ``--samples`` times on the cloud of the search: mean, standard deviation
and smallest rotation of the midline, degrees. Some ten minutes; ``--quick`` has a coarse cloud, two
samples and one evaluation.
"""

import argparse
import copy
import json
import tempfile
import time
import tomllib
from pathlib import Path

from jaxgel.cases import run_study, study_from_table

DESIGN = Path(__file__).parents[1] / "design"
UNCERTAIN = {"semi_axes": "1 %"}
MU = [-4.5, -2.7, -1.8, -1.3, -0.9178]  # kT


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--samples", type=int, default=64, help="plates that are made of each design (64)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="coarse cloud, two samples, one evaluation"
    )
    options = parser.parse_args()
    samples = 2 if options.quick else options.samples
    table = plain(1.1 if options.quick else 0.55, samples)
    robust = copy.deepcopy(table)
    robust["robust"] = {
        "uncertainty": UNCERTAIN,
        "samples": 2 if options.quick else 8,
        "weight": 3.0,
    }
    robust["search"] |= {"evaluations": 1 if options.quick else 16, "step": 0.05}
    print(f"{'study':>8}{'mean':>9}{'deviation':>11}{'worst':>9}{'valid':>7}{'s':>7}  design")
    for name, study in (("plain", table), ("robust", robust)):
        begin = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            design, verified = run_study(study_from_table(study, name), folder)
        made = verified["as_made"]
        numbers = "".join(
            f"{made[key]:{width}.3f}"
            for key, width in (("mean", 9), ("deviation", 11), ("worst", 9))
        )
        text = {
            key: [round(float(number), 4) for number in value.ravel()]
            for key, value in design.parameters.items()
        }
        print(
            f"{name:>8}{numbers}{samples - made['invalid']:>7}"
            f"{time.perf_counter() - begin:>7.0f}  {text}",
            flush=True,
        )


def plain(spacing, samples):
    """The converged rotation study, begun at its best design, verified on one cloud.

    It is sampled so many times.
    """
    table = tomllib.loads((DESIGN / "rotation.toml").read_text(encoding="utf-8"))
    best = json.loads((DESIGN / "verified.json").read_text(encoding="utf-8"))["rotation"][
        "parameters"
    ]
    for parameter in table["parameters"]:
        parameter["start"] = best[parameter.get("name", parameter["of"])]
    table["sweep"]["mu"], table["discretisation"]["spacing"] = MU, spacing
    table["search"]["evaluations"] = 1
    table["verification"] = {"spacing": spacing, "uncertainty": UNCERTAIN, "samples": samples}
    return table


if __name__ == "__main__":
    main()
