"""The command line ``jaxgel``: run a case, draw a run's folder, design holes, test gradients, list the built-in cases.

Exit codes: 0 done; 2 unusable input, with one line that names it; 3 the sweep stopped early; 130 interrupted. What a run had
finished by then is in its folder in every case.
"""

import argparse
import sys
from importlib.metadata import version
from pathlib import Path as File

import numpy as np

from . import cases
from .branches import imperfect_loads
from .critical import critical_points
from .geometry import did_you_mean
from .results import Recorder, events, load_path, load_run, open_folder, write_points
from .samples import sample, sample_names
from .sweep import SweepFailed, sweep
from .terminal import Progress, interruptible

DONE, UNUSABLE, STOPPED, INTERRUPTED = 0, 2, 3, 130
OPTIONS = {
    "sweep": ("mu_start", "mu_end", "steps", "branch", "imperfection", "contact"),
    "discretisation": ("spacing", "nodes_per_hole", "across", "basis", "dmax", "method", "quadrature"),
}


def main(argv=None):
    """Run the command line on ``argv`` (by default the process's own) and return its exit code."""
    try:
        args = _parse(sys.argv[1:] if argv is None else list(argv))
        return args.command(args)
    except ValueError as problem:
        print(f"jaxgel: error: {problem}", file=sys.stderr)
        return UNUSABLE
    except (SweepFailed, OSError) as problem:  # no first state; a full disk, a folder that went away
        print(f"jaxgel: error: {problem}", file=sys.stderr)
        return STOPPED


def run(args):
    """``jaxgel run``: sweep a case and write its folder."""
    case = cases.load_case(args.case, _changes(args))
    folder = open_folder(args.out or File("out") / case.name)
    say = _silent if args.quiet else print
    model, d = case.model(), case.discretisation
    say(f"{case.name}: {len(model.cloud.nodes)} nodes, {model.n_points} quadrature points, {d.basis} basis, {d.method} method")
    recorder = Recorder(folder, case, model, case.gel)
    try:
        path = _sweep(case, model, recorder, args.quiet)
    except KeyboardInterrupt:
        recorder.finish("interrupted", "stopped by the user")
        _report(recorder, say)
        return INTERRUPTED
    except Exception as problem:
        recorder.finish("failed", " ".join(str(problem).split()) or type(problem).__name__)
        raise
    recorder.finish("complete" if path.stop.ok else "stopped", path.stop_text)
    say("drawing" if not args.no_plots else "writing", "the results")
    _draw(path, folder, recorder.table, plots=not args.no_plots)
    _report(recorder, say)
    if not path.stop.ok:
        print(f"jaxgel: the sweep stopped early: {path.stop_text}", file=sys.stderr)
    return DONE if path.stop.ok else STOPPED


def _changes(args):
    """Sections and entries of a case that the options replace."""
    given = vars(args)
    return {section: {key: given[key] for key in keys if given.get(key) is not None} for section, keys in OPTIONS.items()}


def _sweep(case, model, recorder, quiet):
    """The path of a case, recorded and shown while it grows."""
    loads = imperfect_loads(case, model)
    with Progress(case.sweep.ends, quiet) as progress, interruptible() as stop_if_asked:

        def on_step(step):
            recorder(step)
            progress.show(recorder.records[-1][1])
            stop_if_asked()

        return sweep(
            model, case.gel, mu=case.sweep.values, branch=case.sweep.branch, contact=case.sweep.contact, loads=loads, on_step=on_step
        )


def plot(args):
    """``jaxgel plot``: draw the figures of a run's folder again."""
    folder = File(args.folder)
    table = load_run(folder).history
    _draw(load_path(folder), open_folder(args.out) if args.out else folder, table, plots=True)
    return DONE


