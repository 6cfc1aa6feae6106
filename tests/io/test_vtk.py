"""ParaView files hold every state with the fields that they name."""

from xml.etree import ElementTree

import numpy as np
import pytest

import jaxgel
from jaxgel.io import write_series
from jaxgel.observables import cauchy_stress, solvent_flux, solvent_potential


@pytest.mark.thorough
def test_paraview_files_hold_every_state_in_the_order_of_mu(path, tmp_path):
    write_series(path, tmp_path)
    sets = ElementTree.parse(tmp_path / "series.pvd").getroot().findall("Collection/DataSet")
    np.testing.assert_allclose([float(s.get("timestep")) for s in sets], path.mu)
    for entry in sets:
        content = (tmp_path / entry.get("file")).read_bytes()
        start = content.index(b"<VTKFile")
        header = ElementTree.fromstring(
            content[start : content.index(b"<AppendedData")] + b"</VTKFile>"
        )
        piece = header.find("UnstructuredGrid/Piece")
        assert int(piece.get("NumberOfCells")) == len(path.model.cloud.triangles)
        names = {array.get("Name") for array in piece.iter("DataArray")}
        assert {"displacement", "J", "invalid"} <= names


@pytest.mark.slow
def test_pyvista_reads_the_series_with_the_closed_form_of_uniaxial_swelling(square_model, tmp_path):
    """Stretch l2 upwards and 1 sideways, stress Nv (1/l2 - l2) sideways, J = l2, everywhere."""
    pyvista = pytest.importorskip("pyvista")
    gel, mu = square_model.cloud.plate.gel, [-2.0, -1.0]
    path = jaxgel.sweep(jaxgel.Problem(square_model, gel), mu)
    write_series(path, tmp_path)
    reader = pyvista.get_reader(tmp_path / "series.pvd")
    assert reader.time_values == mu
    for k, stretch in enumerate(np.asarray(jaxgel.uniaxial_swelling(np.array(mu), gel))):
        reader.set_active_time_point(k)
        (mesh,) = reader.read()
        closed = {
            "principal_stretch_1": stretch,
            "principal_stretch_2": 1.0,
            "cauchy_stress_xx": gel.Nv * (1 / stretch - stretch),
            "cauchy_stress_yy": 0.0,
            "cauchy_stress_xy": 0.0,
        }
        for name, value in closed.items():
            np.testing.assert_allclose(mesh.point_data[name], value, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(mesh.cell_data["J"], stretch, rtol=1e-9)
        assert mesh.area == pytest.approx(stretch, rel=1e-9)
        np.testing.assert_allclose(
            mesh.points[:, :2] - mesh.point_data["displacement"][:, :2],
            mesh.points[:, :2] / [1, stretch],
            atol=0.51,
        )


@pytest.mark.slow
def test_the_series_of_a_path_in_time_has_its_times_and_the_solvent(in_time, tmp_path):
    """Fields are those of the observables, and the flux of the start is 0."""
    write_series(in_time[[0, 5, 9]], tmp_path)
    sets = ElementTree.parse(tmp_path / "series.pvd").getroot().findall("Collection/DataSet")
    np.testing.assert_allclose(
        [float(s.get("timestep")) for s in sets], in_time.t[[0, 5, 9]], rtol=1e-12
    )
    pyvista, cells = (
        pytest.importorskip("pyvista"),
        np.asarray(in_time.model.cloud.cell_of_triangle),
    )
    for state, number in enumerate((0, 5, 9)):
        fields = pyvista.read(tmp_path / "vtu" / f"state-{state:04d}.vtu").cell_data
        one = in_time[[number]]
        np.testing.assert_allclose(fields["mu"], solvent_potential(one)[0, cells], rtol=1e-12)
        np.testing.assert_allclose(
            fields["flux"][:, :2], solvent_flux(one, deformed=True)[0, cells], atol=1e-12
        )
        np.testing.assert_allclose(fields["t"], in_time.t[number])
        assert (np.abs(fields["flux"]).max() < 1e-9) == (number == 0) and not fields["flux"][
            :, 2
        ].any()


def test_stress_at_the_vertices_is_that_of_the_nodes_there(path):
    from jaxgel.io import point_fields

    topology = path.model.lists.topology
    fields = point_fields(path, topology.node_vertices)
    stress = np.stack([fields[f"cauchy_stress_{name}"] for name in ("xx", "yy", "xy")], axis=-1)
    np.testing.assert_allclose(stress, cauchy_stress(path), atol=1e-12)
    np.testing.assert_allclose(fields["position"], path.x, atol=1e-12)
