"""``jaxgel paper``: the table and figures of Deng et al. (2020) computed again, side by side with what they print.

Each item writes ``ITEM.png``, ``ITEM.csv`` and ``ITEM.json`` into its folder once it is done; ``report.md`` is made of all that are
there. Without names those that are missing are computed, so an interrupted run goes on; a named item is computed anew.
"""

import contextlib
import csv
import io
import json
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path as File
from typing import Any

from tqdm import tqdm

from .._validation import did_you_mean
from ..io import interruptible, open_folder, write_atomically
from . import areas, counts, curves, incremental, patterns, square
from .items import Entry, Runs, pyplot
from .report import read_record, write_report


def items() -> dict[str, Callable[[Runs], Entry]]:
    """Name of each item -> its function, in the order of the report."""
    return {
        "table-1": counts.table_1,
        "fig-2": square.fig_2,
        "fig-3": square.fig_3,
        "fig-4": square.fig_4,
        **{f"fig-{k}": patterns.PATTERNS[k] for k in range(6, 12)},
        "fig-12": curves.fig_12,
        "fig-13": curves.fig_13,
        "fig-14": areas.fig_14,
        "algorithm": incremental.algorithm,
    }


def run_paper(
    names: Sequence[str],
    folder: str | File,
    *,
    quiet: bool = False,
    say: Callable[[str], Any] = print,
    after_item: Callable[[], Any] = lambda: None,
) -> list[str]:
    """Compute the items ``names`` (all that are missing if there are none) in ``folder``, and its report; the names that failed.

    ``after_item`` is called after each item: a process of its own may forget compiled programs there, which would fill gigabytes.
    Raises ValueError for an unknown item and KeyboardInterrupt once Ctrl-C was pressed; finished items are kept in every case.
    """
    known, folder = items(), open_folder(folder)
    for name in names:
        if name not in known:
            raise ValueError(f"item: {name!r} is unknown; {did_you_mean(name, list(known))}")
    wanted = [name for name in known if (name in names if names else not _is_done(folder, name))]
    with tqdm(total=len(wanted), disable=True if quiet else None, leave=False) as bar, interruptible() as stop_if_asked:

        def on_state(text):
            bar.set_postfix_str(text)
            stop_if_asked()

        runs = Runs(on_state)
        for name in wanted:
            bar.set_description_str(name)
            start, cpu = time.perf_counter(), time.process_time()
            record = _recorded(known[name], runs, folder, name)
            record |= {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu}
            _write_json(folder / f"{name}.json", record)
            write_report(folder, known)
            after_item()
            bar.update()
            with contextlib.nullcontext() if quiet else tqdm.external_write_mode():
                say(f"{name}: {record['verdict']} ({record['seconds']:.0f} s)")
    return [name for name in known if read_record(folder, name).get("error")]


def _recorded(item, runs, folder, name):
    """What the report says of an item, its figure and rows written; an item that fails says why, and is not kept as done."""
    try:
        entry = item(runs)
    except Exception as problem:
        place = traceback.extract_tb(problem.__traceback__)[-1]
        (folder / f"{name}.traceback.txt").write_text("".join(traceback.format_exception(problem)), encoding="utf-8")
        text = " ".join(str(problem).split()) or "no message"
        return {"verdict": f"failed: {text}", "error": f"{type(problem).__name__}: {text} ({place.name})"}
    if entry.figure is not None:
        write_atomically(folder / f"{name}.png", lambda stream: entry.figure.savefig(stream, dpi=200, format="png"))
        pyplot().close(entry.figure)
    write_atomically(folder / f"{name}.csv", lambda stream: stream.write(_table(entry.rows).encode()))
    fields = ("title", "paper", "verdict", "reference")
    claims, numbers = [[c.statement, c.verdict, c.reason] for c in entry.claims], [number.cells() for number in entry.numbers]
    return {field: getattr(entry, field) for field in fields} | {"numbers": numbers, "claims": claims, "figure": entry.figure is not None}


def _table(rows):
    """CSV text of dictionaries with the same keys; numbers with nine digits."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows([{key: f"{v:.9g}" if isinstance(v, float) else v for key, v in row.items()} for row in rows])
    return text.getvalue()


def _write_json(file, record):
    text = json.dumps(record, indent=1, ensure_ascii=False, default=float)
    write_atomically(file, lambda stream: stream.write(text.encode()))


def _is_done(folder, name):
    record = read_record(folder, name)
    return "numbers" in record and not record.get("error")
