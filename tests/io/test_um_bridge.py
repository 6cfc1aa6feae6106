"""The UM-Bridge server: values, derivatives, errors in one line, and survival of these."""

import json
import re
import threading
import urllib.error
import urllib.request

import numpy as np
import pytest

from jaxgel.io import ServedFunction, um_bridge_server


def values(vector):
    if vector[0] < 0:
        raise ValueError("x: -1 is not a number between\nlower = 0 and upper = 2")
    if vector[0] > 2:
        raise ArithmeticError("stopped after mu = -1")
    if vector[0] == 2:
        raise RuntimeError("a fault")
    return np.array([vector[0] * vector[1], vector[0] ** 2])


def jacobian(vector):
    """Of ``values``; that of the second value does not exist at x = 1."""
    values(vector)
    return np.array([[vector[1], vector[0]], [np.nan if vector[0] == 1 else 2 * vector[0], 0.0]])


@pytest.fixture(scope="module")
def server():
    with um_bridge_server(
        ServedFunction("forward", 2, ("product", "square"), values, jacobian), "localhost", 0
    ) as made:
        thread = threading.Thread(target=made.serve_forever, daemon=True)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def ask(server, call, body=None):
    """Status and answer of a request."""
    request = urllib.request.Request(f"http://localhost:{server.server_port}/{call}", data=body)
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.load(error)


def post(server, call, **entries):
    return ask(server, call, json.dumps({"name": "forward", "config": {}} | entries).encode())


def test_every_call_of_the_protocol_is_answered(server):
    assert ask(server, "Info") == (200, {"protocolVersion": 1.0, "models": ["forward"]})
    support = {"Evaluate": True, "Gradient": True, "ApplyJacobian": True, "ApplyHessian": False}
    assert post(server, "ModelInfo") == (200, {"support": support})
    assert post(server, "InputSizes") == (200, {"inputSizes": [2]})
    assert post(server, "OutputSizes") == (200, {"outputSizes": [2]})
    assert post(server, "Evaluate", input=[[3 / 2, 4]]) == (200, {"output": [[6.0, 2.25]]})
    at = dict(outWrt=0, inWrt=0, input=[[1.5, 4.0]])
    assert post(server, "Gradient", **at, sens=[1, 10]) == (200, {"output": [34.0, 1.5]})
    assert post(server, "ApplyJacobian", **at, vec=[1, 10]) == (200, {"output": [19.0, 3.0]})


def test_an_error_is_answered_in_one_line_and_the_server_goes_on(server, capsys):
    at = dict(outWrt=0, inWrt=0, input=[[1.0, 4.0]])
    for call, entries, status, kind, message in [
        (
            "Evaluate",
            dict(input=[[-1.0, 1.0]]),
            400,
            "InvalidInput",
            "x: -1 is not a number between lower = 0 and upper = 2",
        ),
        ("Evaluate", dict(input=[[3.0, 1.0]]), 500, "ModelError", "stopped after mu = -1"),
        ("Evaluate", dict(input=[[2.0, 1.0]]), 500, "InternalError", "a fault"),
        (
            "Evaluate",
            dict(input=[[1.0]]),
            400,
            "InvalidInput",
            r"input\[0\]: \[1\.0\] is not a list of 2 finite numbers",
        ),
        (
            "Evaluate",
            dict(input=[[1.0, float("nan")]]),
            400,
            "InvalidInput",
            r"input\[0\]: \[1\.0, nan\] is not a list of 2",
        ),
        (
            "Evaluate",
            dict(input=[[1, 10**400]]),
            400,
            "InvalidInput",
            "is not a list of 2 finite numbers",
        ),
        (
            "Evaluate",
            dict(input=[[1.0, True]]),
            400,
            "InvalidInput",
            "is not a list of 2 finite numbers",
        ),
        (
            "Evaluate",
            dict(input=[[1.0], [1.0]]),
            400,
            "InvalidInput",
            "is not a list of one vector of 2 numbers",
        ),
        (
            "Evaluate",
            dict(input=[[1.0, 1.0]], config={"steps": 3}),
            400,
            "InvalidInput",
            r"config: \{'steps': 3\} is not accepted",
        ),
        (
            "Evaluate",
            dict(input=[[1.0, 1.0]], name="posterior"),
            400,
            "ModelNotFound",
            "'posterior' is unknown; accepted: forward",
        ),
        (
            "Gradient",
            at | dict(sens=[1.0]),
            400,
            "InvalidInput",
            r"sens: \[1\.0\] is not a list of 2 finite numbers",
        ),
        (
            "Gradient",
            at | dict(sens=[1.0, 1.0]),
            500,
            "ModelError",
            r"square: no derivative at input = \[1\.0, 4\.0\]",
        ),
        (
            "Gradient",
            at | dict(sens=[1.0, 0.0], outWrt=1),
            400,
            "InvalidInput",
            "outWrt: 1 is not accepted; 0 is the only vector",
        ),
        ("ApplyJacobian", at | dict(vec=[1.0, 0.0]), 500, "ModelError", r"square: no derivative"),
        ("ApplyJacobian", at, 400, "InvalidInput", "vec: None is not a list of 2 finite numbers"),
        (
            "ApplyHessian",
            at,
            400,
            "UnsupportedFeature",
            "ApplyHessian: is not supported; accepted: .*Gradient, ApplyJacobian$",
        ),
    ]:
        found, answer = post(server, call, **entries)
        assert (found, answer["error"]["type"]) == (status, kind), (call, entries, answer)
        assert re.search(message, answer["error"]["message"]), (call, entries, answer)
        assert "\n" not in answer["error"]["message"]
    assert ask(server, "Evaluate", b"{")[1]["error"]["message"].startswith("request: is not JSON")
    assert (
        ask(server, "Evaluate", b"[]")[1]["error"]["message"] == "request: [] is not a JSON object"
    )
    assert ask(server, "Models")[0] == 404
    assert "RuntimeError: a fault" in capsys.readouterr().err  # with its traceback
    # of the value that has one
    assert post(server, "Gradient", **at, sens=[1.0, 0.0]) == (200, {"output": [4.0, 1.0]})


def test_a_port_that_is_taken_is_refused(server, refused):
    function = ServedFunction("forward", 2, ("product", "square"), values, jacobian)
    refused(
        lambda host, port: um_bridge_server(function, host, port),
        [
            (
                "localhost",
                server.server_port,
                (
                    f"port: {server.server_port} of 'localhost' cannot be used: .*; choose "
                    "another --port"
                ),
            ),
            ("localhost", 70000, "port: 70000 of 'localhost' cannot be used"),
        ],
    )