def critical(args):
    """``jaxgel critical``: locate the bifurcations and folds of a case's symmetric branch, and draw their modes."""
    case = cases.load_case(args.case, _changes(args))
    folder = open_folder(args.out or File("out") / f"{case.name}-critical")
    say, model = _silent if args.quiet else print, case.model()
    say(f"{case.name}: {len(model.cloud.nodes)} nodes, searching from mu = {case.sweep.mu_start:g} to {case.sweep.mu_end:g}")
    points = critical_points(model, case.gel, mu=(case.sweep.mu_start, case.sweep.mu_end), most=args.most)
    write_points(points, folder, case.table())
    for point in points:
        say(f"mu = {point.mu:.7f}: {point.text}")
    if not points:
        say("the symmetric branch is stable and does not fold back")
    elif not args.no_plots:
        _draw_modes(model, points, folder)
    say(f"{len(points)} critical points in {folder}")
    return DONE


def _draw_modes(model, points, folder):
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from .plotting import plot_modes

    figure = plot_modes(model, points)[0].figure
    figure.savefig(folder / "modes.png")
    plt.close(figure)


def check_grad(args):
    """``jaxgel check-grad``: Taylor test of a case's gradients, as a table."""
    from .check_gradient import STATES, check_gradient, failures, write_table

    case = cases.load_case(args.case, _changes(args))
    folder = open_folder(args.out or File("out") / case.name)
    try:
        rows = check_gradient(case, states=args.states or STATES, quiet=args.quiet)
    except ArithmeticError as problem:
        print(f"jaxgel: {problem}", file=sys.stderr)
        return STOPPED
    write_table(rows, folder)
    say = _silent if args.quiet else print
    say(f"{'objective':<15} {'family':<10} {'slope':>10}  {'remainder at h = 1, 1/2, 1/4 ...':<50} {'rate':>6}")
    for row in rows:
        remainders = " ".join(f"{r:9.2e}" for r in row.remainders)
        say(f"{row.objective:<15} {row.family:<10} {row.slope:10.3e}  {remainders:<50} {row.rate:6.3f}")
    failed = failures(rows)
    if failed:
        named = ", ".join(f"{objective} by {family}" for objective, family in failed)
        print(f"jaxgel: the remainder does not fall as h^2: {named}", file=sys.stderr)
    return STOPPED if failed else DONE


def design(args):
    """``jaxgel design``: search the best holes of a study, verify them, and write the study's folder."""
    from .study import load_study

    study = load_study(args.study)
    return _design(study, args.out or File("out") / study.name, args)


def resume(args):
    """``jaxgel resume``: continue an interrupted design in its folder."""
    from .search import LOG
    from .study import resumed_study

    if not (File(args.folder) / LOG).is_file():
        raise ValueError(f"folder: {args.folder!r} holds no {LOG}; expected a folder written by jaxgel design")
    return _design(resumed_study(args.folder), args.folder, args, resume=True)


def _design(study, folder, args, resume=False):
    import matplotlib as mpl

    mpl.use("Agg")  # before pyplot, which would look for a screen
    from .study import run_study

    say = _silent if args.quiet else print
    found, verified = run_study(study, open_folder(folder), resume=resume or getattr(args, "resume", False), quiet=args.quiet)
    if verified is None:
        print("jaxgel: interrupted; jaxgel resume goes on", file=sys.stderr)
        return INTERRUPTED
    say(f"{study.name}: {len(found.history)} evaluations; {found.text}")
    for name, value in found.parameters.items():
        say(f"{name:<12} {np.array2string(value, precision=4, separator=', ')}")
    for name in ("start", "best"):
        v = verified[name]
        say(f"{name} on a fresh cloud of {v['nodes']} nodes: objective {v['value']:.6g}; {v['reason']}")
    say(f"results in {folder}")
    valid = found.feasible and verified["best"]["valid"]
    if not valid:
        reason = verified["best"]["reason"] if found.feasible else "no design met all constraints"
        print(f"jaxgel: the design is not usable: {reason}", file=sys.stderr)
    return DONE if valid else STOPPED


