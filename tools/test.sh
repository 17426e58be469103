#!/bin/sh
# Runs every check of the project: format, lints, tests, doc tests, examples, the Python package. Sets the machine up first.
#
# Real point clouds are read from ../shared/data or $ESKER_DATA if they are there; a bare clone tests without them.
# ESKER_SWEEP=1 adds the long sweeps (see docs/testing.md).
set -eu
cd "$(dirname "$0")/.."
sh tools/setup.sh tests

# Outside the clone, so that it survives between fresh clones.
: "${CARGO_TARGET_DIR:=${XDG_CACHE_HOME:-$HOME/.cache}/esker/target}"
: "${XDG_RUNTIME_DIR:=${TMPDIR:-/tmp}}"
export CARGO_TARGET_DIR XDG_RUNTIME_DIR

step() {
    echo "== $*" >&2
    "$@"
}

step cargo fmt --all --check
step cargo clippy --locked --all-targets -- -D warnings
step cargo clippy --locked --no-default-features -- -D warnings
step cargo clippy --locked --package esker-python -- -D warnings
step cargo build --locked --bin esker
step cargo test --locked --doc
step cargo build --locked --examples
if cargo nextest --version >/dev/null 2>&1; then
    step cargo nextest run --locked --no-fail-fast
else
    # One that measures the memory of its process needs that for itself; nextest gives each test its own.
    alone=an_answer_under_a_capacity_takes_the_memory_of_a_few_pieces
    step cargo test --locked --lib --bins --tests -- --skip "$alone"
    step cargo test --locked --test it -- "$alone"
fi
step sh tools/python.sh
