"""The commands and options of the command line, as argparse reads them and prints their help."""

import argparse
import functools
from importlib.metadata import version

from .._validation import did_you_mean, is_number
from .case_commands import case_commands, error_bar_commands
from .options import (
    cache_option,
    device_option,
    quiet_option,
    real,
    whole_number,
    worker_options,
)

COUNTS = {
    "divisions": 64,
    "most": 100,
    "port": 65535,
    "samples": 100_000,
    "states": 1000,
    "workers": 1024,
}
"""Options that are no entries of a case -> most that is accepted."""
OPTIONS = {
    "sweep": (
        *("control", "mu_start", "mu_end", "from", "to", "back", "values", "at_mu", "direction"),
        *("steps", "branch", "imperfection", "contact", "eigenvalues"),
    ),
    "discretisation": ("spacing", "nodes_per_hole", "across", "basis", "dmax"),
}  # sections of a case file and their entries that are options of commands


def parse(argv: list[str]) -> argparse.Namespace:
    """The arguments, with a suggestion for an option or command that is not known.

    ValueError for what cannot be used.
    """
    whole, known = parser()
    if argv and not argv[0].startswith("-") and argv[0] not in known:
        raise ValueError(f"command: {argv[0]!r} is unknown; {did_you_mean(argv[0], known)}")
    args, unknown = whole.parse_known_args(_joined(argv))
    if unknown:
        options = sorted(known[argv[0]]._option_string_actions)  # noqa: SLF001
        raise ValueError(
            f"{unknown[0]!r} is not an option of {argv[0]}; "
            f"{did_you_mean(unknown[0].split('=')[0], options)}"
        )
    for name, most in COUNTS.items():
        value = getattr(args, name, None)
        if value is not None and not 1 <= value <= most:
            raise ValueError(
                f"{name}: {value} is not accepted, it must be at least 1 and at most {most}"
            )
    return args


def changes(args: argparse.Namespace) -> dict:
    """Sections and entries of a case that the options replace."""
    given = vars(args)
    changed = {
        section: {key: given[key] for key in keys if given.get(key) is not None}
        for section, keys in OPTIONS.items()
    }
    return changed | (
        {"output": {"figures": False, "animation": False}} if given.get("no_plots") else {}
    )


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        """One line instead of the usage."""
        raise ValueError(f"{message}; see {self.prog} --help")


@functools.cache
def parser() -> tuple[argparse.ArgumentParser, dict]:
    """The parser of the command line, and those of its commands by name."""
    whole = _Parser(
        prog="jaxgel",
        description="Swelling-induced pattern transformation of perforated hydrogels.",
        allow_abbrev=False,
    )
    whole.add_argument("--version", action="version", version=f"jaxgel {version('jaxgel')}")
    commands = whole.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(command, name, text):
        p = commands.add_parser(name, help=text, allow_abbrev=False)
        p.set_defaults(command=command)
        return p

    case_commands(add)
    error_bar_commands(add)
    _study_commands(add)
    _folder_commands(add)
    p = cache_option(
        add(
            "doctor.doctor",
            "doctor",
            "show versions, float64, threads and kept programs, and check two computations",
        )
    )
    p.add_argument(
        "--warm",
        action="store_true",
        help="compile what the built-in cases need, for a sweep and its gradient, and keep it",
    )
    p = add("starting.init", "init", "write a commented case file to start from")
    p.add_argument(
        "name",
        metavar="NAME",
        nargs="?",
        help="the file's name, without .toml (default: case, or the built-in name)",
    )
    p.add_argument(
        "--from",
        dest="sample",
        metavar="SAMPLE",
        help="export a built-in case (see jaxgel samples) with all its numbers",
    )
    p.add_argument(
        "--regions",
        action="store_true",
        help="an example with regions of other materials, an elastomer and a stiffer gel",
    )
    p.add_argument("--time", action="store_true", help="an example that swells in time, in a bath")
    add("starting.schema", "schema", "print the JSON schema of a case file")
    add("starting.list_samples", "samples", "list the built-in cases")
    return whole, commands.choices


