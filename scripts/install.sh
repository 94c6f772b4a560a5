#!/bin/sh
# Create .venv with designlab, its extras and the exact versions of constraints.txt.
set -eu
cd "$(dirname "$0")/.."

fail() {
    echo "install: $1" >&2
    exit 1
}

is_recent() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

find_python() {
    if [ -n "${PYTHON:-}" ]; then
        is_recent "$PYTHON" || fail "PYTHON=$PYTHON is not Python 3.11 or newer"
        echo "$PYTHON"
        return
    fi
    for candidate in python3 python3.13 python3.12 python3.11 python3.14; do
        if is_recent "$candidate"; then
            echo "$candidate"
            return
        fi
    done
    fail "needs Python 3.11 or newer (python3 is $(python3 -V 2>&1 || true)); set PYTHON=/path/to/python3"
}

if ! is_recent .venv/bin/python; then
    python=$(find_python)
    "$python" -c 'import ensurepip, venv' >/dev/null 2>&1 ||
        fail "$python has no venv module; on Debian and Ubuntu: sudo apt-get install python3-venv"
    rm -rf .venv
    "$python" -m venv .venv
fi

echo "installing into .venv (some minutes the first time) ..."
# Of some 3 GB of packages few are ever imported; Python compiles those when they are.
.venv/bin/python -m pip install -qq --no-input --disable-pip-version-check --no-compile \
    -c constraints.txt -e '.[mesh,dev]' || fail "pip failed; the network is needed for the first run"
