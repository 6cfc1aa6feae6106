#!/usr/bin/env bash
# umbridge 1.2.10: a model that raises an exception, and one whose value is nan, are answered by text that is no JSON; the client reports a
# decoding error, not the model's.
#
# The protocol has an error object, {"error": {"type", "message"}}, which the client turns into an exception with that message. The package's
# own server sends a body that is no JSON instead, so that a sampler which drives the model cannot tell "this point has no value", which it
# may reject, from a broken server. A server of one's own that sends the error object reaches the client as intended.
# Seen: "raised: JSONDecodeError" for the exception; "nan: JSONDecodeError" for the value.
set -euo pipefail
work=$(mktemp -d)
trap 'kill "$server" 2>/dev/null || true; rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "umbridge==1.2.10"
cat >"$work/model.py" <<'PY'
import sys

import umbridge


class Root(umbridge.Model):
    """Square root with an exception below -1, and nan between -1 and 0."""

    def __init__(self):
        super().__init__("root")

    def get_input_sizes(self, config):
        return [1]

    def get_output_sizes(self, config):
        return [1]

    def supports_evaluate(self):
        return True

    def __call__(self, parameters, config):
        x = parameters[0][0]
        if x < -1:
            raise ValueError("x: below -1 there is no state")
        return [[x**0.5 if x >= 0 else float("nan")]]


umbridge.serve_models([Root()], int(sys.argv[1]))
PY
port=$("$work/venv/bin/python" -c "import socket; s = socket.socket(); s.bind(('', 0)); print(s.getsockname()[1])")
"$work/venv/bin/python" "$work/model.py" "$port" >"$work/log" 2>&1 &
server=$!
"$work/venv/bin/python" - "$port" <<'PY'
import sys
import time

import umbridge

url = f"http://127.0.0.1:{sys.argv[1]}"
for _ in range(100):
    try:
        model = umbridge.HTTPModel(url, "root")
        break
    except Exception:
        time.sleep(0.2)
assert model([[4.0]]) == [[2.0]]
seen = {}
for name, x in (("raised", -2.0), ("nan", -0.5)):
    try:
        seen[name] = f"value {model([[x]])}"
    except Exception as problem:
        seen[name] = type(problem).__name__
        assert "no state" not in str(problem), "the behaviour has changed: the model's message arrives"
    print(f"{name}: {seen[name]}")
assert all("Decode" in one for one in seen.values()), "the behaviour has changed"
PY
