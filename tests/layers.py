"""Exact wrinkling of gel layers on a rigid base, by transfer of displacements, tractions.

Layers (h, Nv, chi), from the base up, are confined along x and out of plane and swell along y to
F = diag(1, l) with the nominal stress 0: Nv (l - 1/l) + ln(1 - 1/l) + 1/l + chi/l^2 = mu. About it
the nominal stress of a gradient H of displacements is

    P = Nv H + p cof H + K (C : H) C,   C = cof F = diag(l, 1),   p = -Nv l,
    K = 1/(l^2 (l - 1)) - 2 chi/l^3 + Nv/l^2 .

With u = (i a, b) exp(ikx) and the tractions (i s, t) of planes of constant y its balance is z' = M
z, z = (a, b, s, t). With (s, t) = S (a, b), S is the stiffness of what lies below; at the surface
it is positive definite up to the onset, where det S = 0. Incremental theory as by Wu, Bouklas &
Huang (2013), Int. J. Solids Struct. 50; SciPy, nothing of jaxgel.
"""

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq, minimize_scalar

SLICES = 80  # of a graded layer: an error of the critical mu of 2e-4, of second order
LEAST, MOST = 1 + 1e-12, 50.0  # of the stretch


def stretch(Nv, chi, mu):
    """Stretch l of a confined layer at ``mu``, kT."""
    return brentq(
        lambda v: Nv * (v - 1 / v) + np.log1p(-1 / v) + 1 / v + chi / v**2 - mu,
        LEAST,
        MOST,
        xtol=1e-14,
    )


def matrix(Nv, chi, mu, k):
    """M (4, 4) at the wave number ``k``, rad/mm."""
    v = stretch(Nv, chi, mu)
    p, K = -Nv * v, 1 / (v**2 * (v - 1)) - 2 * chi / v**3 + Nv / v**2
    a, b, s, t = np.eye(4)
    slope_a, slope_b = (s + p * k * b) / Nv, (t + (p + K * v) * k * a) / (Nv + K)
    return np.stack(
        [
            slope_a,
            slope_b,
            k * ((Nv + K * v**2) * k * a - (p + K * v) * slope_b),
            k * (Nv * k * b - p * slope_a),
        ]
    )


def surface_stiffness(layers, mu, k):
    """Lowest eigenvalue of S at the surface, kT/v per mm.

    Steps of kh <= 1, so that no exponential hides another.
    """
    S = None
    for h, Nv, chi in layers:
        steps = max(1, int(np.ceil(k * h)))
        uu, ut, tu, tt = (
            expm(matrix(Nv, chi, mu, k) * h / steps)
            .reshape(2, 2, 2, 2)
            .swapaxes(1, 2)
            .reshape(4, 2, 2)
        )
        for _ in range(steps):
            S = tt @ np.linalg.inv(ut) if S is None else (tu + tt @ S) @ np.linalg.inv(uu + ut @ S)
    return np.linalg.eigvalsh(S)[0]


def critical_mu(layers, k, mu):
    """The first of the ascending ``mu`` at which the wave costs nothing, between two of them.

    The last one where there is none.
    """
    before = mu[0]
    for now in mu:
        if surface_stiffness(layers, now, k) < 0:
            return brentq(lambda at: surface_stiffness(layers, at, k), before, now, xtol=1e-9)
        before = now
    return mu[-1]


def onset(layers, mu, wave_numbers):
    """(mu, k) of the first neutral wave, k within the ascending ``wave_numbers``."""
    found = [critical_mu(layers, k, mu) for k in wave_numbers]
    at = int(np.argmin(found))
    near = wave_numbers[max(at - 1, 0)], wave_numbers[min(at + 1, len(found) - 1)]
    best = minimize_scalar(
        lambda k: critical_mu(layers, k, mu), bounds=near, method="bounded", options={"xatol": 1e-3}
    )
    return float(best.fun), float(best.x)


def graded(Nv, chi, slices=SLICES):
    """Slices of a layer 1 mm thick with ``Nv`` (y from 0 to 1)."""
    return [(1 / slices, Nv((i + 0.5) / slices), chi) for i in range(slices)]
