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


def test_agent_on_a_line_of_frames_with_ends_opens_it_to_read_only_and_writes_nothing_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    peers.program("strace", "strace")
    monkeypatch.setattr(wires, "SYSTEM_CALLS", f"openat,{wires.SYSTEM_CALLS}")
    document = wires.run([wires.configure("cobs", tmp_path)], tmp_path / "live.db", tmp_path / "trace")
    assert document["samples"]["used"] == 3000
    lines = (tmp_path / "trace").read_text(encoding="ascii").splitlines(keepends=True)
    path = "".join(f"\\x{byte:02x}" for byte in b"demo.tty")
    opened = [line for line in lines if f'{path}"' in line and "openat(" in line]
    assert opened
    assert all("O_RDONLY|O_NOCTTY|O_NONBLOCK" in line for line in opened), opened
    (tmp_path / "writes").write_text(
        "".join(line for line in lines if "openat" not in line), encoding="ascii"
    )
    assert bus_writes(tmp_path / "writes") == []
