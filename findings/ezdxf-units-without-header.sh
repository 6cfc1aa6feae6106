#!/usr/bin/env bash
# ezdxf 1.4.5: a DXF file that names no unit is reported to be in metres.
#
# DXF R12 files may consist of an ENTITIES section alone, and $INSUNITS is optional elsewhere; without it a drawing has no unit (code 0).
# `ezdxf.readfile(...).units` answers 6 (metres), the default of files that ezdxf makes itself, so that a conversion to mm enlarges the
# drawing a thousand times. Whether the file names a unit has to be read from its text.
# Seen: "6 False" for the file without a header, "4 True" for the one in mm.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "ezdxf==1.4.5"
"$work/venv/bin/python" - "$work" <<'PY'
import pathlib
import sys

import ezdxf

folder = pathlib.Path(sys.argv[1])
circle = ["0", "SECTION", "2", "ENTITIES", "0", "CIRCLE", "8", "0", "10", "0", "20", "0", "30", "0", "40", "5", "0", "ENDSEC", "0", "EOF"]
header = ["0", "SECTION", "2", "HEADER", "9", "$ACADVER", "1", "AC1009", "9", "$INSUNITS", "70", "4", "0", "ENDSEC"]
seen = []
for name, lines in (("plain", circle), ("mm", header + circle)):
    file = folder / f"{name}.dxf"
    file.write_text("\n".join(lines) + "\n")
    document = ezdxf.readfile(file)
    seen.append((document.units, "$INSUNITS" in file.read_text()))
    print(*seen[-1])
assert seen == [(6, False), (4, True)], f"the behaviour has changed: {seen}"
PY
