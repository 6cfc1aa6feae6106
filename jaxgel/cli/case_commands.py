"""Commands on a case and their options: runs, critical points, loops, waves, error bars."""

from argparse import ArgumentParser
from collections.abc import Callable

from .options import (
    branch_option,
    case_options,
    choice,
    control_options,
    device_option,
    executor_options,
    real,
    reals,
    steps_option,
    whole_number,
)

Add = Callable[[str, str, str], ArgumentParser]
"""(module.function, name, text) of a command -> its parser."""


def case_commands(add: Add) -> None:
    """Commands on a case."""
    p = case_options(
        add("runs.run", "run", "swell a case and write its table, states and figures"), "out/CASE"
    )
    steps_option(p)
    control_options(p)
    branch_option(p)
    p.add_argument(
        "--imperfection",
        type=real,
        metavar="EPS",
        help="push along the first bifurcation's mode by EPS node spacings (default: 0)",
    )
    choice(
        p,
        "sweep",
        "contact",
        "if a hole's sides meet: keep them apart, let them overlap, or stop (default: on)",
    )
    p.add_argument(
        "--eigenvalues",
        action="store_const",
        const=True,
        help="compute every state's lowest eigenvalue, a column of history.csv",
    )
    p.add_argument(
        "--across",
        type=whole_number,
        metavar="N",
        help="at least N nodes across every ligament, by local refinement",
    )
    choice(p, "discretisation", "basis", "basis of the shape functions (default: quadratic)")
    p.add_argument(
        "--dmax", type=real, metavar="D", help="support radius over spacing (default: 2.95)"
    )
    p.add_argument(
        "--no-plots", action="store_true", help="leave out the figures and the animation"
    )

    p = add(
        "runs.critical", "critical", "locate the bifurcations and folds of the symmetric branch"
    )
    case_options(p, "out/CASE-critical")
    control_options(p)
    p.add_argument(
        "--most",
        type=whole_number,
        default=4,
        metavar="N",
        help="number of points after which the search ends (default: 4)",
    )
    p.add_argument("--no-plots", action="store_true", help="leave out the figure of the modes")

    p = add("runs.loop", "loop", "hysteresis loop of a case: snap points, width, unstable branch")
    case_options(p, "out/CASE-loop")
    control_options(p)
    p.add_argument(
        "--quantity",
        default="core_rotation",
        metavar="NAME",
        help="of the figure, such as J_mean (default: core_rotation)",
    )
    p.add_argument("--no-plots", action="store_true", help="leave out the figure")

    p = add(
        "wave_runs.waves", "waves", "find the onset of an infinite lattice from one periodic cell"
    )
    case_options(p, "out/CASE-waves")
    p.add_argument(
        "--divisions",
        type=whole_number,
        default=8,
        metavar="N",
        help="steps from the middle of the zone to its edge (default: 8)",
    )
    p.add_argument("--no-plots", action="store_true", help="leave out the figures")

    p = case_options(
        add("runs.check_grad", "check-grad", "Taylor test of a case's gradients"), "out/CASE"
    )
    control_options(p)
    p.add_argument(
        "--states",
        type=whole_number,
        metavar="K",
        help="number of equally spaced values of the control, or of times (default: 4)",
    )
    branch_option(p)


def error_bar_commands(add: Add) -> None:
    """Commands that say how far the numbers of a case can be trusted."""
    p = add(
        "accuracy.accuracy",
        "accuracy",
        "error bars of a case's numbers, from clouds of several spacings",
    )
    case_options(p, "out/CASE-accuracy")
    steps_option(p)
    control_options(p)
    branch_option(p)
    p.add_argument(
        "--at",
        type=reals,
        metavar="A,B,...",
        help="values of the control at which error bars are printed (default: three)",
    )
    p.add_argument(
        "--quantities",
        metavar="NAME,...",
        help="columns of history.csv that get error bars (default: the main ones)",
    )
    p.add_argument(
        "--points",
        metavar="NAME,...",
        help="also error bars of onset, fold_up, fold_down or loop_width of the sweep's ends",
    )
    p.add_argument(
        "--gradient",
        metavar="NAME,...",
        help="also error bars of the derivatives at the last state by these inputs, such as Nv",
    )
    p.add_argument("--no-plots", action="store_true", help="leave out the figure")

    p = add(
        "uncertainty.uncertainty",
        "uncertainty",
        "standard deviations of a case's numbers from those of its inputs",
    )
    case_options(p, "out/CASE-uncertainty")
    p.add_argument(
        "--uncertain",
        action="append",
        metavar="NAME=DEVIATION",
        help="an input and its standard deviation, as Nv=5%%",
    )
    steps_option(p)
    control_options(p)
    branch_option(p)
    p.add_argument(
        "--quantities",
        metavar="NAME,...",
        help="quantities with derivatives (default: rotations and area reduction)",
    )
    p.add_argument(
        "--samples",
        type=whole_number,
        metavar="N",
        help="check by N samples of the inputs, on all cores",
    )
    executor_options(p, "the samples")
    device_option(p, "the samples")
    p.add_argument("--no-plots", action="store_true", help="leave out the figure")
