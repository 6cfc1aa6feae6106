"""What the range and the stiffness of self-contact do to a result: sample 7 of Deng et al. (2020) past its first contact.

    python benchmarks/contact.py [--spacing 0.55]

The two are numerical, so a result should not depend on them: each line has another share of the defaults (range half the node spacing,
kappa 10 Nv) and prints, at the last mu, angles in degrees, the energy in kT/v mm^2, contact's share of it, the area reduction, and the
smallest gap within a hole over the range. The holes' area follows from the swelling and does not depend on contact.
"""  # fmt: skip

import argparse

import jax
import numpy as np

import jaxgel
from jaxgel.mechanics import RANGE, STIFFNESS, contact_energy, with_contact

MU = (-4.9678, -3.5, -2.5, -1.6, -1.1, -0.8, -0.65, -0.55, -0.5, -0.45, -0.42, -0.4)  # kT; the sides meet at -0.53
CASES = ((1.0, 1.0), (1.0, 3.0), (1.0, 1 / 3), (0.5, 1.0), (0.25, 1.0))  # shares of the default range and stiffness


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spacing", type=float, help="distance of the nodes in mm (the sample's own)")
    spacing = parser.parse_args().spacing
    plate = jaxgel.sample("sample-7")
    cloud = jaxgel.make_cloud(plate) if spacing is None else jaxgel.make_cloud(plate, spacing=spacing)
    print(f"{'range/h':>8}{'kappa/Nv':>9}{'midline':>9}{'core':>8}{'energy':>11}{'share':>9}{'area red.':>10}{'gap/range':>10}")
    for range_share, stiffness_share in CASES:
        reach, kappa = range_share * RANGE, stiffness_share * STIFFNESS
        model = with_contact(jaxgel.discretise(cloud), plate.gel, range=reach * cloud.spacing, stiffness=kappa * plate.gel.Nv)
        path = jaxgel.sweep(jaxgel.Problem(model, plate.gel), MU)
        if not path.stop.ok:
            print(f"{reach:8.3f}{kappa:9.2f}  {path.stop_text}", flush=True)
            continue
        values = np.array([f(path)[-1] for f in (jaxgel.rotation_angle, jaxgel.core_rotation, jaxgel.area_reduction, jaxgel.min_gap)])
        share = float(jax.jit(contact_energy)(path.x[-1], model)) / abs(float(path.energy[-1]))
        angles = f"{reach:8.3f}{kappa:9.2f}{values[0]:9.3f}{values[1]:8.3f}{path.energy[-1]:11.4f}{share:9.1e}"
        print(f"{angles}{values[2]:10.5f}{values[3] / (reach * cloud.spacing):10.3f}", flush=True)


if __name__ == "__main__":
    main()
