"""Onset of infinite lattices beside finite elements (bloch_elements.py; extra ``[bench]``).

    python benchmarks/waves.py [--rows onset layers] [--figure FILE]

``onset``: round holes in cells of 2 mm, by Bloch waves of one cell, by jaxgel's own 2 x 2 cell, and
    by finite elements of both;
``layers``: wrinkles of bilayers and of a graded layer on a rigid base, beside exact waves
(tests/layers.py). ``--figure FILE`` draws what docs/howto/waves.md
shows.
"""  # fmt: skip

import argparse
import itertools
import sys
import time
from pathlib import Path

import bloch_elements as elements
import matplotlib as mpl
import numpy as np

import jaxgel

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import layers as exact_layers

GEL = elements.GEL
# of holes in cells of 2 mm, mm -> mu between which the onset lies, kT
RADII = {0.7: (-2.2, -1.2), 0.8: (-2.8, -1.6)}
SPACINGS = (1 / 8, 1 / 12, 1 / 16)  # mm
STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}
NV, CHI = 1e-3, 0.1  # of the lower layer
BILAYERS = {
    (0.1, 10): (-0.8, -0.65),
    (0.2, 10): (-0.8, -0.6),
    (0.1, 3): (-0.35, -0.22),
    (0.2, 3): (-0.35, -0.22),
    # thickness of the upper layer, mm of 1 mm, and its Nv over NV -> mu between which the onset
    # lies, kT
}
LAYER_SPACINGS = (1 / 10, 1 / 20, 1 / 40)  # mm


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="*", default=list(ROWS), choices=list(ROWS))
    parser.add_argument("--figure", help="file of the figure of docs/howto/waves.md")
    options = parser.parse_args()
    for row in options.rows:
        ROWS[row]()
    if options.figure is not None:
        draw(options.figure)


def model_of(radius, spacing, cells=1):
    """Model of a periodic plate of ``cells`` x ``cells`` cells of 2 mm."""
    centres = np.arange(1 - cells, cells, 2)
    holes = (
        [jaxgel.Circle(centre, radius) for centre in itertools.product(centres, centres)]
        if radius
        else []
    )
    plate = jaxgel.Plate(
        2 * cells,
        2 * cells,
        holes,
        edges="periodic",
        spacing=spacing,
        nodes_per_hole=round(4 / spacing / 4) * 4,
    )
    return jaxgel.discretise(jaxgel.make_cloud(plate))


def onset():
    """Onsets by one cell and by 2 x 2, beside those of finite elements."""
    print("onset of the lattice of holes 2 mm apart")
    for radius, mu in RADII.items():
        begin = time.perf_counter()
        exact, k, _ = elements.onset_of_lattice(2.0, radius, *mu, order=6)
        cells = elements.onset_of_cells(2.0, radius, 2, *mu, order=6)
        seconds = time.perf_counter() - begin
        print(
            f"r = {radius}: finite elements {exact:.5f}, k W/pi {k * 2 / np.pi}, 2 x 2 holes "
            f"{cells:.5f}, both {seconds:.0f} s"
        )
        for spacing in SPACINGS:
            begin = time.perf_counter()
            found = jaxgel.lattice_onset(jaxgel.Problem(model_of(radius, spacing), GEL), mu)
            seconds = time.perf_counter() - begin
            (point,) = jaxgel.critical_points(
                jaxgel.Problem(model_of(radius, spacing, 2), GEL), mu, most=1
            )
            errors = [100 * (value / cells - 1) for value in (found.mu, point.mu)]
            print(
                f"  spacing {spacing:.4f}: one cell {found.mu:.5f} ({errors[0]:+.2f} %, "
                f"{seconds:.0f} s), 2 x 2 {point.mu:.5f}"
                f" ({errors[1]:+.2f} %); {found.kind}, periods {found.periods}",
                flush=True,
            )


def layers():
    """Wrinkling of bilayers, and of a layer whose Nv is linear, ten times as large at the surface.

    It is NV at the base.
    """
    print(
        "wrinkles of layers 1 mm thick together on a rigid base, strips of 0.4 mm: mu, k in "
        "rad/mm, volume ratio at the surface"
    )
    for (upper, ratio), window in BILAYERS.items():
        gel = jaxgel.Composite(jaxgel.Gel(NV, CHI), (jaxgel.Gel(ratio * NV, CHI),))
        parts, regions = (
            [(1 - upper, NV, CHI), (upper, ratio * NV, CHI)],
            [jaxgel.Rectangle((0, 0.5), (4, 2 * upper))],
        )
        layer(f"upper layer {upper:g} mm, {ratio} Nv", parts, regions, gel, window, ratio * NV)
    parts = exact_layers.graded(lambda y: NV * (1 + 9 * y), CHI, slices=320)
    layer(
        "graded, Nv to 10 Nv",
        parts,
        [],
        jaxgel.Gel(lambda X: NV * (5.5 + 9 * X[1]), CHI),
        (-0.2, -0.1),
        10 * NV,
    )


def layer(name, parts, regions, gel, window, Nv):
    """Rows of one layer of exact ``parts``, with ``Nv`` at the surface."""
    mu, k = exact_layers.onset(parts, np.linspace(*window, 6), np.linspace(1, 8, 8))
    J = exact_layers.stretch(Nv, CHI, mu)
    print(f"{name}: exact {mu:.6f}, {k:.4f}, {J:.5f}")
    for spacing in LAYER_SPACINGS:
        begin = time.perf_counter()
        plate = jaxgel.Plate(0.4, 1.0, edges=STRIP, regions=regions, spacing=spacing)
        found = jaxgel.lattice_onset(
            jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate)), gel), window, divisions=4
        )
        errors = (
            found.mu / mu - 1,
            abs(found.wave_vector[0]) / k - 1,
            exact_layers.stretch(Nv, CHI, found.mu) / J - 1,
        )
        shown = ", ".join(f"{100 * error:+.3f} %" for error in errors)
        print(
            (
                f"  spacing {spacing:.4f}: {found.mu:.6f}; {shown}; "
                f"{time.perf_counter() - begin:.0f} s"
            ),
            flush=True,
        )


def draw(file):
    """Zone and pattern of the lattice of the paper's radius, side by side."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from jaxgel.plotting import STYLE, plot_lattice, plot_zone, save_figure

    model, gel = model_of(0.9, 1 / 12), jaxgel.sample("lattice").gel
    found = jaxgel.lattice_onset(jaxgel.Problem(model, gel), (-3.6, -2.8))
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(6.9, 3.1), layout="constrained")
    plot_zone(found, model, ax=axes[0])
    plot_lattice(found, model, ax=axes[1])
    save_figure(figure, file)


ROWS = {"onset": onset, "layers": layers}


if __name__ == "__main__":
    main()
