"""The commands and options of the command line, as argparse reads them and prints their help."""

import argparse
import functools
from importlib.metadata import version

from .._validation import did_you_mean, is_number
from ..cases import case_schema
from .environment import CACHE

DIGITS = 30  # read of a whole number, far beyond all that are accepted
COUNTS = {"divisions": 64, "most": 100, "port": 65535, "samples": 100_000, "states": 1000, "workers": 1024}
"""Options that are no entries of a case -> most that is accepted."""
OPTIONS = {
    "sweep": (
        *("control", "mu_start", "mu_end", "from", "to", "back", "values", "at_mu", "direction"),
        *("steps", "branch", "imperfection", "contact", "eigenvalues"),
    ),
    "discretisation": ("spacing", "nodes_per_hole", "across", "basis", "dmax"),
}  # sections of a case file and their entries that are options of commands


def parse(argv: list[str]) -> argparse.Namespace:
    """The arguments, with a suggestion for an option or command that is not known; ValueError for what cannot be used."""
    whole, known = parser()
    if argv and not argv[0].startswith("-") and argv[0] not in known:
        raise ValueError(f"command: {argv[0]!r} is unknown; {did_you_mean(argv[0], known)}")
    args, unknown = whole.parse_known_args(_joined(argv))
    if unknown:
        options = sorted(known[argv[0]]._option_string_actions)  # noqa: SLF001
        raise ValueError(f"{unknown[0]!r} is not an option of {argv[0]}; {did_you_mean(unknown[0].split('=')[0], options)}")
    for name, most in COUNTS.items():
        value = getattr(args, name, None)
        if value is not None and not 1 <= value <= most:
            raise ValueError(f"{name}: {value} is not accepted, it must be at least 1 and at most {most}")
    return args


def changes(args: argparse.Namespace) -> dict:
    """Sections and entries of a case that the options replace."""
    given = vars(args)
    changed = {section: {key: given[key] for key in keys if given.get(key) is not None} for section, keys in OPTIONS.items()}
    return changed | ({"output": {"figures": False, "animation": False}} if given.get("no_plots") else {})


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        """One line instead of the usage."""
        raise ValueError(f"{message}; see {self.prog} --help")


@functools.cache
def parser() -> tuple[argparse.ArgumentParser, dict]:
    """The parser of the command line, and those of its commands by name."""
    whole = _Parser(prog="jaxgel", description="Swelling-induced pattern transformation of perforated hydrogels.", allow_abbrev=False)
    whole.add_argument("--version", action="version", version=f"jaxgel {version('jaxgel')}")
    commands = whole.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(command, name, text):
        p = commands.add_parser(name, help=text, allow_abbrev=False)
        p.set_defaults(command=command)
        return p

    _case_commands(add)
    _error_bar_commands(add)
    _study_commands(add)
    _folder_commands(add)
    p = _cache_option(add("doctor.doctor", "doctor", "show versions, float64, threads and kept programs, and check two computations"))
    p.add_argument("--warm", action="store_true", help="compile what the built-in cases need, for a sweep and its gradient, and keep it")
    p = add("starting.init", "init", "write a commented case file to start from")
    p.add_argument("name", metavar="NAME", nargs="?", help="the file's name, without .toml (default: case, or the built-in name)")
    p.add_argument("--from", dest="sample", metavar="SAMPLE", help="export a built-in case (see jaxgel samples) with all its numbers")
    p.add_argument("--regions", action="store_true", help="an example with regions of other materials, an elastomer and a stiffer gel")
    p.add_argument("--time", action="store_true", help="an example that swells in time, in a bath")
    add("starting.schema", "schema", "print the JSON schema of a case file")
    add("starting.list_samples", "samples", "list the built-in cases")
    return whole, commands.choices


