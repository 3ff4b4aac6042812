"""A server with 500 slow listeners, killed again and again, beside an agent on a bus: not a sample is lost to
it."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.figures import figure
from tests.scenario import live
from tests.web.server import serving

pytestmark = [pytest.mark.soak, pytest.mark.timeout(300)]
SECONDS = 20.0
LISTENERS = 500
SCENARIO = """
[[force]]
kind = "random"
rms = 5.0
[noise]
displacement = 1e-6
[[change]]
at_s = 300.0
delta = { k1 = 5.0 }
"""


@contextmanager
def bus(config: Path) -> Iterator[None]:
    scenario = config.with_name("motion.toml")
    scenario.write_text(SCENARIO, encoding="utf-8")
    command = [sys.executable, "-m", "agent", "sim", str(config), "--scenario", str(scenario)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "ready"
        try:
            yield
        finally:
            process.kill()


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used."""
    cells = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(cells[11]) + int(cells[12])) / os.sysconf("SC_CLK_TCK")


def crowd(port: int) -> list[socket.socket]:
    """Connect listeners that never read."""
    peers = [socket.create_connection(("127.0.0.1", port), timeout=30) for _ in range(LISTENERS)]
    for peer in peers:
        peer.sendall(b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    return peers


def disturb(db: Path) -> None:
    """Serve to a crowd and kill the server, twice within the time."""
    for _ in range(2):
        with serving("--db", db) as client:
            peers = crowd(client.port)
            end = time.monotonic() + SECONDS / 2
            while time.monotonic() < end:
                assert client.get("latest")["rows"]
                time.sleep(0.2)
            os.kill(client.pid, signal.SIGKILL)
            for peer in peers:
                with suppress(OSError):
                    peer.close()


def test_agent_loses_nothing_to_a_crowd_and_a_killed_server(tmp_path: Path) -> None:
    config, db = live.example("modbus", tmp_path), tmp_path / "rig.db"
    with bus(config), live.agent(config, options=["--db", str(db)]) as agent:
        live.wait_until(lambda: live.hops(db) > 20, "rows")
        pid, used = agent.process.pid, []
        for disturbed in (False, True):
            before = cpu_s(pid)
            if disturbed:
                disturb(db)
            else:
                time.sleep(SECONDS)
            used.append(cpu_s(pid) - before)
        document = agent.document()
    samples = document["samples"]
    figure(
        f"agent beside {LISTENERS} slow listeners: {samples}, "
        f"{used[1] / used[0]:.2f} of the processor time without"
    )
    assert samples["received"] == samples["used"] > 2 * SECONDS * 500
    assert (samples["dropped"], samples["gaps"]) == ({}, 0)
