"""A driver that writes turns the run red: seen by the kernel, and by the watch on every Python process."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import peers
from tests.peers import ROOT
from tests.scenario import wires
from tests.scenario.bold.bold import START
from tests.scenario.traces import bus_writes, forbidden
from tests.tracing import watch

pytestmark = pytest.mark.realtime

HERE = Path(__file__).parent


def test_run_with_a_driver_that_writes_ends_red_though_its_tests_pass() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(HERE / "planted.py")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert "1 passed" in done.stdout, done.stdout + done.stderr
    assert done.returncode == pytest.ExitCode.TESTS_FAILED
    where = "tests/scenario/planted.py::test_driver_reads_one_sample (call)"
    assert f"FORBIDDEN WRITE in {where}: to a serial line: 5a 45 52 4f" in done.stdout


def test_agent_with_a_driver_that_writes_is_seen_by_the_kernel_and_by_the_watch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    peers.program("strace", "strace")
    report = tmp_path / "report"
    monkeypatch.setenv(watch.REPORT, str(report))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE / "bold"), os.environ["PYTHONPATH"]]))
    played = wires.configure("tcp", tmp_path)
    config = played.with_name("bold.toml")
    config.write_text(played.read_text().replace('driver = "modbus"', 'driver = "bold"'), encoding="utf-8")
    document = wires.run([config], tmp_path / "live.db", tmp_path / "trace", played=[played])
    assert document["samples"]["used"] == 3000
    assert {write.data for write in forbidden(bus_writes(tmp_path / "trace"))} == {START}
    said = report.read_text(encoding="utf-8").splitlines()
    assert any(f"to an internet socket: {START.hex(' ')}" in line for line in said)
    assert any(re.fullmatch(r"permitted \d+", line) for line in said)
