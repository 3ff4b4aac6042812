#!/bin/sh
# Installs the independent programs that the tests talk to, where apt-get can: root on Debian. Quick when all are there.
# Where it cannot, the tests that need them say so in the run's last lines. Arguments: further packages.
set -eu

wanted="can-utils user-mode-linux kmod iproute2 mbpoll socat strace systemd libmodbus-dev gcc libc6-dev chromium chromium-driver mosquitto prometheus $*"

if ! command -v apt-get >/dev/null || [ "$(id -u)" -ne 0 ]; then
    echo "install_peers: not root on Debian; nothing installed" >&2
    exit 0
fi

lacking=""
for package in $wanted; do
    # a nodejs of others brings its own npm, beside which Debian's cannot be installed
    if [ "$package" = npm ] && command -v npm >/dev/null; then continue; fi
    dpkg-query -W -f '${db:Status-Abbrev}' "$package" 2>/dev/null | grep -q '^ii' || lacking="$lacking $package"
done
if [ -n "$lacking" ]; then
    export DEBIAN_FRONTEND=noninteractive
    export RUNLEVEL=1  # brokers and databases are started by the tests that need them, and by nothing else
    echo "install_peers: installing$lacking" >&2
    apt-get update -qq
    # A package that a release does not have must not keep the others from being installed.
    for package in $lacking; do
        apt-get install -qq -y --no-install-recommends "$package" >/dev/null || echo "install_peers: no $package here" >&2
    done
fi

# An independent decoder of Sparkplug's payloads, into the environment that `make` made.
decoder=sparkplug-payload@1.0.3
if command -v npm >/dev/null && [ -d .venv ] && [ ! -d .venv/node/node_modules/sparkplug-payload ]; then
    echo "install_peers: installing $decoder" >&2
    npm install --silent --no-audit --no-fund --ignore-scripts --prefix .venv/node "$decoder" >/dev/null ||
        echo "install_peers: no $decoder here" >&2
fi
