"""A UM-Bridge 1.0 server: values and derivatives of a function for samplers and optimisers.

The protocol is JSON over HTTP, see https://um-bridge-benchmarks.readthedocs.io. The function has
one input vector and one output vector, as the clients for PyMC and emcee in the package umbridge
require. An error is answered as {"error": {"type", "message"}}, and the server goes on:
InvalidInput for what the caller can mend, ModelError for a value that does not exist, InternalError
for a fault.
"""

import dataclasses
import json
import threading
import traceback
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

from .._types import Float
from .files import one_line

PROTOCOL = 1.0
MAX_BYTES = 2**24  # of a request
SUPPORTED = {"Evaluate": True, "Gradient": True, "ApplyJacobian": True, "ApplyHessian": False}


class UnusableRequest(ValueError):
    """A request that cannot be answered; ``kind`` is the error's type."""

    def __init__(self, text: str, kind: str = "InvalidInput") -> None:
        super().__init__(text)
        self.kind = kind


@dataclasses.dataclass(frozen=True, eq=False)
class ServedFunction:
    """A function of a vector (d,) with values (r,)."""

    name: str
    """Name of the model."""
    inputs: int
    """Size d of its input vector."""
    outputs: Sequence[str]
    """Names (r) of its values."""
    values: Callable[[tuple[float, ...]], Float[np.ndarray, " r"]]
    """The values; ValueError for a wrong vector, ArithmeticError if they do not exist."""
    jacobian: Callable[[tuple[float, ...]], Float[np.ndarray, "r d"]]
    """Their derivatives; errors as of ``values``. A row that is nan does not exist."""

    def answer(self, call: str, request: dict) -> dict:
        """What a ``call`` of the protocol, such as "Evaluate", is answered."""
        if request.get("name") != self.name:
            raise UnusableRequest(
                f"name: {request.get('name')!r} is unknown; accepted: {self.name}", "ModelNotFound"
            )
        if request.get("config"):
            raise UnusableRequest(f"config: {request['config']!r} is not accepted; leave it empty")
        plain = {
            "ModelInfo": {"support": SUPPORTED},
            "InputSizes": {"inputSizes": [self.inputs]},
            "OutputSizes": {"outputSizes": [len(self.outputs)]},
        }
        if call in plain:
            return plain[call]
        if not SUPPORTED.get(call):
            known = ", ".join(
                [*plain, *(name for name, supported in SUPPORTED.items() if supported)]
            )
            raise UnusableRequest(
                f"{call}: is not supported; accepted: {known}", "UnsupportedFeature"
            )
        inputs = request.get("input")
        if not isinstance(inputs, list) or len(inputs) != 1:
            raise UnusableRequest(
                f"input: {inputs!r} is not a list of one vector of {self.inputs} numbers"
            )
        vector = _vector("input[0]", inputs[0], self.inputs)
        if call == "Evaluate":
            return {"output": [self.values(vector).tolist()]}
        for key in ("outWrt", "inWrt"):
            if request.get(key) != 0:
                raise UnusableRequest(
                    f"{key}: {request.get(key)!r} is not accepted; 0 is the only vector"
                )
        key, size = ("sens", len(self.outputs)) if call == "Gradient" else ("vec", self.inputs)
        direction = np.array(_vector(key, request.get(key), size))
        jacobian = self.jacobian(vector)
        used = direction != 0 if call == "Gradient" else np.full(len(self.outputs), True)
        if not np.all(np.isfinite(jacobian[used])):
            missing = [
                self.outputs[k]
                for k in np.flatnonzero(used & ~np.all(np.isfinite(jacobian), axis=1))
            ]
            raise ArithmeticError(f"{', '.join(missing)}: no derivative at input = {list(vector)}")
        return {
            "output": (
                direction[used] @ jacobian[used] if call == "Gradient" else jacobian @ direction
            ).tolist()
        }


def um_bridge_server(function: ServedFunction, host: str, port: int) -> ThreadingHTTPServer:
    """A server of a function on a ``host`` name and ``port``, to be started by ``serve_forever``.

    It computes one answer at a time. ValueError for a host or port that cannot be used; port 0 is
    any that is free, ``server_port`` then.
    """
    lock = threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        """Answers the requests."""

        def do_GET(self) -> None:
            """The names of the models."""
            if self.path.strip("/") == "Info":
                self._send(200, {"protocolVersion": PROTOCOL, "models": [function.name]})
            else:
                self._send(
                    404,
                    _error("UnsupportedFeature", f"{self.path}: is not supported; accepted: /Info"),
                )

        def do_POST(self) -> None:
            """Every other call."""
            status, answer = 200, {}
            try:
                request = _read(self.rfile, self.headers.get("Content-Length"))
                with lock:
                    answer = function.answer(self.path.strip("/"), request)
            except UnusableRequest as problem:
                status, answer = 400, _error(problem.kind, one_line(problem))
            except ValueError as problem:
                status, answer = 400, _error("InvalidInput", one_line(problem))
            except ArithmeticError as problem:
                status, answer = 500, _error("ModelError", one_line(problem))
            except Exception as problem:
                traceback.print_exc()
                status, answer = 500, _error("InternalError", one_line(problem))
            self._send(status, answer)

        def _send(self, status, answer):
            encoded = json.dumps(answer, allow_nan=False).encode()
            try:
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(encoded)))
                self.end_headers()
                self.wfile.write(encoded)
            except ConnectionError:
                self.close_connection = True  # the caller has gone

        def log_message(self, *_: object) -> None:
            """Nothing: a sampler makes thousands of requests."""

    class Server(ThreadingHTTPServer):
        daemon_threads = True

    try:
        return Server((host, port), Handler)
    except (OSError, OverflowError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise ValueError(
            f"port: {port} of {host!r} cannot be used: {reason}; choose another --port or --host"
        ) from None


def _error(kind, text):
    return {"error": {"type": kind, "message": text}}


def _read(stream, length):
    """The JSON object of a request's body."""
    if length is None or not length.isdecimal() or int(length) > MAX_BYTES:
        raise UnusableRequest(
            f"request: the length {length!r} is not accepted; give at most {MAX_BYTES} bytes of "
            "JSON"
        )
    try:
        request = json.loads(stream.read(int(length)))
    except (ValueError, RecursionError) as problem:
        raise UnusableRequest(f"request: is not JSON: {one_line(problem)}") from None
    if not isinstance(request, dict):
        raise UnusableRequest(f"request: {request!r} is not a JSON object")
    return request


def _vector(where, value, size):
    """A list of ``size`` finite numbers as a tuple."""
    numbers = (
        value
        if isinstance(value, list) and all(type(x) in (int, float) for x in value)
        else [np.nan]
    )
    try:
        vector = tuple(map(float, numbers))
    except OverflowError:
        vector = (np.nan,)
    if len(vector) != size or not np.all(np.isfinite(vector)):
        raise UnusableRequest(f"{where}: {value!r} is not a list of {size} finite numbers")
    return vector
