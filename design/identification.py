"""Parameter identification: Nv, chi and the radius of a hole from one noisy swelling curve.

Problem: the area reduction of a round hole in an 8 mm plate was measured at 16 chemical potentials
with a standard deviation of 1e-4; which gel and which hole were they? Least squares by
`jaxgel design`, confidence from Gauss and Newton's Hessian.

The data are synthetic. Made on the cloud that also fits them they would flatter the fit (an
"inverse crime"), so they come from a finer cloud; how often 95 % intervals contain the truth is
counted for both.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

import jaxgel
from jaxgel.cases import load_study, run_study
from jaxgel.design import intervals

TRUTH = {"Nv": 0.05, "chi": 0.3, "radius": 2.8}
NOISE = 1e-4
FINE = 0.5  # mm, spacing of the cloud that makes the data; the search's is 0.8
study = load_study(Path(__file__).with_suffix(".toml"))


def curve(parameters, spacing=None, cloud=None):
    """Area reduction (16,) of the study's plate at a dict of parameters, on a new cloud.

    A cloud may be given.
    """
    cloud = (
        study.problem.make_cloud(study.problem.plate(TRUTH), spacing) if cloud is None else cloud
    )
    return jaxgel.area_reduction(study.problem.path(parameters, cloud))


def fit(data, cloud, steps=6):
    """Parameters fitted to ``data`` (16,) by Gauss and Newton's method from the truth."""
    flat, unravel = ravel_pytree({name: jnp.asarray(value) for name, value in TRUTH.items()})
    scale = np.asarray(flat)
    for _ in range(steps):
        values, pushed = jax.linearize(lambda v: curve(unravel(v), cloud=cloud), flat)
        slopes = np.stack([np.asarray(pushed(jnp.asarray(d))) for d in np.diag(scale)], axis=1)
        flat = flat + scale * np.clip(
            np.linalg.lstsq(slopes, data - np.asarray(values), rcond=None)[0], -0.2, 0.2
        )
    return unravel(flat)


def coverage(clean, cloud, realisations=20):
    """Shares of 95 % intervals that contain the truth, a dict, over noisy copies of ``clean``."""
    hits, random = dict.fromkeys(TRUTH, 0), np.random.default_rng(7)
    for _ in range(realisations):
        found = fit(np.asarray(clean) + NOISE * random.normal(size=len(clean)), cloud)
        deviations, _ = intervals(study.problem, found, jaxgel.area_reduction, NOISE, cloud=cloud)
        for name, truth in TRUTH.items():
            hits[name] += bool(abs(float(found[name]) - truth) < 1.96 * float(deviations[name]))
    return {name: count / realisations for name, count in hits.items()}


def synthetic_data(seed=3):
    """The curve of the TOML file: the truth on a fine cloud, with noise."""
    clean = np.asarray(curve(TRUTH, FINE))
    return np.round(clean + NOISE * np.random.default_rng(seed).normal(size=len(clean)), 6)


if __name__ == "__main__":
    design, verified = run_study(study, Path("out") / study.name, quiet=False)
    cloud = study.problem.make_cloud(study.problem.plate(TRUTH))
    deviations, _ = intervals(
        study.problem, design.parameters, jaxgel.area_reduction, NOISE, cloud=cloud
    )
    for name, truth in TRUTH.items():
        print(
            f"{name}: {float(design.parameters[name]):.5g} +- "
            f"{1.96 * float(deviations[name]):.2g} (95 %), truth {truth:g}"
        )
    print(
        "coverage of 95 % intervals, data from the same cloud:",
        coverage(curve(TRUTH, cloud=cloud), cloud),
    )
    print(
        "coverage of 95 % intervals, data from a finer cloud: ", coverage(curve(TRUTH, FINE), cloud)
    )
