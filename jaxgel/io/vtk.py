"""ParaView files of a path: the deformed gel of every state with fields, on triangles.

These are those of the integration cells.
"""

from pathlib import Path as File
from typing import Any

import numpy as np
import scipy.sparse
from pyevtk.hl import pointsToVTK, unstructuredGridToVTK
from pyevtk.vtk import VtkGroup, VtkPolygon, VtkPolyLine, VtkTriangle

from .._types import Float, Int
from ..continuation import Path
from ..discretisation import make_probe
from ..observables import (
    SELF_CONTACT,
    cauchy_stress,
    contact_pressure,
    field_values,
    history,
    is_in_time,
    obstacle_displacement,
    parameter_values,
    solvent_flux,
    solvent_potential,
    thickness_stretch,
)
from .files import open_folder


def write_series(path: Path, folder: str | File, *, table: dict[str, Any] | None = None) -> None:
    """``series.pvd`` and ``vtu/state-*.vtu`` for ParaView, with the control as time.

    The deformed gel of every state. The times of transient swelling are its own. Others must
    increase: if the control falls or turns it is the number of the state. The value is also a
    constant field on the cells.

    Points carry the displacement (mm), the components ``cauchy_stress_xx``, ``_yy``, ``_xy`` (kT/v;
    the nodes' own, interpolated), and ``principal_stretch_1`` >= ``principal_stretch_2``, against
    the dry gel. Cells (triangles) carry the volume ratio J and ``invalid`` = 1 after self-contact;
    parameters of the gel that vary, by their names; and the ``thickness_stretch`` of a film and in
    generalised plane strain. In transient swelling they also carry ``mu``, the chemical potential
    of the solvent (kT), and its ``flux`` through the deformed area (mm per unit of time), see
    `observables.solvent_flux`. Plates with obstacles have ``obstacles.pvd``, one cell each, and
    ``contact.pvd``, the points of the surfaces with the ``contact_pressure`` (kT/v). ``table``
    saves computing `history` again.
    """
    cloud = path.model.cloud
    used, triangles = np.unique(np.asarray(cloud.triangles), return_inverse=True)
    fields, J = point_fields(path, used), np.asarray(field_values(path, "J"))
    cells = np.asarray(cloud.cell_of_triangle)
    dry_fields = {
        name: np.ascontiguousarray(np.asarray(values)[cells])
        for name, values in parameter_values(path).items()
    }
    solvent = _solvent_fields(path, cells) if is_in_time(path) else {}
    thickness = (
        None
        if cloud.plate.kinematics == "plane strain"
        else np.asarray(thickness_stretch(path))[:, cells]
    )
    dry, deformed = np.asarray(cloud.vertices)[used], fields.pop("position")
    invalid = [
        text == SELF_CONTACT for text in (history(path) if table is None else table)["status"]
    ]
    folder = open_folder(folder)
    (folder / "vtu").mkdir(exist_ok=True)
    connectivity = triangles.astype(np.int32).ravel()
    offsets = np.arange(3, len(connectivity) + 1, 3, dtype=np.int32)
    kinds = np.full(len(offsets), VtkTriangle.tid, dtype=np.uint8)
    zero = np.zeros(len(used))
    group = VtkGroup(str(folder / "series"))
    values, name = np.asarray(path.value, dtype=float), path.control.name
    times = values if np.all(np.diff(values) > 0) else np.arange(len(values), dtype=float)
    for k, time in enumerate(times):
        file = unstructuredGridToVTK(
            str(folder / "vtu" / f"state-{k:04d}"),
            *(np.ascontiguousarray(deformed[k].T)),
            zero,
            connectivity=connectivity,
            offsets=offsets,
            cell_types=kinds,
            pointData={"displacement": (*np.ascontiguousarray((deformed[k] - dry).T), zero)}
            | {n: v[k].copy() for n, v in fields.items()},
            cellData={
                "J": np.ascontiguousarray(J[k]),
                "invalid": np.full(len(offsets), invalid[k], dtype=np.int32),
            }
            | {name: np.full(len(offsets), values[k])}
            | dry_fields
            | {name: _components(part[k]) for name, part in solvent.items()}
            | (
                {}
                if thickness is None
                else {"thickness_stretch": np.ascontiguousarray(thickness[k])}
            ),
        )
        group.addFile(file, sim_time=float(time))
    group.save()
    if cloud.plate.obstacles:
        _write_contact(path, folder, times)
        _write_obstacles(
            path,
            folder,
            times,
            3 * max(np.abs(deformed).max(), cloud.plate.width, cloud.plate.height),
        )


