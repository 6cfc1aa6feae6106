"""Outlines from DXF drawings, by the library of the extra ``[outline]``. Lengths in mm: files say their unit; 1 is 1 mm if they do not."""

from pathlib import Path as File

import numpy as np

from .drawing import FLATNESS, Drawing


def read_dxf(file: File) -> Drawing:
    """The closed outlines of a DXF file, mm; curves are followed to `FLATNESS` of their size."""
    import ezdxf
    from ezdxf import units
    from ezdxf.path import bbox, make_path

    document = ezdxf.readfile(file)
    scale = units.conversion_factor(document.units, units.MM) if document.units else 1.0
    lines = []
    for entity in document.modelspace():
        try:
            path = make_path(entity)
        except TypeError:
            continue  # a text or a dimension
        if not path.is_closed:
            continue
        size = max(bbox([path]).size)
        lines.append(np.array([(scale * p.x, scale * p.y) for p in path.flattening(FLATNESS * size)]))
    return Drawing(lines)
