#!/bin/sh
# Installs the independent programs that the tests talk to, where apt-get can: root on Debian. Quick when all are there.
# Where it cannot, the tests that need them say so in the run's last lines. Arguments: further packages.
set -eu

wanted="can-utils user-mode-linux kmod iproute2 mbpoll socat strace systemd libmodbus-dev gcc libc6-dev chromium chromium-driver $*"

if ! command -v apt-get >/dev/null || [ "$(id -u)" -ne 0 ]; then
    echo "install_peers: not root on Debian; nothing installed" >&2
    exit 0
fi

lacking=""
for package in $wanted; do
    dpkg-query -W -f '${db:Status-Abbrev}' "$package" 2>/dev/null | grep -q '^ii' || lacking="$lacking $package"
done
[ -n "$lacking" ] || exit 0

export DEBIAN_FRONTEND=noninteractive
echo "install_peers: installing$lacking" >&2
apt-get update -qq
# A package that a release does not have must not keep the others from being installed.
for package in $lacking; do
    apt-get install -qq -y --no-install-recommends "$package" >/dev/null || echo "install_peers: no $package here" >&2
done
