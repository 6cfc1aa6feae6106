"""Commands to start with: built-in cases, a case file to edit, the schema."""

import json
from argparse import Namespace
from pathlib import Path

from ..cases import case_names, case_schema, case_text, example, explicit, load_case
from .environment import DONE


def init(args: Namespace) -> int:
    """``jaxgel init``: a commented case file with an example's or a built-in case's numbers."""
    for name, given in (("--regions", args.regions), ("--time", args.time)):
        if given and args.sample is not None:
            raise ValueError(
                f"{name}: it belongs to the example, not to --from {args.sample}; leave one of "
                "the two out"
            )
    case = (
        example(regions=args.regions, in_time=args.time)
        if args.sample is None
        else load_case(args.sample)
    )
    text = case_text(case if args.sample is None else explicit(case))
    file = Path(f"{args.name or args.sample or 'case'}.toml".replace(".toml.toml", ".toml"))
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        raise ValueError(
            f"name: {str(file)!r} is there already; remove it or choose another name"
        ) from None
    except OSError as problem:
        raise ValueError(f"name: cannot write {str(file)!r}: {problem.strerror}") from None
    print(f"wrote {file}; jaxgel run {file} swells it")
    return DONE


def schema(_: Namespace) -> int:
    """``jaxgel schema``: the JSON schema of a case file."""
    print(json.dumps(case_schema(), indent=1, ensure_ascii=False))
    return DONE


def list_samples(_: Namespace) -> int:
    """``jaxgel samples``: one line per built-in case."""
    for name in case_names():
        case = load_case(name)
        plate, gel = case.plate, case.gel
        kinds = sorted({type(hole).__name__.lower() for hole in plate.holes})
        holes = f"{len(plate.holes)} holes ({', '.join(kinds)})" if kinds else "no hole"
        bath = (
            f"; from mu = {case.sweep.mu_start:g} in a bath of {case.bath.mu:g} kT"
            if case.time
            else ""
        )
        print(
            f"{name:13s} {plate.width:g} x {plate.height:g} {plate.unit}, {holes}, Nv {gel.Nv:g}, "
            f"chi {gel.chi:g}{bath}"
        )
    return DONE
