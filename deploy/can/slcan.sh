#!/bin/sh
# An slcan adapter as the kernel's interface can0: slcan.sh /dev/serial/by-id/usb-... 500000
# Listen-only, so that the agent cannot disturb the bus; leave it out only where nobody else acknowledges the device's
# frames. slcand is in the package can-utils; the kernel needs the module slcan (6.0 and newer know listen-only).
set -eu
modprobe slcan
slcand "$1" can0
ip link set can0 type can bitrate "$2" listen-only on
ip link set can0 up