def _case_commands(add):
    """Commands on a case."""
    p = _case_options(add("runs.run", "run", "swell a case and write its table, states and figures"), "out/CASE")
    _steps_option(p)
    _control_options(p)
    _branch_option(p)
    p.add_argument(
        "--imperfection", type=_real, metavar="EPS", help="push along the first bifurcation's mode by EPS node spacings (default: 0)"
    )
    _choice(p, "sweep", "contact", "where a hole's sides meet: keep them apart, let them overlap, or stop (default: on)")
    p.add_argument(
        "--eigenvalues", action="store_const", const=True, help="compute every state's lowest eigenvalue, a column of history.csv"
    )
    p.add_argument("--across", type=_whole, metavar="N", help="at least N nodes across every ligament, by local refinement")
    _choice(p, "discretisation", "basis", "basis of the shape functions (default: quadratic)")
    p.add_argument("--dmax", type=_real, metavar="D", help="support radius over spacing (default: 2.95)")
    p.add_argument("--no-plots", action="store_true", help="leave out the figures and the animation")

    p = add("runs.critical", "critical", "find where the symmetric branch becomes unstable or folds back")
    _case_options(p, "out/CASE-critical")
    _control_options(p)
    p.add_argument("--most", type=_whole, default=4, metavar="N", help="number of points after which the search ends (default: 4)")
    p.add_argument("--no-plots", action="store_true", help="leave out the figure of the modes")

    p = add("runs.loop", "loop", "sweep a case up and down: where it jumps, the width of the loop, the unstable branch")
    _case_options(p, "out/CASE-loop")
    _control_options(p)
    p.add_argument("--quantity", default="core_rotation", metavar="NAME", help="of the figure, such as J_mean (default: core_rotation)")
    p.add_argument("--no-plots", action="store_true", help="leave out the figure")

    p = add("wave_runs.waves", "waves", "find the onset of an infinite lattice from one periodic cell")
    _case_options(p, "out/CASE-waves")
    p.add_argument("--divisions", type=_whole, default=8, metavar="N", help="steps from the middle of the zone to its edge (default: 8)")
    p.add_argument("--no-plots", action="store_true", help="leave out the figures")

    p = _case_options(add("runs.check_grad", "check-grad", "Taylor test of a case's gradients"), "out/CASE")
    _control_options(p)
    p.add_argument("--states", type=_whole, metavar="K", help="number of equally spaced values of the control, or of times (default: 4)")
    _branch_option(p)


def _error_bar_commands(add):
    """Commands that say how far the numbers of a case can be trusted."""
    p = add("accuracy.accuracy", "accuracy", "error bars of a case's numbers, from clouds of several spacings")
    _case_options(p, "out/CASE-accuracy")
    _steps_option(p)
    _control_options(p)
    _branch_option(p)
    p.add_argument("--at", type=_reals, metavar="A,B,...", help="values of the control at which error bars are printed (default: three)")
    p.add_argument("--quantities", metavar="NAME,...", help="columns of history.csv that get error bars (default: the main ones)")
    p.add_argument("--points", metavar="NAME,...", help="also error bars of onset, fold_up, fold_down or loop_width of the sweep's ends")
    p.add_argument(
        "--gradient", metavar="NAME,...", help="also error bars of the derivatives at the last state by these inputs, such as Nv"
    )
    p.add_argument("--no-plots", action="store_true", help="leave out the figure")

    p = add("uncertainty.uncertainty", "uncertainty", "standard deviations of a case's numbers from those of its inputs")
    _case_options(p, "out/CASE-uncertainty")
    p.add_argument("--uncertain", action="append", metavar="NAME=DEVIATION", help="an input and its standard deviation, as Nv=5%%")
    _steps_option(p)
    _control_options(p)
    _branch_option(p)
    p.add_argument("--quantities", metavar="NAME,...", help="quantities with derivatives (default: rotations and area reduction)")
    p.add_argument("--samples", type=_whole, metavar="N", help="check by N samples of the inputs, on all cores")
    _executor_options(p, "the samples")
    p.add_argument("--no-plots", action="store_true", help="leave out the figure")


