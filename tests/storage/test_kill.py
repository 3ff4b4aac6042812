"""kill -9 of the writing process at any moment. The reader of its output notes what was acknowledged."""

import os
import select
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from agent.storage.database.connect import connect_reader
from agent.storage.write.store import Store
from tests import peers
from tests.figures import figure
from tests.storage.powercut.workload import PROFILES, START


class Nursery:
    """Lives of the writing process, one after another."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "tests.storage.powercut.nursery"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=peers.ROOT, bufsize=0
        )
        self._reported = b""

    def begin(self, path: Path, profile: str, until: Callable[[list[bytes]], bool]) -> int:
        """Start a life and read until a condition on its lines holds; returns its process id."""
        assert self._process.stdin is not None
        self._reported = b""
        self._process.stdin.write(f"{path} {profile}\n".encode())
        lines = self.read(lambda reported: bool(reported) and until(reported), 30.0)
        return int(lines[0].split()[1])

    def read(self, until: Callable[[list[bytes]], bool], deadline_s: float) -> list[bytes]:
        """Read lines until a condition holds or the time is over; returns all lines of this life."""
        assert self._process.stdout is not None
        end = time.monotonic() + deadline_s
        while not until(self.lines):
            left = end - time.monotonic()
            if left <= 0 or not select.select([self._process.stdout], [], [], left)[0]:
                break
            more = os.read(self._process.stdout.fileno(), 65536)
            assert more, "the nursery ended"
            self._reported += more
        return self.lines

    @property
    def lines(self) -> list[bytes]:
        return self._reported.split(b"\n")[:-1]

    def kill(self, pid: int) -> list[bytes]:
        """Kill the life; return every whole line that it had told."""
        os.kill(pid, signal.SIGKILL)
        reported = self.read(
            lambda lines: lines[-1:] == [b"dead"] or self._reported.endswith(b"dead\n"), 30.0
        )
        assert self._reported.endswith(b"dead\n")
        return reported[:-1]

    def end(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(30)
        self._process.stdout.close()


@pytest.fixture(scope="module")
def nursery() -> Iterator[Nursery]:
    made = Nursery()
    yield made
    made.end()


def missing_of(reader: sqlite3.Connection, run_id: int, hops: int, profile: str) -> int:
    """Return how many of the first `hops` hops of a run are not there whole, but for those purged by age."""
    hop_ns = PROFILES[profile].hop_ns
    kept = reader.execute(
        "SELECT coalesce(full_from_ns, -9e18) FROM runs WHERE seq = ?", (run_id,)
    ).fetchone()[0]
    query = (
        "SELECT count(*), sum((SELECT count(*) FROM estimates e "
        "WHERE e.seq BETWEEN h.seq << 10 AND (h.seq << 10) + 1023)) "
        "FROM hops h WHERE h.run_id = ? AND h.span = 0 AND h.t_ns >= ? AND h.t_ns < ?"
    )
    end = START + hops * hop_ns
    found, cells = reader.execute(query, (run_id, kept, end)).fetchone()
    expected = max(0, hops - max(0, -(-(int(kept) - START) // hop_ns)))
    return max(0, expected - found) + max(0, 4 * expected - (cells or 0))


@pytest.mark.parametrize(
    ("profile", "kills"),
    [("live", 40), ("bulk", 30), ("keep", 30)]
    + [pytest.param(name, 250, marks=[pytest.mark.soak, pytest.mark.timeout(3600)]) for name in PROFILES],
)
def test_kill_of_the_writer_at_any_moment_loses_nothing_acknowledged(
    nursery: Nursery, memory: Path, rng: np.random.Generator, profile: str, kills: int
) -> None:
    path = memory / "rig.db"
    lives: list[tuple[int, int]] = []
    acknowledged = 0
    for number in range(kills):
        if number % 10 == 0:
            path = memory / f"rig-{number}.db"
            lives.clear()
        pid = nursery.begin(path, profile, lambda reported: len(reported) > 1)
        nursery.read(lambda _: False, float(rng.uniform(0.0, 0.06)))
        _, run, *reported = nursery.kill(pid)
        lives.append((int(run.split()[1]), len(reported) * PROFILES[profile].hops))
        acknowledged += len(reported)
        reader = connect_reader(path)
        assert sum(missing_of(reader, run_id, hops, profile) for run_id, hops in lives[-3:]) == 0
        reader.close()
    with Store.open(path, PROFILES[profile].keep) as store:
        assert store.recovery is None
        assert sum(missing_of(store.connection, run_id, hops, profile) for run_id, hops in lives) == 0
    figure(
        f"kill -9 of the writer, {profile}: {kills} kills, none of {acknowledged} acknowledged writes lost"
    )
    assert acknowledged > kills


@pytest.mark.parametrize("kills", [10, pytest.param(100, marks=pytest.mark.soak)])
def test_kill_during_the_first_start_leaves_a_file_that_opens(
    nursery: Nursery, memory: Path, rng: np.random.Generator, kills: int
) -> None:
    for number in range(kills):
        path = memory / f"rig-{number}.db"
        pid = nursery.begin(path, "live", lambda reported: len(reported) > 0)
        nursery.read(lambda _: False, float(rng.uniform(0.0, 0.04)))
        nursery.kill(pid)
        with Store.open(path) as store:
            assert store.recovery is None
