#!/usr/bin/env bash
# ezdxf 1.4.5: a closed periodic SPLINE is no closed path, and its ends do not meet.
#
# CAD programs write closed smooth curves as periodic B-splines: degree p, unclamped uniform knots, the first p control points repeated at
# the end. Such a curve is defined between the knots t_p and t_n. `ezdxf.math.BSpline` evaluates it from the first to the last knot instead,
# beyond that range, so that `ezdxf.path.make_path(spline)` starts and ends elsewhere, far apart for its size, and `is_closed` is False:
# a reader that asks for closed paths loses the outline. scipy.interpolate.BSpline on [t_p, t_n] closes it to round-off.
# Seen for a cubic spline with eight control points on a circle of radius 1: "is_closed False, gap of the path 3.354, gap of scipy 1.6e-16".
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "ezdxf==1.4.5" "numpy==2.2.6" "scipy==1.15.3"
"$work/venv/bin/python" - <<'PY'
import ezdxf
import numpy as np
from ezdxf.path import make_path
from scipy.interpolate import BSpline

degree, count = 3, 8
angle = 2 * np.pi * np.arange(count + degree) / count
ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
knots = np.arange(len(ring) + degree + 1, dtype=float)
spline = ezdxf.new().modelspace().add_spline()
spline.dxf.degree, spline.dxf.flags = degree, 1 | 2 | 8  # closed, periodic, planar
spline.control_points, spline.knots = ring, knots
path = make_path(spline)
gap = path.start.distance(path.end)
curve = BSpline(knots, ring, degree)
exact = np.linalg.norm(curve(knots[degree]) - curve(knots[len(ring)]))
print(f"is_closed {path.is_closed}, gap of the path {gap:.3f}, gap of scipy {exact:.1e}")
assert not path.is_closed and gap > 0.5 and exact < 1e-12, "the behaviour has changed"
PY
