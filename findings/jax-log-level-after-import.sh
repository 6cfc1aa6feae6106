#!/usr/bin/env bash
# jax 0.10.1: the variable for XLA's log level is read when JAX is imported, and JAX writes it into the process's environment.
#
# A program that decides after `import jax` how much XLA may log (a command line that has read its options, say) cannot do so by
# TF_CPP_MIN_LOG_LEVEL: setting it then changes nothing, although no backend has started and XLA_FLAGS is still read. JAX's own option
# jax_logging_level, which the manual describes for Python's loggers, reaches XLA's log too and may be set at any time. Importing JAX also
# sets the variable to 1, so that it is no sign of what the user asked for, and processes that are started later inherit it.
# Seen, lines that XLA logs: before the import 2 or more, after it 0, by jax_logging_level 2 or more; and the variable is "1" where it was unset.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "jax==0.10.1" "jaxlib==0.10.1"
unset TF_CPP_MIN_LOG_LEVEL JAX_LOGGING_LEVEL
export JAX_PLATFORMS=cpu

lines() { # number of lines of XLA's log that a process writes
    "$work/venv/bin/python" -c "$1" 2>&1 | grep -cE '^I[0-9]{4} .*pjrt_client' || true
}

run='jax.jit(lambda x: x + 1)(1.0)'
before=$(TF_CPP_MIN_LOG_LEVEL=0 lines "import jax; $run")
after=$(lines "import jax, os; os.environ['TF_CPP_MIN_LOG_LEVEL'] = '0'; $run")
option=$(lines "import jax; jax.config.update('jax_logging_level', 'INFO'); $run")
left=$("$work/venv/bin/python" -c "import jax, os; print(os.environ.get('TF_CPP_MIN_LOG_LEVEL'))")
echo "before the import $before, after it $after, by jax_logging_level $option; the variable: $left"
if [ "$before" -lt 1 ] || [ "$after" -ne 0 ] || [ "$option" -lt 1 ] || [ "$left" != 1 ]; then
    echo "the behaviour has changed" >&2
    exit 1
fi
