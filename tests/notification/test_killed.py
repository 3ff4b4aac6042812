"""Agents killed again and again while targets fail: in the end each step was taken by each target, once, in
order."""

import os
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.figures import figure
from tests.notification.lives import FRESH, targets
from tests.notification.targets import MailRoom, Post, agent, mail_server, webhook
from tests.notification.test_notifications import FATES, keys_of, settled
from tests.peers import ROOT
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import select

__all__ = ["memory"]
KILLS = 20
FAILURES = 50
pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]


@pytest.fixture
def lives() -> "Iterator[subprocess.Popen[str]]":
    command = [sys.executable, "-m", "tests.notification.lives"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT, text=True)
    yield process
    process.communicate(timeout=30)


def live(process: "subprocess.Popen[str]", line: str, delay_s: float) -> None:
    """Have one agent raise its alarms, and kill it a while after."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{line}\n")
    process.stdin.flush()
    pid = int(process.stdout.readline().split()[1])
    assert process.stdout.readline() == "raised\n"
    threading.Event().wait(delay_s)
    os.kill(pid, signal.SIGKILL)
    assert process.stdout.readline() == "dead\n"


def test_each_step_reaches_each_target_once_over_twenty_kills_and_fifty_failures(
    lives: "subprocess.Popen[str]", memory: Path
) -> None:
    rng, path = random.Random(11), memory / "rig.db"
    hook = Post([fate for _ in range(FAILURES) for fate in (rng.choice(FATES[:5]), "fine")])
    room = MailRoom(Post([fate for _ in range(FAILURES) for fate in ("451", "fine")]))
    count = 2 * FRESH * KILLS
    with webhook(hook) as url, mail_server(room) as port:
        for number in range(KILLS):
            live(lives, f"{path} {url} {port} {number * FRESH}", rng.uniform(0.0, 0.5))
        left = [state for (state,) in select(path, "SELECT state FROM v_notifications")].count("pending")
        with agent(path, targets(url, port)):
            wait_until(lambda: settled(path, count), "all to be delivered", 180)
    keys = keys_of(path)
    assert len(keys) == FRESH * KILLS
    assert hook.accepted == keys
    assert room.post.accepted == [f"<{key}@deltak>" for key in keys]
    tries = len(hook.attempts) + len(room.post.attempts)
    figure(f"{KILLS} agents killed among {tries - count} failed or repeated tries: {count} notifications, "
           f"each once, in order; {left} of them were left to the last agent")  # fmt: skip
    assert tries - count >= FAILURES