def _study_commands(add):
    """Commands that run many sweeps."""
    p = _worker_options(add("studies.design", "design", "search the best holes of a study and verify them"))
    p.add_argument("study", metavar="STUDY.toml", help="the path of a study's TOML file")
    p.add_argument("--out", metavar="DIR", help="folder of the results (default: out/STUDY)")
    p.add_argument("--resume", action="store_true", help="continue the search, or the searches, whose logs are in the folder")

    p = _worker_options(add("studies.map_points", "map", "sweep many points in the space of a case's parameters"))
    p.add_argument("study", metavar="STUDY.toml", help="the path of a map's TOML file")
    p.add_argument("--out", metavar="DIR", help="folder of the results (default: out/STUDY)")
    p.add_argument("--resume", action="store_true", help="run the points of the map in the folder that have not ended")

    p = _quiet_option(add("serving.serve", "serve", "answer UM-Bridge's calls for a case's quantities and their derivatives"))
    p.add_argument("study", metavar="STUDY.toml", help="the path of a map's TOML file, whose section [map] may be missing")
    p.add_argument("--quantities", metavar="NAME,...", help="at the last state (default: core_rotation,rotation,area_reduction)")
    p.add_argument("--port", type=_whole, default=4242, metavar="N", help="port of the server (default: 4242)")
    p.add_argument("--host", default="localhost", metavar="NAME", help="name that it listens on; 0.0.0.0 for all (default: localhost)")

    p = _quiet_option(add("studies.paper", "paper", "compute the paper's table and figures again, beside what it prints"))
    p.add_argument("items", nargs="*", metavar="ITEM", help="table-1, fig-2, ..., fig-14 or algorithm (default: all that are missing)")
    p.add_argument("--out", metavar="DIR", default="out/paper", help="folder of the results (default: out/paper)")


def _folder_commands(add):
    """Commands on a folder of results."""
    p = _cache_option(add("folders.plot", "plot", "draw the figures of a run's folder again"))
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run")
    p.add_argument("--out", metavar="DIR", help="where the figures go (default: the same folder)")
    p.add_argument("--mp4", action="store_true", help="the animation as pattern.mp4 too, by ffmpeg")

    p = _worker_options(add("folders.resume", "resume", "continue an interrupted run, design or map, to the same result"))
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run, design or map")
    p.add_argument("--no-plots", action="store_true", help="leave out the figures and the animation of a run")

    p = _cache_option(add("folders.outline", "outline", "write the outline of a case or a run as DXF, SVG, STL or PNG, and its masks"))
    p.add_argument("source", metavar="DIR|CASE", help="folder written by jaxgel run, a built-in name or the path of a TOML file")
    p.add_argument("--format", default="dxf", metavar="dxf|svg|stl|png", help="kind of file (default: dxf)")
    near = "the state of the run nearest to this value of mu in kT, or of its other control, within the run (default: the dry plate)"
    p.add_argument("--mu", "--at", type=_real, metavar="V", help=near)
    p.add_argument("--height", type=_real, default=1.0, metavar="H", help="height in mm of the extruded STL (default: 1)")
    p.add_argument(
        "--pixels-per-mm", type=_real, metavar="P", help="scale of PNG files (default: a round number, at most 2000 pixels along a side)"
    )
    p.add_argument(
        "--out", metavar="FILE", help="the file (default: CASE.FORMAT); masks are written beside it as CASE-Nv.png, CASE-chi.png"
    )

    p = _cache_option(add("folders.export", "export", "write a run's history and states as one netCDF (HDF5) file"))
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run")
    p.add_argument("--out", metavar="FILE", help="the file (default: DIR/run.nc)")

    p = _cache_option(add("folders.view", "view", "write one HTML page of a run's folder, with a slider for its states"))
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run")
    p.add_argument("--out", metavar="FILE", help="the page (default: DIR/view.html)")