def list_samples(_):
    """``jaxgel samples``: one line per built-in case."""
    for name in sample_names():
        plate = sample(name)
        kinds = sorted({type(hole).__name__.lower() for hole in plate.holes})
        holes = f"{len(plate.holes)} holes ({', '.join(kinds)})" if kinds else "no hole"
        print(f"{name:10s} {plate.width:g} x {plate.height:g} {plate.unit}, {holes}, Nv {plate.gel.Nv:g}, chi {plate.gel.chi:g}")
    return DONE


def _draw(path, folder, table, plots):
    """Figures (where wanted) and ParaView files of a path with the history ``table``, in a folder."""
    import matplotlib as mpl

    mpl.use("Agg")  # before pyplot, which would look for a screen
    import matplotlib.pyplot as plt

    from .plotting import animate_pattern, plot_curves, plot_patterns, write_series

    write_series(path, folder, table=table)
    if not plots:
        return
    for axes, name in ((plot_patterns(path), "pattern.png"), (plot_curves(path, table=table), "curves.png")):
        figure = np.ravel(axes)[0].figure
        figure.savefig(folder / name)
        plt.close(figure)
    animate_pattern(path, folder / "pattern.gif")


def _report(recorder, say, most_rows=9):
    """Print a table of at most ``most_rows`` states, the events, and where the files are."""
    table = recorder.table
    k = len(recorder.records)
    if k:
        say(f"{'mu':>8} {'stretch':>8} {'rotation':>9} {'core':>8} {'area red.':>9} {'J mean':>7} {'gap':>7}  status")
        say(f"{'kT':>8} {'':>8} {'deg':>9} {'deg':>8} {'%':>9} {'':>7} {recorder.model.cloud.topology.plate.unit:>7}")
    for i in np.unique(np.linspace(0, k - 1, min(k, most_rows)).round().astype(int)) if k else ():
        row = {name: column[i] for name, column in table.items()}
        unstable = ", unstable" if row["negative_pivots"] else ""
        say(
            f"{row['mu']:8.4f} {row['free_stretch']:8.4f} {row['rotation_deg']:9.3f} {row['core_rotation_deg']:8.3f}"
            f" {100 * row['area_reduction']:9.3f} {row['J_mean']:7.4f} {row['min_gap']:7.3f}  {row['status']}{unstable}"
        )
    for event in events(table):
        say(f"{event['event']}: {event['text']}")
    say(f"{k} states in {recorder.folder}")


def _silent(*_):
    pass


def _parse(argv):
    """The arguments, with a suggestion for an option or command that is not known; ValueError for what cannot be used."""
    parser, commands = _parser()
    if argv and not argv[0].startswith("-") and argv[0] not in commands:
        raise ValueError(f"command: {argv[0]!r} is unknown; {did_you_mean(argv[0], commands)}")
    args, unknown = parser.parse_known_args(_joined(argv))
    if unknown:
        known = sorted(commands[argv[0]]._option_string_actions)
        raise ValueError(f"{unknown[0]!r} is not an option of {argv[0]}; {did_you_mean(unknown[0].split('=')[0], known)}")
    return args


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        """One line instead of the usage."""
        raise ValueError(f"{message}; see {self.prog} --help")


