"""The map of optima: the rotation study from 256 starts, on a coarse cloud.

Problem: that of rotation.py, four ellipses in a 22 mm plate that turn the midline as far as they
can at mu = -0.9178 kT, with three values of mu, closer bounds, and no constraint on gaps. Start 1
is sample 1 of Deng, He, Sun, Yi & Dai (2020),
https://doi.org/10.1016/j.enganabound.2019.12.004
"""

from pathlib import Path

from jaxgel.cases import load_study

study = load_study(Path(__file__).with_suffix(".toml"))
