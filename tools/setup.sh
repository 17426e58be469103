#!/bin/sh
# Makes sure that a fresh Debian or Ubuntu machine has what Esker's build, pictures and window need.
# As root it installs what is missing; otherwise it says what to install and stops.
#
# usage: tools/setup.sh [tests]      tests: what the tests need, too
set -eu

missing=""
command -v cc >/dev/null 2>&1 || missing="$missing build-essential"
# A Vulkan driver: any installed one will do, software (lavapipe) included.
if [ -z "$(find /usr/share/vulkan/icd.d /etc/vulkan/icd.d -name '*.json' 2>/dev/null)" ]; then
    missing="$missing mesa-vulkan-drivers"
fi
if ! ldconfig -p 2>/dev/null | grep -q 'libvulkan\.so\.1'; then
    missing="$missing libvulkan1"
fi
# The window's libraries, which are looked for when it opens.
for library in libxkbcommon.so.0:libxkbcommon0 libxkbcommon-x11.so.0:libxkbcommon-x11-0 libX11.so.6:libx11-6 \
    libX11-xcb.so.1:libx11-xcb1 libXcursor.so.1:libxcursor1 libXi.so.6:libxi6 libXrandr.so.2:libxrandr2 \
    libwayland-client.so.0:libwayland-client0; do
    if ! ldconfig -p 2>/dev/null | grep -q "${library%%:*}"; then
        missing="$missing ${library##*:}"
    fi
done
if [ "${1:-}" = tests ]; then
    # A display for the window's test; Python with virtual environments for those of the wheel.
    command -v Xvfb >/dev/null 2>&1 || missing="$missing xvfb"
    "${ESKER_PYTHON:-/usr/bin/python3}" -c 'import ensurepip' >/dev/null 2>&1 || missing="$missing python3-venv"
fi

if [ -n "$missing" ]; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
        echo "setup: installing$missing" >&2
        # shellcheck disable=SC2086
        (apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $missing) >&2
    else
        echo "setup: please install:$missing (Debian/Ubuntu: sudo apt-get install$missing)" >&2
        exit 1
    fi
fi

if ! command -v cargo >/dev/null 2>&1; then
    echo "setup: cargo is missing: install Rust 1.95 or later from https://rustup.rs" >&2
    exit 1
fi
