"""kill -9 between an acknowledgement and its answer: an answered one is never lost, another is whole or not
at all."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
import pytest

from agent.errors import StoreError
from agent.storage.operations import command_alarms
from agent.storage.write.alarm_commands import Request
from tests.figures import figure
from tests.peers import ROOT
from tests.storage.commanded import FRESH
from tests.storage.rows import select

KILLS = 500


@pytest.fixture
def lives() -> "Iterator[subprocess.Popen[str]]":
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.storage.commanded"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        cwd=ROOT,
        text=True,
    )  # fmt: skip
    yield process
    assert process.stdin is not None
    process.stdin.close()
    process.wait(30)
    assert process.stdout is not None
    process.stdout.close()


def line(stream: IO[str] | None) -> str:
    assert stream is not None
    return stream.readline().strip()


def live(process: "subprocess.Popen[str]", path: Path, delay_s: float) -> tuple[set[int], set[int]]:
    """Acknowledge the fresh alarms of one life one by one until it is killed; return those answered, those
    asked."""
    assert process.stdin is not None
    process.stdin.write(f"{path}\n")
    process.stdin.flush()
    pid = int(line(process.stdout).split()[1])
    assert line(process.stdout) == "ready"
    newest = select(path, "SELECT max(id) FROM v_alarms")[0][0]
    killer = threading.Timer(delay_s, os.kill, (pid, signal.SIGKILL))
    killer.start()
    answered: set[int] = set()
    asked: set[int] = set()
    try:
        for alarm in range(newest - FRESH + 1, newest + 1):
            asked.add(alarm)
            command_alarms(path, Request("acknowledge", (alarm,), "eva", f"{alarm}"))
            answered.add(alarm)
    except (StoreError, OSError):
        pass  # killed meanwhile: this one was not answered
    killer.join()
    assert line(process.stdout) == "dead"
    return answered, asked


def kill(lives: "subprocess.Popen[str]", path: Path, count: int) -> int:
    """Kill so many lives; return how many acknowledgements were cut off."""
    rng, answered, asked = np.random.default_rng(11), set[int](), set[int]()
    for _ in range(count):
        done, tried = live(lives, path, float(rng.uniform(0.005, 0.12)))
        answered, asked = answered | done, asked | tried
    acked = {
        row[0] for row in select(path, "SELECT id FROM v_alarms WHERE state = 'ACKED' AND acked_by = 'eva'")
    }
    said = select(path, "SELECT alarm_id, comment FROM v_alarm_events WHERE cause = 'acknowledge'")
    assert answered <= acked <= asked
    assert sorted(said) == [(alarm, f"{alarm}") for alarm in sorted(acked)]
    return len(asked - answered)


def test_answered_acknowledgement_outlives_a_kill(lives: "subprocess.Popen[str]", memory: Path) -> None:
    kill(lives, memory / "rig.db", 6)


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_answered_acknowledgement_outlives_five_hundred_kills(
    lives: "subprocess.Popen[str]", tmp_path: Path
) -> None:
    begun = time.monotonic()
    cut_off = kill(lives, tmp_path / "rig.db", KILLS)
    seconds = time.monotonic() - begun
    figure(
        f"{KILLS} agents killed while they acknowledged: {cut_off} answers cut off, "
        f"none lost, {seconds:.0f} s"
    )
    assert cut_off > KILLS // 10
