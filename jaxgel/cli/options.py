"""Options of several commands, and the numbers that they read from words."""

from argparse import ArgumentParser, ArgumentTypeError

from .._validation import is_number
from ..cases import case_schema
from ..continuation import DEVICES
from .environment import CACHE

DIGITS = 30  # read of a whole number, far beyond all that are accepted


def case_options(p: ArgumentParser, out: str) -> ArgumentParser:
    """The parser ``p`` of a command that works on a case, with what all of these take.

    ``out`` is the default folder.
    """
    p.add_argument(
        "case",
        metavar="CASE",
        help="a built-in name (see jaxgel samples) or the path of a TOML file",
    )
    p.add_argument("--out", metavar="DIR", help=f"folder of the results (default: {out})")
    p.add_argument(
        "--mu-start",
        type=real,
        metavar="A",
        help="first chemical potential in kT (default: the case's, or -4.9678)",
    )
    p.add_argument(
        "--mu-end",
        type=real,
        metavar="B",
        help="last chemical potential in kT (default: the case's, or -0.9178)",
    )
    p.add_argument(
        "--spacing",
        type=real,
        metavar="H",
        help="distance of the nodes in mm (default: the case's own)",
    )
    p.add_argument(
        "--nodes-per-hole",
        type=whole_number,
        metavar="N",
        help="nodes on the outline of a hole (default: the case's own)",
    )
    return quiet_option(p)


def control_options(p: ArgumentParser) -> None:
    """What drives the sweep, and how."""
    text = (
        "what is driven in place of mu: a number of the gel, the stretch of the edges, the loads, "
        "an obstacle (default: mu)"
    )
    choice(p, "sweep", "control", text)
    p.add_argument("--from", type=real, metavar="A", help="first value of another control than mu")
    p.add_argument(
        "--to",
        type=real,
        metavar="B",
        help="last value of it, or with --back the one at which it turns",
    )
    p.add_argument(
        "--values",
        type=reals,
        metavar="A,B,...",
        help="its values themselves, which may rise and fall",
    )
    p.add_argument(
        "--back", action="store_const", const=True, help="go back to the first value, of mu too"
    )
    p.add_argument(
        "--at-mu",
        type=real,
        metavar="MU",
        help="chemical potential in kT at which another control is driven (default: 0)",
    )
    choice(p, "sweep", "direction", "along which a stretch acts (default: both)")


def steps_option(p: ArgumentParser) -> None:
    """Steps of a sweep."""
    p.add_argument(
        "--steps",
        type=steps,
        metavar="auto|N",
        help="chosen steps, or N equally spaced values each way (default: 40)",
    )


def branch_option(p: ArgumentParser) -> None:
    """Branch of a symmetric plate."""
    choice(p, "sweep", "branch", "branch to follow if the plate is symmetric (default: stable)")


def choice(p: ArgumentParser, section: str, key: str, text: str) -> None:
    """An option that is one of the words of an entry of a case file."""
    words = case_schema()["properties"][section]["properties"][key]["enum"]
    p.add_argument(f"--{key}", metavar="|".join(words), help=text)


def worker_options(p: ArgumentParser) -> ArgumentParser:
    """Processes of a map or a study, and the options of all commands."""
    executor_options(p, "a map or a design with several starts")
    return quiet_option(p)


def executor_options(p: ArgumentParser, many: str) -> None:
    """Processes that run ``many`` sweeps."""
    p.add_argument(
        "--workers",
        type=whole_number,
        metavar="N",
        help=f"processes of {many} on this machine (default: one for each core)",
    )
    p.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help=f"run {many} on the Dask cluster with this scheduler, tcp://HOST:PORT, instead",
    )


def device_option(p: ArgumentParser, many: str) -> None:
    """Device on which a compiled program sweeps ``many`` in batches."""
    p.add_argument(
        "--device",
        metavar="|".join(DEVICES),
        help=f"sweep {many} in batches by one compiled program there; the processes sweep those "
        "that it leaves (default: the processes sweep all)",
    )


def quiet_option(p: ArgumentParser) -> ArgumentParser:
    """Output, and the folder of compiled programs."""
    p.add_argument("--quiet", action="store_true", help="print nothing but errors")
    return cache_option(p)


def cache_option(p: ArgumentParser) -> ArgumentParser:
    """Folder of compiled programs."""
    p.add_argument(
        "--cache",
        metavar="DIR|off",
        help=f"folder of compiled programs (default: {CACHE}, or the user's cache folder)",
    )
    return p


def real(word: str) -> float:
    """A number."""
    if not is_number(word):
        raise ArgumentTypeError(f"{word!r} is not a number")
    return float(word)


def reals(text: str) -> list[float]:
    """Numbers with commas between them."""
    words = text.split(",")
    wrong = next((word for word in words if not is_number(word)), None)
    if wrong is not None:
        raise ArgumentTypeError(
            f"{text!r} is no list of numbers with commas between them: {wrong!r} is none"
        )
    return [float(word) for word in words]


def whole_number(word: str) -> int:
    """A whole number, of at most ``DIGITS`` digits."""
    if not word.isdecimal():
        raise ArgumentTypeError(f"{word!r} is not a whole number")
    return int(word[:DIGITS])


def steps(word: str) -> int | str:
    """The word auto, or a whole number of steps."""
    if word == "auto":
        return word
    if not word.isdecimal():
        raise ArgumentTypeError(f"{word!r} is neither auto nor a whole number")
    return int(word[:DIGITS])
