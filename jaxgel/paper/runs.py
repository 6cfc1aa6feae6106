"""``jaxgel paper``: table and figures of Deng et al. (2020) recomputed, beside the printed ones.

Each item writes ``ITEM.png``, ``ITEM.csv`` and ``ITEM.json`` into its folder once it is done;
``report.md``, a figure and a small table for each, is made of all that are there. Without names
those that are missing are computed, so an interrupted run goes on; a named item is computed anew.
"""

import contextlib
import functools
import json
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path as File
from typing import Any

from tqdm import tqdm

from .._validation import did_you_mean
from ..io import interruptible, open_folder, write_atomically, write_csv, write_json
from . import areas, curves, patterns, square
from .items import FINITE_ELEMENTS, Entry, Runs, pyplot

REPORT = "report.md"
HEAD = """Y. Deng, X. He, L. Sun, S. Yi, Y. Dai, Engineering Analysis with Boundary Elements 113 \
(2020) 99-109, \
[doi 10.1016/j.enganabound.2019.12.004](https://doi.org/10.1016/j.enganabound.2019.12.004). \
The difference is that of this run to the finite elements or the closed form, where there are any, \
and otherwise to the paper. Chemical potentials mu are in kT. Unless an item says otherwise a run \
has the paper's nodes, the quadratic basis, cells along the true outlines and pressures linear \
over patches of them. Finite elements: {about}"""


def items() -> dict[str, Callable[[Runs], Entry]]:
    """Name of each item -> its function, in the order of the report."""
    return {
        "table-1": curves.table_1,
        "fig-2": square.fig_2,
        "fig-3": square.fig_3,
        "fig-4": square.fig_4,
        **{
            f"fig-{k}": functools.partial(patterns.draw_patterns, number=k)
            for k in patterns.FIGURES
        },
        "fig-12": curves.fig_12,
        "fig-13": curves.fig_13,
        "fig-14": areas.fig_14,
        "algorithm": square.algorithm,
    }


def run_paper(
    names: Sequence[str],
    folder: str | File,
    *,
    quiet: bool = False,
    say: Callable[[str], Any] = print,
    after_item: Callable[[], Any] = lambda: None,
) -> list[str]:
    """Compute the items ``names`` in ``folder``, and its report; the names that failed.

    All that are missing if there are none. ``after_item`` is called after each item: a process of
    its own may forget compiled programs there, which would fill gigabytes. Raises ValueError for an
    unknown item and KeyboardInterrupt once Ctrl-C was pressed; finished items are kept in every
    case.
    """
    known, folder = items(), open_folder(folder)
    for name in names:
        if name not in known:
            raise ValueError(f"item: {name!r} is unknown; {did_you_mean(name, list(known))}")
    wanted = [
        name
        for name in known
        if (name in names if names else "numbers" not in _read_record(folder, name))
    ]
    with (
        tqdm(total=len(wanted), disable=True if quiet else None, leave=False) as bar,
        interruptible() as stop_if_asked,
    ):

        def on_state(text):
            bar.set_postfix_str(text)
            stop_if_asked()

        runs = Runs(on_state)
        for name in wanted:
            bar.set_description_str(name)
            start = time.perf_counter()
            record = _recorded(known[name], runs, folder, name) | {
                "seconds": time.perf_counter() - start
            }
            write_json(folder / f"{name}.json", record)
            report = _report({name: _read_record(folder, name) for name in known}).encode()
            write_atomically(folder / REPORT, lambda stream, report=report: stream.write(report))
            after_item()
            bar.update()
            with contextlib.nullcontext() if quiet else tqdm.external_write_mode():
                say(f"{name}: {record.get('error', 'done')} ({record['seconds']:.0f} s)")
    return [name for name in known if "error" in _read_record(folder, name)]


def _recorded(item, runs, folder, name):
    """What the report says of an item, its figure and rows written.

    An item that fails says why, and is not kept as done.
    """
    try:
        entry = item(runs)
    except Exception as problem:
        place = traceback.extract_tb(problem.__traceback__)[-1]
        (folder / f"{name}.traceback.txt").write_text(
            "".join(traceback.format_exception(problem)), encoding="utf-8"
        )
        return {
            "error": (
                f"{type(problem).__name__}: {' '.join(str(problem).split()) or 'no message'} "
                f"({place.name})"
            )
        }
    write_atomically(
        folder / f"{name}.png", lambda stream: entry.figure.savefig(stream, dpi=200, format="png")
    )
    pyplot().close(entry.figure)
    rows = [[f"{v:.9g}" if isinstance(v, float) else v for v in row.values()] for row in entry.rows]
    write_csv(folder / f"{name}.csv", list(entry.rows[0]), rows)
    numbers = [number.cells() for number in entry.numbers]
    return {
        "title": entry.title,
        "paper": entry.paper,
        "reference": entry.reference,
        "numbers": numbers,
    }


def _read_record(folder, name):
    """Record of an item; empty if there is none that can be read."""
    try:
        return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def _report(records):
    """The report in Markdown of the items' records, by name."""
    lines = [
        "# Deng et al. (2020), computed again",
        "",
        HEAD.format(about=FINITE_ELEMENTS["about"]),
        "",
    ]
    for name, record in records.items():
        command = f"`jaxgel paper {name}`, {record.get('seconds', 0):.0f} s"
        if "error" in record:
            lines += [f"## {name}", "", f"This item failed: {record['error']}. ({command})", ""]
        elif record:
            lines += [
                f"## {record['title']}",
                "",
                f"({command}; [data]({name}.csv))",
                "",
                f"![{record['title']}]({name}.png)",
                "",
            ]
            head = ("quantity", "paper", "this run", record["reference"], "difference")
            lines += [f"**Paper:** {record['paper']}", ""]
            lines += [
                f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *record["numbers"])
            ] + [""]
    return "\n".join(lines)
