"""Commands on a folder of results: plot, resume, outline, export and view."""

from argparse import Namespace
from pathlib import Path as File

from .._validation import one_of
from ..cases import OutputOptions, from_table, load_case, load_path, other_versions, resumed, resumed_map, resumed_study, write_page
from ..geometry import frame_of, reference_plate
from ..io import FORMATS, dry_gel, dry_regions, load_run, open_folder, swollen_gel, write_mask, write_outline
from ..io import export as write_netcdf
from ..materials import WithHoles
from ..observables import state_at
from .environment import DONE
from .inputs import DESIGN, MAP, STARTS, kind_of_folder
from .runs import draw, printer, run_recorded
from .studies import run_design, run_points


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
    """``jaxgel resume``: continue what was interrupted in a folder, a run, a design or a map by the file that it holds."""
    kind = kind_of_folder(args.folder)
    if kind in (DESIGN, STARTS):
        return run_design(resumed_study(args.folder), args.folder, args, resume=True)
    return run_points(resumed_map(args.folder), args.folder, args, resume=True) if kind == MAP else _resume_run(args)


def _resume_run(args):
    say, warning, recorder = printer(args), other_versions(args.folder), resumed(args.folder)
    say(f"{recorder.case.name}: goes on after {len(recorder.steps)} states")
    if warning:
        say(warning)
    return run_recorded(recorder, args)


def outline(args: Namespace) -> int:
    """``jaxgel outline``: write the outline of a case or a run, dry or, of a run, at the accepted state nearest to ``--mu``, its control.

    ValueError for a value beyond the ends of the run. Beside a dry outline it writes the masks of a printed gel.
    """
    one_of("--format", args.format, FORMATS)
    case, regions = None, []
    if args.mu is not None:
        path = load_path(args.source)
        name, gel = File(args.source).name, swollen_gel(path, state_at(path, args.mu))
    else:
        summary = load_run(args.source).summary if File(args.source).is_dir() else None
        case = from_table(summary["options"], summary["case"]) if summary else load_case(args.source)
        name, gel, regions = case.name, dry_gel(case.plate), dry_regions(case.plate)
    file = write_outline(gel, args.out or f"{name}.{args.format}", args.height, args.pixels_per_mm, regions)
    print(file)
    for mask in _masks(case, file, args.pixels_per_mm) if case else ():
        print(mask)
    return DONE


def _masks(case, file, pixels_per_mm):
    """Write the pictures of a case's gel beside ``file``; their paths."""
    plate, pictures = case.plate, case.pictures()
    follows = plate.reference is not None and any(isinstance(field, WithHoles) for field, *_ in pictures.values())
    cloud = case.cloud().at(plate) if follows else None
    for name, (field, low, high) in pictures.items():
        frame = frame_of(reference_plate(plate))  # that of the drawing
        size, beside = (plate.width, plate.height), file.with_name(f"{file.stem}-{name}.png")
        yield write_mask(field, size, beside, low=low, high=high, pixels_per_mm=pixels_per_mm, cloud=cloud, frame=frame)


def export(args: Namespace) -> int:
    """``jaxgel export``: write a run's folder as netCDF."""
    print(write_netcdf(args.folder, args.out))
    return DONE


def view(args: Namespace) -> int:
    """``jaxgel view``: write one HTML page of a run's folder."""
    print(write_page(args.folder, args.out))
    return DONE
