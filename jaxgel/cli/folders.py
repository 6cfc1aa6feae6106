"""Commands on a folder of results: plot, resume, outline, export and view."""

import math
from argparse import Namespace
from pathlib import Path as File

from .._validation import one_of, read_toml
from ..cases import (
    OutputOptions,
    from_table,
    load_case,
    load_path,
    other_versions,
    resumed,
    resumed_map,
    resumed_study,
    write_page,
)
from ..geometry import frame_of, reference_plate
from ..io import (
    FORMATS,
    dry_gel,
    dry_regions,
    load_run,
    open_folder,
    swollen_gel,
    write_mask,
    write_outline,
)
from ..io import export as write_netcdf
from ..materials import WithHoles
from ..observables import state_at
from .environment import DONE
from .runs import draw, printer, run_recorded
from .studies import run_design, run_points

RUN, DESIGN, STARTS, MAP = "summary.json", "design.json", "starts.json", "map.json"


def plot(args: Namespace) -> int:
    """``jaxgel plot``: draw the figures of a run's folder again."""
    folder = File(args.folder)
    table = load_run(folder).history
    path, out = load_path(folder), open_folder(args.out) if args.out else folder
    draw(path, out, table, OutputOptions())
    if args.mp4:
        from ..plotting import animate_pattern

        animate_pattern(path, out / "pattern.mp4")
    return DONE


def resume(args: Namespace) -> int:
    """``jaxgel resume``: continue the interrupted run, design or map of a folder."""
    known = (DESIGN, STARTS, MAP, RUN)
    kind = next((name for name in known if (File(args.folder) / name).is_file()), None)
    if kind is None:
        text = (
            f"holds none of {', '.join(known)}; expected a folder written by jaxgel run, design "
            "or map"
        )
        raise ValueError(f"folder: {args.folder!r} {text}")
    if kind in (DESIGN, STARTS):
        return run_design(resumed_study(args.folder), args.folder, args, resume=True)
    if kind == MAP:
        return run_points(resumed_map(args.folder), args.folder, args, resume=True)[0]
    say, warning, recorder = printer(args), other_versions(args.folder), resumed(args.folder)
    say(f"{recorder.case.name}: goes on after {len(recorder.steps)} states")
    if warning:
        say(warning)
    return run_recorded(recorder, args)


def outline(args: Namespace) -> int:
    """``jaxgel outline``: write the outline of a case or a run.

    Dry or, of a run, at the accepted state nearest to ``--mu``, its control. ValueError for a value
    beyond the ends of the run. Beside a dry outline it writes the masks of a printed gel.
    """
    one_of("--format", args.format, FORMATS)
    for name, value in (("--height", args.height), ("--pixels-per-mm", args.pixels_per_mm)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name}: {value:g} is not a finite number above 0")
    if args.mu is not None and not math.isfinite(args.mu):
        raise ValueError(f"--mu/--at: {args.mu:g} is not a finite number")
    case, regions = None, []
    if args.mu is not None:
        if not File(args.source).is_dir():
            raise ValueError(
                f"--mu/--at: {args.source!r} is a case; the states at some mu are in a run's folder"
            )
        path = load_path(args.source)
        name, gel = File(args.source).name, swollen_gel(path, state_at(path, args.mu))
    else:
        summary = load_run(args.source).summary if File(args.source).is_dir() else None
        case = (
            from_table(summary["options"], summary["case"]) if summary else load_case(args.source)
        )
        name, gel, regions = case.name, dry_gel(case.plate), dry_regions(case.plate)
    file = File(args.out or f"{name}.{args.format}")
    if case is not None and File(args.source).is_file():
        _check_inputs_kept(
            File(args.source), [file, *(_beside(file, name) for name in case.pictures())]
        )
    print(write_outline(gel, file, args.height, args.pixels_per_mm, regions))
    for mask in _masks(case, file, args.pixels_per_mm) if case else ():
        print(mask)
    return DONE


def _check_inputs_kept(source, written):
    """Refuse an outline or mask in the place of a file that the case ``source`` reads."""
    read = {(source.parent / name).resolve() for name in _files_in(read_toml(source, "case"))}
    replaced = next((file for file in written if file.resolve() in read), None)
    if replaced is not None:
        raise ValueError(
            f"--out: {str(replaced)!r} is a file that the case reads; give another name"
        )


def _files_in(entry):
    """The names of files in a table, also in its lists and tables."""
    if isinstance(entry, dict) and isinstance(entry.get("file"), str):
        return [entry["file"]]
    parts = entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ()
    return [name for part in parts for name in _files_in(part)]


def _beside(file, name):
    """The mask of the gel's parameter ``name`` beside an outline."""
    return file.with_name(f"{file.stem}-{name}.png")


def _masks(case, file, pixels_per_mm):
    """Write the pictures of a case's gel beside ``file``; their paths."""
    plate, pictures = case.plate, case.pictures()
    follows = plate.reference is not None and any(
        isinstance(field, WithHoles) for field, *_ in pictures.values()
    )
    cloud = case.cloud().at(plate) if follows else None
    for name, (field, low, high) in pictures.items():
        frame = frame_of(reference_plate(plate))  # that of the drawing
        options = {
            "low": low,
            "high": high,
            "pixels_per_mm": pixels_per_mm,
            "cloud": cloud,
            "frame": frame,
        }
        yield write_mask(field, (plate.width, plate.height), _beside(file, name), **options)


def export(args: Namespace) -> int:
    """``jaxgel export``: write a run's folder as netCDF."""
    print(write_netcdf(args.folder, args.out))
    return DONE


def view(args: Namespace) -> int:
    """``jaxgel view``: write one HTML page of a run's folder."""
    print(write_page(args.folder, args.out))
    return DONE