def _case_options(p, out):
    """The parser ``p`` of a command that works on a case, with what all of these take; ``out`` is the default folder."""
    p.add_argument("case", metavar="CASE", help="a built-in name (see jaxgel samples) or the path of a TOML file")
    p.add_argument("--out", metavar="DIR", help=f"folder of the results (default: {out})")
    p.add_argument("--mu-start", type=_real, metavar="A", help="first chemical potential in kT (default: the case's, or -4.9678)")
    p.add_argument("--mu-end", type=_real, metavar="B", help="last chemical potential in kT (default: the case's, or -0.9178)")
    p.add_argument("--spacing", type=_real, metavar="H", help="distance of the nodes in mm (default: the case's own)")
    p.add_argument("--nodes-per-hole", type=_whole, metavar="N", help="nodes on the outline of a hole (default: the case's own)")
    return _quiet_option(p)


def _worker_options(p):
    _executor_options(p, "a map or a design with several starts")
    return _quiet_option(p)


def _executor_options(p, many):
    p.add_argument("--workers", type=_whole, metavar="N", help=f"processes of {many} on this machine (default: one for each core)")
    p.add_argument("--scheduler", metavar="ADDRESS", help=f"run {many} on the Dask cluster with this scheduler, tcp://HOST:PORT, instead")


def _quiet_option(p):
    p.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return _cache_option(p)


def _cache_option(p):
    p.add_argument("--cache", metavar="DIR|off", help=f"folder of compiled programs (default: {CACHE}, or the user's cache folder)")
    return p


def _choice(p, section, key, text):
    """An option that is one of the words of an entry of a case file."""
    words = case_schema()["properties"][section]["properties"][key]["enum"]
    p.add_argument(f"--{key}", metavar="|".join(words), help=text)


def _steps_option(p):
    p.add_argument("--steps", type=_steps, metavar="auto|N", help="chosen steps, or N equally spaced values each way (default: 40)")


def _branch_option(p):
    _choice(p, "sweep", "branch", "branch to follow where the plate is symmetric (default: stable)")


def _control_options(p):
    """What drives the sweep, and how."""
    _choice(p, "sweep", "control", "what is driven in place of mu: a number of the gel, the stretch of the edges, the loads (default: mu)")
    p.add_argument("--from", type=_real, metavar="A", help="first value of another control than mu")
    p.add_argument("--to", type=_real, metavar="B", help="last value of it, or with --back the one at which it turns")
    p.add_argument("--values", type=_reals, metavar="A,B,...", help="its values themselves, which may rise and fall")
    p.add_argument("--back", action="store_const", const=True, help="go back to the first value, of mu too")
    p.add_argument("--at-mu", type=_real, metavar="MU", help="chemical potential in kT at which another control is driven (default: 0)")
    _choice(p, "sweep", "direction", "along which a stretch acts (default: both)")


def _joined(argv):
    """``argv`` with a negative number after a long option attached to it, as argparse takes -1e-3 and -inf for options."""
    joined = []
    for word in argv:
        number = word.startswith("-") and is_number(word.split(",")[0])
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and number:
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _real(word):
    if not is_number(word):
        raise argparse.ArgumentTypeError(f"{word!r} is not a number")
    return float(word)


def _reals(text):
    words = text.split(",")
    wrong = next((word for word in words if not is_number(word)), None)
    if wrong is not None:
        raise argparse.ArgumentTypeError(f"{text!r} is no list of numbers with commas between them: {wrong!r} is none")
    return [float(word) for word in words]


def _whole(word):
    if not word.isdecimal():
        raise argparse.ArgumentTypeError(f"{word!r} is not a whole number")
    return int(word[:DIGITS])


def _steps(word):
    if word == "auto":
        return word
    if not word.isdecimal():
        raise argparse.ArgumentTypeError(f"{word!r} is neither auto nor a whole number")
    return int(word[:DIGITS])
