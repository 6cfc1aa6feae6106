"""Commands with which work starts: the built-in cases, a case file to change, the schema."""

import json
from argparse import Namespace
from pathlib import Path

from .._validation import did_you_mean
from .environment import DONE
from .generated import EXAMPLE, WITH_REGIONS, samples
from .generated import schema as case_schema


def init(args: Namespace) -> int:
    """``jaxgel init``: a commented case file to start from, with an example's or a built-in case's numbers."""
    if args.regions and args.sample is not None:
        raise ValueError(f"--regions: it belongs to the example, not to --from {args.sample}; leave one of the two out")
    text = _text(WITH_REGIONS if args.regions else args.sample)
    file = Path(f"{args.name or args.sample or 'case'}.toml".replace(".toml.toml", ".toml"))
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        raise ValueError(f"name: {str(file)!r} is there already; remove it or choose another name") from None
    except OSError as problem:
        raise ValueError(f"name: cannot write {str(file)!r}: {problem.strerror}") from None
    print(f"wrote {file}; jaxgel run {file} swells it")
    return DONE


def _text(source):
    """The text of a case file: the example's, a built-in case's, or another case file's with all its numbers."""
    known = samples()
    if source is None or source in known:
        return known[source or EXAMPLE]["text"]
    if not source.endswith(".toml") and not Path(source).is_file():
        raise ValueError(f"case: unknown name {source!r}; {did_you_mean(source, sample_names())}")
    from ..cases import case_text, explicit, load_case

    return case_text(explicit(load_case(source)))


def schema(_: Namespace) -> int:
    """``jaxgel schema``: the JSON schema of a case file."""
    print(json.dumps(case_schema(), indent=1, ensure_ascii=False))
    return DONE


def list_samples(_: Namespace) -> int:
    """``jaxgel samples``: one line per built-in case."""
    print(*(samples()[name]["line"] for name in sample_names()), sep="\n")
    return DONE


def sample_names() -> list[str]:
    """Names of the built-in cases."""
    return [name for name in samples() if name not in (EXAMPLE, WITH_REGIONS)]