def _parser():
    parser = _Parser(prog="jaxgel", description="Swelling-induced pattern transformation of perforated hydrogels.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"jaxgel {version('jaxgel')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(command, name, text):
        p = commands.add_parser(name, help=text, allow_abbrev=False)
        p.set_defaults(command=command)
        return p

    p = _case_options(add(run, "run", "swell a case and write its table, states and figures"), "out/CASE")
    p.add_argument(
        "--steps", type=_steps, metavar="auto|N", help="chosen steps, or N equally spaced values of mu, both ends included (default: 40)"
    )
    _branch_option(p)
    p.add_argument(
        "--imperfection", type=_real, metavar="EPS", help="push along the first bifurcation's mode by EPS node spacings (default: 0)"
    )
    p.add_argument(
        "--contact",
        metavar="|".join(cases.CONTACT),
        help="where a hole's sides meet: keep them apart, let them overlap, or stop (default: on)",
    )
    p.add_argument("--across", type=_whole, metavar="N", help="at least N nodes across every ligament, by local refinement")
    p.add_argument("--basis", metavar="|".join(cases.BASES), help="basis of the shape functions (default: quadratic)")
    p.add_argument("--dmax", type=_real, metavar="D", help="support radius over spacing (default: 2.95, paper quadrature 3.5)")
    p.add_argument("--method", metavar="|".join(cases.METHODS), help="one pressure per cell, or displacement only (default: mixed)")
    p.add_argument(
        "--quadrature", metavar="|".join(cases.QUADRATURES), help="cells along the true outline, or the paper's (default: conforming)"
    )
    p.add_argument("--no-plots", action="store_true", help="leave out the figures and the animation")

    p = _case_options(add(critical, "critical", "find where the symmetric branch becomes unstable or folds back"), "out/CASE-critical")
    p.add_argument("--most", type=_whole, default=4, metavar="N", help="number of points after which the search ends (default: 4)")
    p.add_argument("--no-plots", action="store_true", help="leave out the figure of the modes")

    p = _case_options(add(check_grad, "check-grad", "Taylor test of a case's gradients"), "out/CASE")
    p.add_argument("--states", type=_whole, metavar="K", help="number of equally spaced values of mu (default: 4)")
    _branch_option(p)

    p = add(plot, "plot", "draw the figures of a run's folder again")
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel run")
    p.add_argument("--out", metavar="DIR", help="where the figures go (default: the same folder)")

    p = _quiet_option(add(design, "design", "search the best holes of a study and verify them"))
    p.add_argument("study", metavar="STUDY.toml", help="the path of a study's TOML file")
    p.add_argument("--out", metavar="DIR", help="folder of the results (default: out/STUDY)")
    p.add_argument("--resume", action="store_true", help="continue the search whose log is in the folder")

    p = _quiet_option(add(resume, "resume", "continue an interrupted design, to the same result"))
    p.add_argument("folder", metavar="DIR", help="folder written by jaxgel design")

    add(list_samples, "samples", "list the built-in cases")
    return parser, commands.choices


def _case_options(p, out):
    """The parser ``p`` of a command that works on a case, with what all of these take; ``out`` is the default folder."""
    p.add_argument("case", metavar="CASE", help="a built-in name (see jaxgel samples) or the path of a TOML file")
    p.add_argument("--out", metavar="DIR", help=f"folder of the results (default: {out})")
    p.add_argument("--mu-start", type=_real, metavar="A", help="first chemical potential in kT (default: the case's, or -4.9678)")
    p.add_argument("--mu-end", type=_real, metavar="B", help="last chemical potential in kT (default: the case's, or -0.9178)")
    p.add_argument("--spacing", type=_real, metavar="H", help="distance of the nodes in mm (default: the case's own)")
    p.add_argument("--nodes-per-hole", type=_whole, metavar="N", help="nodes on the outline of a hole (default: the case's own)")
    return _quiet_option(p)


def _quiet_option(p):
    p.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return p


def _branch_option(p):
    p.add_argument("--branch", metavar="|".join(cases.BRANCHES), help="branch to follow where the plate is symmetric (default: stable)")


def _joined(argv):
    """``argv`` with a negative number after a long option attached to it, as argparse takes -1e-3 and -inf for options."""
    joined = []
    for word in argv:
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and word.startswith("-") and _is_number(word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def _real(word):
    if not _is_number(word):
        raise argparse.ArgumentTypeError(f"{word!r} is not a number")
    return float(word)


def _whole(word):
    if not word.isdecimal():
        raise argparse.ArgumentTypeError(f"{word!r} is not a whole number")
    return int(word)


def _steps(word):
    if word == "auto":
        return word
    if not word.isdecimal():
        raise argparse.ArgumentTypeError(f"{word!r} is neither auto nor a whole number")
    return int(word)
