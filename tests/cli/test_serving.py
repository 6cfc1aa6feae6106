"""jaxgel serve: the client of the package umbridge gets jaxgel's numbers and exact derivatives."""

import contextlib
import http.server
import re
import threading

import numpy as np
import pytest
from studies import TINY

from jaxgel.cases import RESPONSES, Response, load_parameters
from jaxgel.cli import command_line as cli
from jaxgel.cli.serving import MODEL, served
from jaxgel.io import um_bridge_server
from jaxgel.observables import area_reduction, rotation_angle

STUDY = (
    TINY
    + """
[sweep]
mu_start = -4.0
mu_end = -3.0
steps = 2
contact = "off"
[[parameters]]
of = "chi"
lower = 0.0
upper = 0.3
[[parameters]]
of = "mu_end"
lower = -3.2
upper = -2.5
"""
)
HOLES = """
[[parameters]]
of = "radius"
lower = 1.0
upper = 1.2
[[parameters]]
of = "centre"
lower = [0.0, -0.3]
upper = [0.2, -0.1]
"""
POINT, MOVED = [0.1, -2.9], [1.08, 0.12, -0.18]


def response(folder, quantities, text=STUDY):
    (folder / "tiny.toml").write_text(text)
    study = load_parameters(folder / "tiny.toml")
    return Response(study, study.case.cloud(), quantities)


@contextlib.contextmanager
def connected(own):
    """The umbridge client of a server of a response."""
    umbridge = pytest.importorskip("umbridge")
    with um_bridge_server(served(own), "localhost", 0) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield umbridge.HTTPModel(f"http://localhost:{server.server_port}", MODEL)
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A response of parameters of the gel and of the sweep, and the client of its server."""
    own = response(tmp_path_factory.mktemp("serve"), ("rotation", "area_reduction"))
    with connected(own) as client:
        yield own, client


@pytest.mark.thorough
def test_the_client_gets_the_values_of_the_sweep(tiny):
    own, client = tiny
    assert (client.get_input_sizes(), client.get_output_sizes()) == ([2], [2])
    case = own.study.at({"chi": 0.1, "mu_end": -2.9})
    path = case.path(case.model(own.cloud))
    expected = [float(quantity(path)[-1]) for quantity in (rotation_angle, area_reduction)]
    assert path.value[-1] == -2.9
    assert client([POINT]) == [expected]


def check_derivatives(client, point, vec):
    """Gradients and the product of the Jacobian with ``vec`` agree with central differences."""
    # mm, kT: the error of a difference, h^2, and its round-off, 1e-12 / h, are below the tolerance
    h = 1e-5
    values = [
        [client([(np.array(point) + side * h * e).tolist()])[0] for side in (1, -1)]
        for e in np.eye(len(point))
    ]
    differences = np.array([(np.array(ahead) - behind) / (2 * h) for ahead, behind in values]).T
    for row, sens in zip(differences, np.eye(2).tolist(), strict=True):
        np.testing.assert_allclose(
            client.gradient(0, 0, [point], sens), row, rtol=1e-6, atol=1e-6 * np.abs(row).max()
        )
    np.testing.assert_allclose(
        client.apply_jacobian(0, 0, [point], vec), differences @ vec, rtol=1e-6
    )


@pytest.mark.slow
def test_gradient_and_jacobian_agree_with_differences(tiny):
    check_derivatives(tiny[1], POINT, [2.0, 1.0])


@pytest.mark.slow
def test_gradient_and_jacobian_by_holes_agree_with_differences(tmp_path):
    with connected(response(tmp_path, ("rotation", "area_reduction"), STUDY + HOLES)) as client:
        check_derivatives(client, POINT + MOVED, [2.0, 1.0, 0.3, -1.0, 0.5])


@pytest.mark.thorough
def test_the_client_gets_errors_in_one_line_and_then_values_again(tiny):
    _, client = tiny
    with pytest.raises(
        Exception,
        match=r"InvalidInput: chi: 0\.4 is not a number between lower = 0 and upper = 0\.3$",
    ):
        client([[0.4, POINT[1]]])
    with pytest.raises(Exception, match=r"input\[0\]: .* is not a list of 2 finite numbers"):
        client([POINT[:1]])
    assert len(client([POINT])[0]) == 2


@pytest.mark.slow
def test_a_quantity_without_a_value_is_an_error(tmp_path):
    own = response(tmp_path, RESPONSES)  # the core of this plate lies in its hole
    path = own.path(POINT)
    with pytest.raises(ArithmeticError, match="core_rotation: has no value"):
        own.values(path)
    rows = np.isfinite(own.jacobian(POINT, path)).all(axis=1)
    assert rows.tolist() == [False, True, True]


def test_the_command_says_what_it_serves(tmp_path, monkeypatch, capsys):
    def interrupted(_):
        raise KeyboardInterrupt

    (tmp_path / "tiny.toml").write_text(STUDY)
    monkeypatch.setattr(http.server.ThreadingHTTPServer, "serve_forever", interrupted)
    assert cli.main(["serve", str(tmp_path / "tiny.toml"), "--port", "4287"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "tiny: chi, mu_end -> core_rotation, rotation, area_reduction"
    assert lines[1] == "UM-Bridge model 'forward' at http://localhost:4287; Ctrl-C ends it"


def test_unusable_arguments_are_refused(tmp_path, capsys):
    (tmp_path / "tiny.toml").write_text(STUDY)
    (tmp_path / "bare.toml").write_text(TINY)
    for arguments, message in [
        (
            ["tiny.toml", "--quantities", "rotaton"],
            "quantities: 'rotaton' is unknown; did you mean 'rotation'?",
        ),
        (
            ["tiny.toml", "--port", "0"],
            "port: 0 is not accepted, it must be at least 1 and at most 65535",
        ),
        (
            ["tiny.toml", "--prot", "1"],
            r"'--prot' is not an option of serve; did you mean '--port'?",
        ),
        (["bare.toml"], "study: parameters is missing"),
        (["none.toml"], "study: cannot read"),
    ]:
        assert cli.main(["serve", str(tmp_path / arguments[0]), *arguments[1:]]) == 2
        assert re.search(re.escape(message), capsys.readouterr().err), message
