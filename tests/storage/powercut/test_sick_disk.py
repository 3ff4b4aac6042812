"""Every operation on files fails once, several times, or until the disk is mended: the writer goes on and
says so."""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from agent.errors import StoreError
from agent.storage.database.connect import connect_reader
from agent.storage.write.store import Store
from tests import peers
from tests.figures import figure
from tests.storage.powercut.disk import cuts, read_log
from tests.storage.powercut.test_powercut import Starts
from tests.storage.powercut.workload import PROFILES, records
from tests.storage.rows import batch, run_info, step

WRITES = 8
EXPENDABLE = re.compile(r"|.*\.(ballast|lock)|U .*\.new-(wal|journal|shm)|[OD] .*/trial|[WT] .*-shm")
"""What may fail without anybody being told.

Room in reserve, who holds the lock, what is deleted before it is made, SQLite's own sync of the folder (ours
is told, once at least), what lies in memory shared and is made anew from the log.
"""


@dataclass(frozen=True)
class Life:
    """What one process on the failing disk told."""

    acknowledged: list[int]
    failed: str
    seen: dict[str, int]
    dropped: int


class Ward:
    """Processes on a failing disk, one after another."""

    def __init__(self, shim: Path, folder: Path) -> None:
        self.folder, self.log = folder / "work", folder / "log"
        self.folder.mkdir()
        environment = {
            **os.environ, "LD_PRELOAD": str(shim), "DELTAK_OPLOG_ROOT": str(self.folder),
            "DELTAK_OPLOG": str(self.log),
        }  # fmt: skip
        command = [sys.executable, "-m", "tests.storage.powercut.sick"]
        self._process = subprocess.Popen(
            command, cwd=peers.ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip

    def live(self, path: Path, kind: str, error: int, first: int, count: int, **changes: object) -> Life:
        """Let one process write; operations `first` to `first + count` of a kind fail."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        asked = {"path": str(path), "kind": kind, "error": error, "first": first, "count": count, "number": 0,
                 "writes": WRITES, "stop": True, "patience_s": 10.0} | changes  # fmt: skip
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        lines: list[str] = []
        while not lines or not lines[-1].startswith("dead"):
            lines.append(self._process.stdout.readline().strip())
            assert lines[-1], f"no answer after {lines}"
        assert lines[-1] == "dead 0", "the agent's process must not end"
        words = {line.split()[0]: line.split(maxsplit=1)[1:] for line in lines if not line.isdigit()}
        seen = words["seen"][0].split()
        return Life(
            [int(line) for line in lines if line.isdigit()], (words["failed"] or [""])[0],
            dict(zip(seen[::2], map(int, seen[1::2]), strict=True)), int(words["end"][0]),
        )  # fmt: skip

    def fresh(self, name: str) -> Path:
        """Return where a database may lie, in a folder that is empty."""
        folder = self.folder / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        return folder / "rig.db"

    def end(self) -> None:
        self._process.communicate()


@pytest.fixture
def ward(shim: Path, memory: Path) -> Iterator[Ward]:
    made = Ward(shim, memory)
    yield made
    made.end()


def whole(path: Path, acknowledged: list[int]) -> tuple[int, set[str], set[str]]:
    """Return how many acknowledged writes a reader misses, and causes of the store's events and alarms."""
    reader = connect_reader(path)
    present = dict(reader.execute("SELECT h.t_ns, count(*) FROM hops h JOIN estimates e ON e.seq >> 10 = "
                                  "h.seq WHERE h.span = 0 GROUP BY h.t_ns"))  # fmt: skip
    steps = {t for (t,) in reader.execute("SELECT n.t_ns FROM alarm_events n JOIN alarms a ON "
                                          "a.seq = n.alarm_id WHERE a.kind = 'level'")}  # fmt: skip
    events = {cause for (cause,) in reader.execute("SELECT cause FROM events WHERE source = 'store'")}
    alarms = {state for (state,) in reader.execute("SELECT state FROM alarms WHERE parameter = 'store'")}
    reader.close()
    missing = 0
    for number in acknowledged:
        made = records(PROFILES["live"], number)
        missing += present.get(int(made[0].t_ns[0])) != 4
        missing += sum(type(r).__name__ == "AlarmTransition" and r.t_ns not in steps for r in made)
    return missing, events, alarms


def plan(seen: dict[str, int], every: int) -> Iterator[tuple[str, int, int, int]]:
    """Yield kind, error, first and count: every `every`-th write, each fourth of that of the others, each
    opening.

    The errors take turns, and so do failing once, three times and for long; with `every` 1 each meets each.
    """
    for kind, total in seen.items():
        step = {"W": every, "O": 1}.get(kind, max(1, every // 4))
        for place, first in enumerate(range(1, total + 1, step)):
            errors = (errno.EIO, errno.ENOSPC, errno.EROFS)
            counts = (3, 1, 3, 12)
            if every == 1:
                yield from ((kind, error, first, count) for error in errors for count in (1, 2, 3, 4, 12))
            else:
                yield kind, errors[place % 3], first, 3 if kind == "O" else counts[place % 4]


@pytest.mark.parametrize("start", ["first", "later"])
@pytest.mark.parametrize("every", [80, pytest.param(1, marks=[pytest.mark.soak, pytest.mark.timeout(7200)])])
def test_operation_that_fails_costs_nothing_acknowledged_and_is_told(
    ward: Ward, start: str, every: int
) -> None:
    before, number = ward.fresh("before"), 0
    if start == "later":
        ward.live(before, "-", 0, 0, 0, stop=False)
        number = WRITES

    def trial(kind: str = "-", error: int = 0, first: int = 0, count: int = 0) -> tuple[Path, Life]:
        path = ward.fresh("trial")
        shutil.copytree(before.parent, path.parent, dirs_exist_ok=True)
        return path, ward.live(path, kind, error, first, count, number=number)

    reported: Counter[str] = Counter()
    told: Counter[str] = Counter()
    for kind, error, first, count in plan(trial()[1].seen, every):
        path, life = trial(kind, error, first, count)
        missing, events, alarms = whole(path, life.acknowledged)
        case = f"{kind} {errno.errorcode[error]} {first}+{count}: {life}"
        assert missing == 0, case
        assert len(life.acknowledged) == WRITES, f"it does not recover: {case}"
        assert life.dropped == 0, case
        assert "damaged" not in events, f"a failure that passes was taken for damage: {case}"
        assert alarms == ({"RTNUN"} if events else set()), case
        retried = kind == "O" and count <= 2  # by SQLite itself, or for reading only
        assert events or retried or EXPENDABLE.fullmatch(life.failed), f"nothing was told of it: {case}"
        told[kind] += bool(events)
        reported.update(events or ["nothing failed" if not life.failed else "expendable"])
    assert told["D"], "our own sync of the folder failed, and nothing was told of it"
    figure(
        f"a disk that fails, {start} start: {sum(reported.values())} operations, "
        f"nothing lost; {dict(reported)}"
    )


@pytest.mark.parametrize(("kind", "mended"), [("S", True), ("S", False), ("D", True), ("D", False)])
@pytest.mark.parametrize(
    ("every", "count"), [(12, 6), pytest.param(1, 200, marks=[pytest.mark.soak, pytest.mark.timeout(7200)])]
)
def test_sync_that_failed_is_never_taken_for_done(
    ward: Ward, rng: np.random.Generator, every: int, count: int, kind: str, mended: bool
) -> None:
    """A process is killed after a sync (of a file, of the folder) failed, another goes on, and then the power
    goes."""
    syncs = ward.live(ward.fresh("dry"), "-", 0, 0, 0, stop=False).seen[kind]
    starts = Starts(ward.folder / "cut", "live")
    for first in range(1, syncs + 1, every if kind == "S" else 1):
        path, begin = ward.fresh("trial"), ward.log.stat().st_size
        ward.live(path, kind, errno.EIO, first, 1 if mended else 10**6, stop=False, patience_s=0.05)
        ward.live(path, "-", 0, 0, 0, number=WRITES, stop=False)
        for moment, files, reported in cuts(read_log(ward.log, begin), count, rng):
            assert starts.lost(files, reported) == 0, f"{kind} {first}, cut at {moment}"
    figure(
        f"power cuts after a sync ({kind}) that failed and a kill -9: {starts.cuts}, "
        "nothing acknowledged lost"
    )


def test_reopen_whose_folder_cannot_be_synced_takes_no_row(
    memory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with Store.open(memory / "rig.db") as store:
        run_id = store.begin_run(run_info())
        monkeypatch.setattr("agent.storage.write.store.sync_folder", refuse)
        with pytest.raises(OSError, match="Input/output"):
            store.reopen()
        with pytest.raises(StoreError, match="closed"):
            store.commit(store.encode(run_id, [step("NORM", "UNACK")]))
        monkeypatch.undo()
        store.reopen()
        store.write(run_id, [batch(1)])
