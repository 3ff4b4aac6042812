"""Power cuts on the product's own process: all it does on files is recorded and played to a random point."""

import hashlib
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from agent.storage.write import watermark as watermarks
from agent.storage.write.store import Store
from tests import peers
from tests.figures import figure
from tests.storage.powercut.disk import Operation, cuts, read_log
from tests.storage.powercut.workload import PROFILES, records
from tests.storage.rows import batch, run_info

WRITES = {"live": 45, "bulk": 12, "keep": 40}


def record(
    shim: Path, folder: Path, profile: str, synchronous: str = "FULL", prepare: bytes | None = None
) -> list[Operation]:
    """Run the workload to its end; return all it did."""
    work = folder / "work"
    work.mkdir()
    if prepare is not None:
        (work / "rig.db").write_bytes(prepare)
        (folder / "inode").write_text(str((work / "rig.db").stat().st_ino))
    environment = {
        **os.environ,
        "LD_PRELOAD": str(shim),
        "DELTAK_OPLOG": str(folder / "log"),
        "DELTAK_OPLOG_ROOT": str(work),
    }
    command = [
        sys.executable,
        "-m",
        "tests.storage.powercut.workload",
        work / "rig.db",
        profile,
        str(WRITES[profile]),
        synchronous,
    ]
    done = subprocess.run(command, env=environment, cwd=peers.ROOT, capture_output=True, check=True)
    operations = read_log(folder / "log")
    assert b"".join(o.content for o in operations if o.kind == "A") == done.stdout
    return operations


def laid_before(path: Path, inode: int, content: bytes) -> list[Operation]:
    """Return the operations that put a file there before the recording began."""
    start = Operation("O", inode, 0, str(path).encode())
    return [
        start,
        Operation("W", inode, 0, content),
        Operation("S", inode, 0, b""),
        Operation("D", 0, 0, b""),
    ]


def lay(files: dict[str, bytes], folder: Path) -> Path:
    """Write what the disk held into an empty folder; return the database's path."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in files.items():
        if not name.endswith("-shm"):  # the shared index is made anew
            (folder / Path(name).name).write_bytes(content)
    return folder / "rig.db"


@dataclass(frozen=True)
class Found:
    """What a start found on a disk.

    Attributes:
        kept: since when rows are kept.
        present: rows by instant.
        steps: steps of alarms.
        highs: the highest numbers by table.
        damaged: the start took it for damaged.
    """

    kept: float
    present: dict[int, int]
    steps: int
    highs: dict[str, int]
    damaged: bool


class Starts:
    """Starts on disks after cuts, as the agent does it; a disk that was started on before need not be tried
    again."""

    def __init__(self, folder: Path, profile: str) -> None:
        self._folder, self._profile = folder, PROFILES[profile]
        self._found: dict[bytes, Found] = {}
        self.cuts = 0

    def lost(self, files: dict[str, bytes], acknowledged: bytes) -> int:
        """Return how many acknowledged writes are missing or incomplete."""
        self.cuts += 1
        found = self.found(files)
        numbers = [int(line) for line in acknowledged.split(b"\n")[:-1] if line.isdigit()]
        lost, steps = 0, 0
        for number in numbers:
            made = records(self._profile, number)
            steps += sum(type(r).__name__ == "AlarmTransition" for r in made)
            lost += any(t >= found.kept and found.present.get(int(t)) != 4 for t in made[0].t_ns)
        return lost + max(0, steps - found.steps)

    def found(self, files: dict[str, bytes]) -> Found:
        """Start on a disk and look at what is there."""
        key, note = _digest(files)
        if key not in self._found:
            self._found[key] = self._start(lay(files, self._folder))
        found = self._found[key]
        early = [t for t, high in note.items() if found.highs and high > found.highs[t]]
        return replace(found, damaged=True) if early else found

    @property
    def different(self) -> int:
        """How many of the disks differed."""
        return len(self._found)

    def _start(self, path: Path) -> Found:
        highs = watermarks._highs(path) if path.exists() else {}
        with Store.open(path, self._profile.keep) as store:
            damaged = store.recovery is not None
            execute = store.connection.execute
            kept = execute("SELECT coalesce(max(full_from_ns), -9e18) FROM runs").fetchone()[0]
            query = (
                "SELECT h.t_ns, count(*) FROM hops h JOIN estimates e ON e.seq >> 10 = h.seq "
                "WHERE h.span = 0 GROUP BY h.t_ns"
            )
            steps = execute("SELECT count(*) FROM alarm_events").fetchone()[0]
            found = Found(kept, dict(execute(query)), steps, highs, damaged)
            store.write(store.begin_run(run_info()), [batch(1, start=2 * 10**18)])
        return found


def _digest(files: dict[str, bytes]) -> tuple[bytes, dict[str, int]]:
    """Return what tells a disk from every other, and how far its note says that rows were acknowledged.

    Of the shared index and the ballast nothing depends.
    """
    digest, note = hashlib.sha256(), {}
    for name, content in sorted(files.items()):
        if name.endswith(".lock"):
            note = watermarks._parsed(content[watermarks._PLACE :])
        elif not name.endswith(("-shm", ".ballast")):
            digest.update(f"{name} {len(content)} ".encode() + content)
    return digest.digest(), note


@pytest.mark.parametrize("profile", WRITES)
@pytest.mark.parametrize(
    "count", [200, pytest.param(16_667, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_power_cut_at_any_moment_loses_nothing_acknowledged(
    shim: Path, memory: Path, rng: np.random.Generator, profile: str, count: int
) -> None:
    starts = Starts(memory / "cut", profile)
    for moment, files, acknowledged in cuts(record(shim, memory, profile), count, rng):
        assert starts.lost(files, acknowledged) == 0, f"cut at operation {moment}"
        assert not starts.found(files).damaged, f"the cut at operation {moment} left what needs a repair"
    figure(
        f"power cuts, {profile}: {starts.cuts} ({starts.different} different disks), "
        "nothing acknowledged lost"
    )


def test_power_cuts_with_synchronous_normal_lose_rows(
    shim: Path, memory: Path, rng: np.random.Generator
) -> None:
    """The red twin: were the store set to NORMAL, this suite would see it."""
    starts, operations = Starts(memory / "cut", "live"), record(shim, memory, "live", "NORMAL")
    lost = [starts.lost(files, reported) for _, files, reported in cuts(operations, 200, rng)]
    assert sum(n > 0 for n in lost) > 50


def test_power_cut_while_a_damaged_file_is_replaced_leaves_a_way_on(
    shim: Path, memory: Path, rng: np.random.Generator
) -> None:
    """Old file, new file or the state between: never none of them, never rows that are neither."""
    whole = memory / "whole.db"
    with Store.open(whole) as store:
        store.write(store.begin_run(run_info()), [batch(200, start=10**18)])
    octets = bytearray(whole.read_bytes())
    octets[40 * 1024 : 41 * 1024] = bytes(1024)
    operations = record(shim, memory, "live", prepare=bytes(octets))
    first = laid_before(memory / "work" / "rig.db", int((memory / "inode").read_text()), bytes(octets))
    recovered = 0
    for _, files, _ in cuts(first + operations, 100, rng):
        with Store.open(lay(files, memory / "cut")) as store:
            left = store.connection.execute("SELECT count(*) FROM hops WHERE t_ns < 1.5e18").fetchone()[0]
            recovered += store.recovery is not None
            assert left == 0 or left >= 150
            aside = list((memory / "cut").glob("rig.db.corrupt-*"))
            assert left >= 150 or aside
    assert recovered > 5
