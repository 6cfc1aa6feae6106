"""Place the onset of buckling: sample 4 of Deng et al. (2020) at mu = -1.2 kT instead of -1.77.

The radii and the distance of the four circles from the middle change together, so the plate keeps
its symmetry. Each step is the shortest change of the two that reaches the wanted onset along the
gradient of the critical mu (Newton's method on one equation with two unknowns). The result is
checked on a cloud with twice as many nodes.

    python design/onset.py            # writes out/onset.png; a few minutes
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel

WANTED = -1.2  # kT
WINDOW = 0.35  # kT to either side of the expected onset in which it is searched
STEPS = 8
TOLERANCE = 1e-6  # kT


def placed(cloud, theta):
    """The model of sample 4 with radius theta[0] and centres at (+-theta[1], +-theta[1]), mm."""
    holes = [
        {"radius": theta[0], "centre": jnp.sign(hole.centre) * theta[1]}
        for hole in cloud.plate.holes
    ]
    return jaxgel.discretise(cloud.at(cloud.plate.at(holes)))


def onset(theta, cloud, expected):
    """Critical mu () of the first bifurcation, kT."""
    points = jaxgel.critical_points(
        jaxgel.Problem(placed(cloud, theta), cloud.plate.gel),
        (expected - WINDOW, expected + WINDOW),
        most=1,
    )
    if not points:
        raise ArithmeticError(f"no bifurcation within {WINDOW} kT of mu = {expected:.3f}")
    return points[0].mu


def design(cloud, theta, expected, wanted=WANTED):
    """History of (theta, onset) from ``theta`` to the ``wanted`` onset.

    It begins with the ``expected`` onset.
    """
    history = []
    for _ in range(STEPS):
        now, gradient = jax.value_and_grad(onset)(theta, cloud, expected)
        history.append((np.asarray(theta), float(now)))
        if abs(now - wanted) < TOLERANCE:
            break
        # at most so far that the next onset lies in the window
        change = np.clip(wanted - now, -0.25, 0.25)
        theta, expected = theta + change * gradient / (gradient @ gradient), float(now + change)
    return history


def draw(cloud, history, file):
    """The onset over the steps, and the gel of the first and last design just after it buckled."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from jaxgel.plotting import STYLE, plot_pattern

    with mpl.rc_context(STYLE):
        figure, axes = plt.subplots(1, 3, figsize=(8.0, 2.9), layout="constrained")
        axes[0].plot(range(len(history)), [mu for _, mu in history], marker="o", color="#0072b2")
        axes[0].axhline(WANTED, color="#d55e00", linestyle="--", label="wanted")
        axes[0].set(xlabel="step", ylabel=r"onset of buckling $\mu_c$ ($kT$)")
        axes[0].legend(frameon=False)
        axes[0].set_xticks(range(len(history)))
        for ax, (theta, _), name in zip(
            axes[1:], (history[0], history[-1]), ("sample 4", "design"), strict=True
        ):
            model = placed(cloud, theta)
            path = jaxgel.sweep(jaxgel.Problem(model, cloud.plate.gel), [-2.2, -1.4])
            plot_pattern(path, -1, ax=ax, field=None)
            state = "buckled" if path.switched[-1] else "not buckled"
            sizes = rf"$r={theta[0]:.3f}$ mm, $d={theta[1]:.3f}$ mm"
            ax.set_title(f"{name}, {state} at " + rf"$\mu={path.mu[-1]:.1f}\,kT$" + f"\n{sizes}")
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(file)


def main():
    """Design on the sample's own cloud, check on a finer one, draw."""
    plate = jaxgel.sample("sample-4")
    cloud = jaxgel.make_cloud(plate)
    theta = jnp.array([float(plate.holes[0].radius), abs(float(plate.holes[0].centre[0]))])
    history = design(cloud, theta, -1.76)
    for step, (theta, mu) in enumerate(history):
        print(
            f"step {step}: radius {theta[0]:.4f} mm, distance {theta[1]:.4f} mm, onset {mu:.6f} kT"
        )
    fine = jaxgel.make_cloud(plate, spacing=22 / 60)
    print(
        f"on {len(fine.nodes)} nodes instead of {len(cloud.nodes)}: onset "
        f"{float(onset(history[-1][0], fine, WANTED)):.5f} kT"
    )
    draw(cloud, history, "out/onset.png")


if __name__ == "__main__":
    main()
