"""``jaxgel serve``: a case as a function of its parameters, for programs that speak UM-Bridge."""

import functools
from argparse import Namespace

import numpy as np

from ..cases import RESPONSES, Response, load_parameters
from ..io import ServedFunction, um_bridge_server
from .environment import DONE
from .runs import printer

MODEL = "forward"  # name of the function, as in UM-Bridge's own examples
# points whose paths and derivatives are kept: a client asks for value and derivatives of one point
# in several calls
RECENT = 4


def serve(args: Namespace) -> int:
    """Answer UM-Bridge's calls until Ctrl-C."""
    study, say = load_parameters(args.study), printer(args)
    response = Response(
        study, study.case.cloud(), args.quantities.split(",") if args.quantities else RESPONSES
    )
    with um_bridge_server(served(response), args.host, args.port) as server:
        say(f"{study.name}: {', '.join(study.names)} -> {', '.join(response.quantities)}")
        say(f"UM-Bridge model {MODEL!r} at http://{args.host}:{server.server_port}; Ctrl-C ends it")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            say("ended")
    return DONE


def served(response: Response) -> ServedFunction:
    """The function of a `Response` that UM-Bridge serves."""
    path = functools.lru_cache(RECENT)(response.path)

    def values(vector: tuple[float, ...]) -> np.ndarray:
        return response.values(path(vector))

    @functools.lru_cache(RECENT)
    def jacobian(vector: tuple[float, ...]) -> np.ndarray:
        return response.jacobian(vector, path(vector))

    return ServedFunction(MODEL, len(response.study.names), response.quantities, values, jacobian)