def _study_commands(add):
    """Commands that run many sweeps."""
    p = worker_options(
        add("studies.design", "design", "search the best holes of a study and verify them")
    )
    p.add_argument("study", metavar="STUDY.toml", help="the path of a study's TOML file")
    p.add_argument("--out", metavar="DIR", help="folder of the results (default: out/STUDY)")
    p.add_argument(
        "--resume",
        action="store_true",
        help="continue the search, or the searches, whose logs are in the folder",
    )
    device_option(p, "the designs of several searches")

    p = worker_options(
        add("studies.map_points", "map", "sweep many points in the space of a case's parameters")
    )
    p.add_argument("study", metavar="STUDY.toml", help="the path of a map's TOML file")
    p.add_argument("--out", metavar="DIR", help="folder of the results (default: out/STUDY)")
    p.add_argument(
        "--resume",
        action="store_true",
        help="run the points of the map in the folder that have not ended",
    )
    device_option(p, "the points")

    p = quiet_option(
        add(
            "serving.serve",
            "serve",
            "answer UM-Bridge's calls for a case's quantities and their derivatives",
        )
    )
    p.add_argument(
        "study",
        metavar="STUDY.toml",
        help="the path of a map's TOML file, whose section [map] may be missing",
    )
    p.add_argument(
        "--quantities",
        metavar="NAME,...",
        help="at the last state (default: core_rotation,rotation,area_reduction)",
    )
    p.add_argument(
        "--port",
        type=whole_number,
        default=4242,
        metavar="N",
        help="port of the server (default: 4242)",
    )
    p.add_argument(
        "--host",
        default="localhost",
        metavar="NAME",
        help="name that it listens on; 0.0.0.0 for all (default: localhost)",
    )

    p = quiet_option(
        add(
            "studies.paper",
            "paper",
            "compute the paper's table and figures again, beside what it prints",
        )
    )
    p.add_argument(
        "items",
        nargs="*",
        metavar="ITEM",
        help="table-1, fig-2, ..., fig-14 or algorithm (default: all that are missing)",
    )
    p.add_argument(
        "--out",
        metavar="DIR",
        default="out/paper",
        help="folder of the results (default: out/paper)",
    )


def _folder_commands(add):
    """Commands on a folder of results."""
    p = cache_option(add("folders.plot", "plot", "draw the figures of a run's folder again"))
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run")
    p.add_argument("--out", metavar="DIR", help="where the figures go (default: the same folder)")
    p.add_argument("--mp4", action="store_true", help="the animation as pattern.mp4 too, by ffmpeg")

    p = worker_options(
        add(
            "folders.resume",
            "resume",
            "continue an interrupted run, design or map, to the same result",
        )
    )
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run, design or map")
    p.add_argument(
        "--no-plots", action="store_true", help="leave out the figures and the animation of a run"
    )

    p = cache_option(
        add(
            "folders.outline",
            "outline",
            "write the outline of a case or a run as DXF, SVG, STL or PNG, and its masks",
        )
    )
    p.add_argument(
        "source",
        metavar="DIR|CASE",
        help="folder written by jaxgel run, a built-in name or the path of a TOML file",
    )
    p.add_argument(
        "--format", default="dxf", metavar="dxf|svg|stl|png", help="kind of file (default: dxf)"
    )
    near = (
        "the state of the run nearest to this value of mu in kT, or of its other control, within "
        "the run (default: the dry plate)"
    )
    p.add_argument("--mu", "--at", type=real, metavar="V", help=near)
    p.add_argument(
        "--height",
        type=real,
        default=1.0,
        metavar="H",
        help="height in mm of the extruded STL (default: 1)",
    )
    p.add_argument(
        "--pixels-per-mm",
        type=real,
        metavar="P",
        help="scale of PNG files (default: a round number, at most 2000 pixels along a side)",
    )
    p.add_argument(
        "--out",
        metavar="FILE",
        help=(
            "the file (default: CASE.FORMAT); masks are written beside it as CASE-Nv.png, "
            "CASE-chi.png"
        ),
    )

    p = cache_option(
        add(
            "folders.export", "export", "write a run's history and states as one netCDF (HDF5) file"
        )
    )
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run")
    p.add_argument("--out", metavar="FILE", help="the file (default: DIR/run.nc)")

    p = cache_option(
        add(
            "folders.view",
            "view",
            "write one HTML page of a run's folder, with a slider for its states",
        )
    )
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run")
    p.add_argument("--out", metavar="FILE", help="the page (default: DIR/view.html)")


def _joined(argv):
    """``argv`` with a negative number attached to the long option before it.

    argparse takes -1e-3 and -inf for options.
    """
    joined = []
    for word in argv:
        number = word.startswith("-") and is_number(word.split(",")[0])
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and number:
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined
