"""A square film that swells into a cushion: cross-link density for a given outline.

Problem: the 32 x 32 pixels of Nv on a quarter of a free film of 4 x 4 mm, the mirror images being
the other quarters, so that at mu = -0.002 kT its edges lie on four bulging sides between
right-angled corners. Without a field it stays a square. The growth is not free of stress: a film
that is thin must be held flat, between two plates for instance, or it wrinkles where it is
compressed.
"""

from pathlib import Path

import numpy as np

from jaxgel.cases import load_study, run_study

CORNER = 3.3  # mm, from the middle of the swollen film along either axis
BULGE = 1.1  # mm, by which the middle of a side lies farther out than its corners
study = load_study(Path(__file__).with_suffix(".toml"))


def outline(points=21):
    """The target (m, 2) on the quarter, mm, from one mirror line to the other.

    The quarter's own lower left corner is at (-1, -1).
    """
    along = np.linspace(0.0, CORNER, points)
    side = np.stack([CORNER + BULGE * (1 + np.cos(np.pi * along / CORNER)) / 2, along], axis=1)
    return np.concatenate([side, side[-2::-1, ::-1]]) - 1.0


if __name__ == "__main__":
    design, verified = run_study(study, Path("out") / study.name, quiet=False)
    print(design.text)
    for name in ("start", "best"):
        found = verified[name]
        print(
            f"{name}: edges off by {found['value'] ** 0.5:.4f} mm (root mean square), "
            f"{found['nodes']} nodes, {found['reason']}"
        )
