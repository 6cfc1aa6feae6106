"""The report of ``jaxgel paper`` in Markdown: claims, then a figure, a small table and a verdict for each item."""

import json
from collections.abc import Iterable
from pathlib import Path as File
from typing import Any

from ..io import write_atomically
from .items import CONDITION, CONFIRMED, CONTRADICTED, FINITE_ELEMENTS

REPORT = "report.md"
HEAD = """Y. Deng, X. He, L. Sun, S. Yi, Y. Dai, Engineering Analysis with Boundary Elements 113 (2020) 99-109, \
[doi 10.1016/j.enganabound.2019.12.004](https://doi.org/10.1016/j.enganabound.2019.12.004). Verdicts follow from the numbers of this run. \
The difference is that of this run to the finite elements or the closed form, where there are any, and otherwise to the paper. Chemical \
potentials mu are in kT. Unless an item says otherwise a run has the paper's nodes, the quadratic basis, cells along the true outlines and \
pressures linear over patches of them. Finite elements: {about}"""


def write_report(folder: File, known: Iterable[str]) -> None:
    """Write ``REPORT`` of those of the ``known`` items whose records lie in a folder."""
    records = {name: read_record(folder, name) for name in known}
    text = _report({name: record for name, record in records.items() if "numbers" in record or "error" in record})
    write_atomically(folder / REPORT, lambda stream: stream.write(text.encode()))


def read_record(folder: File, name: str) -> dict[str, Any]:
    """Record of an item; empty where there is none that can be read."""
    try:
        return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def _report(records: dict[str, dict[str, Any]]) -> str:
    """The report of the items' records, by name."""
    lines = ["# Deng et al. (2020), computed again", "", HEAD.format(about=FINITE_ELEMENTS["about"]), "", "## The claims", ""]
    claims = [(*claim, name) for name, record in records.items() for claim in record.get("claims", ())]
    lines += _table(("claim", "verdict", "why", "item"), [(text, f"**{verdict}**", reason, name) for text, verdict, reason, name in claims])
    counts = ", ".join(f"{sum(c[1] == v for c in claims)} {v}" for v in (CONFIRMED, CONDITION, CONTRADICTED))
    lines += ["", f"{counts}.", ""]
    for name, record in records.items():
        lines += _item(name, record)
    seconds, cpu = (sum(record.get(key, 0.0) for record in records.values()) for key in ("seconds", "cpu_seconds"))
    return "\n".join([*lines, f"All items together: {seconds / 60:.1f} min, {cpu / 60:.1f} min on the CPU.", ""])


def _item(name: str, record: dict[str, Any]) -> list[str]:
    command = f"`jaxgel paper {name}`, {record.get('seconds', 0):.0f} s, {record.get('cpu_seconds', 0):.0f} s on the CPU"
    if record.get("error"):
        return [f"## {name}", "", f"This item failed: {record['error']}. ({command})", ""]
    lines = [f"## {record['title']}", "", f"({command}; [data]({name}.csv))", ""]
    if record["figure"]:
        lines += [f"![{record['title']}]({name}.png)", ""]
    lines += [f"**Paper:** {record['paper']} **Verdict:** {record['verdict']}", ""]
    return [*lines, *_table(("quantity", "paper", "this run", record["reference"], "difference"), record["numbers"]), ""]


def _table(head: tuple[str, ...], rows: list) -> list[str]:
    """A Markdown table."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
