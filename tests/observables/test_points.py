"""Displacements of material points and the deformed mesh."""

import numpy as np
import pytest

import jaxgel
from jaxgel.observables import deformed_mesh


def test_nodes_have_their_own_displacements(path):
    """Shape functions interpolate: at the nodes they are Kronecker deltas."""
    nodes = np.asarray(path.model.nodes)
    np.testing.assert_allclose(
        jaxgel.displacement_at(path, nodes), np.asarray(path.x) - nodes, rtol=0, atol=1e-11
    )


def test_the_mesh_has_the_area_of_the_swollen_gel(path):
    """Triangles are anticlockwise.

    Their sides are chords of the deformed sides of cells, which are curved: 1e-3 of the area.
    """
    points, triangles = deformed_mesh(path, 1)
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    areas = (
        np.cross(np.column_stack([b - a, 0 * a[:, 0]]), np.column_stack([c - a, 0 * a[:, 0]]))[:, 2]
        / 2
    )
    assert (areas > 0).all()
    volumes = np.asarray(jaxgel.volume_ratio(path)[1]) @ np.asarray(
        jaxgel.observables.cell_volumes(path.model)
    )
    assert areas.sum() == pytest.approx(volumes, rel=1e-3)


def test_points_beside_the_gel_are_refused(path, refused):
    centre = np.asarray(path.model.cloud.plate.holes[0].centre)
    rows = [
        ([centre], rf"points: \({centre[0]:.4g}, {centre[1]:.4g}\) is not in the dry gel"),
        ([[1e3, 0.0]], r"points: \(1000, 0\) is not in the dry gel"),
        ([0.0, 0.0], r"points: an array of shape \(2,\), it must be \(p, 2\) finite numbers"),
    ]
    refused(lambda points: jaxgel.displacement_at(path, points), rows, whole=True)
