"""SIGTERM ends every command with exit code 0, however early it comes, and leaves no process of the demo
behind."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.scenario.live import LIMIT_S, example, wait_until
from tests.sim.rigs import ROOT

pytestmark = pytest.mark.realtime


@contextmanager
def deltak(*args: str, scratch: str = "/tmp") -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "agent", *args], cwd=ROOT, env=os.environ | {"TMPDIR": scratch}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def listens(pid: int) -> bool:
    """Tell whether a process has a handler for SIGTERM."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt:")).split()[1]
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def children(pid: int) -> list[int]:
    """Return the processes that any thread of a process began."""
    begun = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in begun for child in task.read_text(encoding="ascii").split()]


def alive(pid: int) -> bool:
    with suppress(OSError):
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    return False


@pytest.mark.parametrize(
    "args",
    [["paper"], ["run", "no-such.toml"], ["replay", "a.toml", "a.csv"], ["score"], ["check", "a", "--probe"]],
)
def test_sigterm_before_the_command_has_begun_exits_0(args: list[str]) -> None:
    with deltak(*args) as process:
        wait_until(lambda: listens(process.pid), "a handler")
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, err) == (0, "deltak: ended by SIGTERM\n")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_demo_that_is_ended_leaves_no_process(number: int, tmp_path: Path) -> None:
    with deltak("demo", "--json", scratch=str(tmp_path)) as process:
        wait_until(lambda: len(children(process.pid)) == 2, "device and agent")
        started = children(process.pid)
        process.send_signal(number)
        out, _ = process.communicate(timeout=LIMIT_S)
        wait_until(lambda: not any(map(alive, started)), "the end of both")
    assert process.returncode == (0 if number == signal.SIGTERM else -number)
    assert ("ended by SIGTERM before it was done" in out) == (number == signal.SIGTERM)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_reestimation_that_is_ended_while_its_processes_begin_says_so_in_one_line(
    number: int, code: int, tmp_path: Path
) -> None:
    table = tmp_path / "table.csv"
    table.write_text("t,force,x1,x2\n" + "".join(f"{n / 1000:.3f},{n % 7},0,0\n" for n in range(2000)))
    config = example("modbus", tmp_path)
    with deltak("reestimate", str(table), "--config", str(config)) as process:
        wait_until(lambda: len(children(process.pid)) == 2, "what begins processes")
        process.send_signal(number)
        _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == code
    assert err == ("deltak: ended by SIGTERM\n" if code == 0 else "deltak: interrupted\n")
