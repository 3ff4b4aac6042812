"""The CAN path over a real kernel bus: here where the kernel has CAN, in a guest where it has not."""

import os
import re
import socket
import subprocess
import sys

import pytest

from tests import figures
from tests.peers import ROOT, program
from tests.vcan import guest

INSIDE = ("tests/vcan/inside.py", "tests/vcan/inside_batches.py", "tests/vcan/inside_slcan.py")
CHAOS = "tests/vcan/inside_chaos.py"
LIMIT_S = 170.0
pytestmark = [pytest.mark.realtime, pytest.mark.timeout(LIMIT_S + 10.0)]


def kernel_has_vcan() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return "vcan0" in [name for _, name in socket.if_nameindex()]


def run(*files: str, limit_s: float = LIMIT_S, **environment: str) -> str:
    """Run tests where there is a bus; return what they print."""
    for name in ("candump", "cangen", "canplayer", "cansend"):
        program(name, "can-utils")
    options = ["-q", "-p", "no:cacheprovider", "--no-header", f"--timeout={limit_s:.0f}"]
    command = [sys.executable, "-m", "pytest", *options, *files]
    if kernel_has_vcan():
        done = subprocess.run(
            command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, timeout=limit_s,
            check=False,
        )  # fmt: skip
        status, output = done.returncode, done.stdout + done.stderr
    else:
        settings = [f"{name}={value}" for name, value in environment.items()]
        status, output = guest.run(["env", *settings, *command] if settings else command, ROOT, limit_s)
    sys.stdout.write(output)
    assert status == 0, output
    assert "skipped" not in output
    return output


def passed(output: str) -> int:
    found = re.search(r"(\d+) passed", output)
    assert found is not None
    return int(found[1])


def tell(output: str) -> None:
    """Pass on what was measured inside."""
    for line in output.splitlines():
        if line.startswith("CAN, "):
            figures.figure(f"the kernel's bus: {line}")


@pytest.fixture(scope="module")
def inside() -> str:
    """What every test inside printed: to boot a guest and to import there takes as long as the tests."""
    return run(CHAOS, *INSIDE, DELTAK_CYCLES="5")


def test_can_path_over_a_kernel_bus_passes_every_test_inside(inside: str) -> None:
    assert passed(inside) > 50


def test_kernel_buses_that_go_and_return_again_and_again_are_read_in_time(inside: str) -> None:
    assert "CAN, 5 outages each, " in inside
    tell(inside)


@pytest.mark.soak
@pytest.mark.timeout(3700)
def test_kernel_buses_that_go_and_return_two_hundred_times_are_read_in_time() -> None:
    output = run(CHAOS, limit_s=3600.0, DELTAK_CYCLES="200")
    assert passed(output) == 1
    tell(output)
