#!/bin/sh
# The Python package: builds the wheel, installs it in a virtual environment of its own and tests it there, with the
# examples of its documentation. Needs the program built (cargo build --bin esker), to compare with, and PyPI.
set -eu
cd "$(dirname "$0")/.."
: "${CARGO_TARGET_DIR:=${XDG_CACHE_HOME:-$HOME/.cache}/esker/target}"
export CARGO_TARGET_DIR
# From what Debian's setup installs, whatever else is on the path.
: "${ESKER_PYTHON:=/usr/bin/python3}"

venv=$CARGO_TARGET_DIR/python-venv
[ -x "$venv/bin/python" ] || "$ESKER_PYTHON" -m venv --clear "$venv"
if ! "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r python/requirements-test.txt; then
    echo "python: the packages of python/requirements-test.txt could not be installed; this step needs PyPI" >&2
    exit 1
fi
wheels=$CARGO_TARGET_DIR/python-wheels
rm -rf "$wheels"
"$venv/bin/maturin" build --locked --profile dev --manifest-path python/Cargo.toml --interpreter "$venv/bin/python" \
    --out "$wheels"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$wheels"/*.whl
: "${ESKER_PROGRAM:=$CARGO_TARGET_DIR/debug/esker}"
export ESKER_PROGRAM
"$venv/bin/python" -m pytest -q python/tests
