#!/bin/sh
# Makes sure that a fresh Debian or Ubuntu machine has what Esker's build and pictures need.
# As root it installs what is missing; otherwise it says what to install and stops.
set -eu

missing=""
command -v cc >/dev/null 2>&1 || missing="$missing build-essential"
# A Vulkan driver: any installed one will do, software (lavapipe) included.
if ! ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json >/dev/null 2>&1; then
    missing="$missing mesa-vulkan-drivers"
fi
if ! ldconfig -p 2>/dev/null | grep -q 'libvulkan\.so\.1'; then
    missing="$missing libvulkan1"
fi
# Python with virtual environments, for the tests of the wheel.
"${ESKER_PYTHON:-/usr/bin/python3}" -c 'import ensurepip' >/dev/null 2>&1 || missing="$missing python3-venv"

# The window's libraries, which are looked for when it opens, and a display for its test.
for library in libxkbcommon.so.0:libxkbcommon0 libxkbcommon-x11.so.0:libxkbcommon-x11-0 libX11.so.6:libx11-6 \
    libX11-xcb.so.1:libx11-xcb1 libXcursor.so.1:libxcursor1 libXi.so.6:libxi6 libXrandr.so.2:libxrandr2 \
    libwayland-client.so.0:libwayland-client0; do
    if ! ldconfig -p 2>/dev/null | grep -q "${library%%:*}"; then
        missing="$missing ${library##*:}"
    fi
done
command -v Xvfb >/dev/null 2>&1 || missing="$missing xvfb"

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