def _write_obstacles(path: Path, folder: File, times: Float[np.ndarray, " k"], size: float) -> None:
    """The obstacles of every state; half-planes up to a ``size``, mm."""
    shapes = [obstacle.drawn(size) for obstacle in path.model.cloud.plate.obstacles]
    counts = [len(points) for points, _ in shapes]
    group, at_rest = (
        VtkGroup(str(folder / "obstacles")),
        np.concatenate([points for points, _ in shapes]),
    )
    for k, (time, moved) in enumerate(zip(times, obstacle_displacement(path), strict=True)):
        file = unstructuredGridToVTK(
            str(folder / "vtu" / f"obstacles-{k:04d}"),
            *np.ascontiguousarray((at_rest + np.repeat(moved, counts, axis=0)).T),
            np.zeros(len(at_rest)),
            connectivity=np.arange(len(at_rest), dtype=np.int32),
            offsets=np.cumsum(counts).astype(np.int32),
            cell_types=np.array(
                [VtkPolygon.tid if encloses else VtkPolyLine.tid for _, encloses in shapes],
                dtype=np.uint8,
            ),
            cellData={"obstacle": np.arange(len(shapes), dtype=np.int32)},
        )
        group.addFile(file, sim_time=float(time))
    group.save()


def _write_contact(path: Path, folder: File, times: Float[np.ndarray, " k"]) -> None:
    """The points of the surfaces in every state, with the pressure of contact."""
    group = VtkGroup(str(folder / "contact"))
    for k, time in enumerate(times):
        points, pressure = map(np.asarray, contact_pressure(path, k))
        x, y = np.ascontiguousarray(points.T)
        group.addFile(
            pointsToVTK(
                str(folder / "vtu" / f"contact-{k:04d}"),
                x,
                y,
                0 * x,
                {"contact_pressure": pressure},
            ),
            sim_time=float(time),
        )
    group.save()


def _solvent_fields(path: Path, cells: Int[np.ndarray, " t"]) -> dict[str, np.ndarray]:
    """Name -> values (k, t), or (k, t, 2), on the triangles of the ``cells``."""
    fields = {"mu": np.asarray(solvent_potential(path))[:, cells]}
    if path.control.wetted:
        fields["flux"] = np.asarray(solvent_flux(path, deformed=True))[:, cells]
    return fields


def _components(values: Float[np.ndarray, "t ..."]) -> Any:
    """A field (t,), or the three components of one of vectors (t, 2), as VTK has them."""
    if values.ndim == 1:
        return np.ascontiguousarray(values)
    return (*np.ascontiguousarray(values.T), np.zeros(len(values)))


def point_fields(path: Path, used: Int[np.ndarray, " u"]) -> dict[str, np.ndarray]:
    """Name -> values (k, u) or ``position`` (k, u, 2) at the vertices ``used`` (u,).

    They are those of a path's cloud.
    """
    cloud = path.model.cloud
    probe = make_probe(
        path.model, np.asarray(cloud.vertices)[used], cloud.topology.partition.vertices[used]
    )
    x = np.asarray(path.x)
    position, *gradient = (
        _at_points(probe.nodes, weights, x)
        for weights in (probe.phi, *np.moveaxis(np.asarray(probe.dphi), 2, 0))
    )
    stress = _at_points(probe.nodes, probe.phi, np.asarray(cauchy_stress(path)))
    F = np.stack(gradient, axis=3)
    stretches = np.linalg.svd(F, compute_uv=False)
    fields = {"position": position} | {
        f"cauchy_stress_{name}": stress[..., i] for i, name in enumerate(("xx", "yy", "xy"))
    }
    return fields | {f"principal_stretch_{i + 1}": stretches[..., i] for i in range(2)}


def _at_points(nodes, weights, values):
    """Sums (k, p, d) of nodal ``values`` (k, n, d) with ``weights`` (p, a) of the ``nodes``."""
    count, width = np.shape(nodes)
    k, n, d = values.shape
    sums = scipy.sparse.csr_array(
        (np.ravel(weights), np.ravel(nodes), width * np.arange(count + 1)), shape=(count, n)
    ) @ np.moveaxis(values, 0, 1).reshape(n, k * d)
    return np.moveaxis(sums.reshape(count, k, d), 1, 0)
