"""The CAN path over a real kernel bus: here where the kernel has CAN, in a guest where it has not."""

import re
import socket
import subprocess
import sys

import pytest

from tests.peers import ROOT, program
from tests.vcan import guest

pytestmark = pytest.mark.realtime

INSIDE = ("tests/vcan/inside.py", "tests/vcan/inside_batches.py", "tests/vcan/inside_slcan.py")
LIMIT_S = 110.0


def kernel_has_vcan() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return "vcan0" in [name for _, name in socket.if_nameindex()]


def test_can_path_over_a_kernel_bus_passes_every_test_inside() -> None:
    for name in ("candump", "cangen", "canplayer"):
        program(name, "can-utils")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", *INSIDE]
    if kernel_has_vcan():
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        status, output = done.returncode, done.stdout + done.stderr
    else:
        status, output = guest.run(command, ROOT, LIMIT_S)
    sys.stdout.write(output)
    assert status == 0, output
    passed = re.search(r"(\d+) passed", output)
    assert passed is not None
    assert int(passed[1]) >= 19
    assert "skipped" not in output
