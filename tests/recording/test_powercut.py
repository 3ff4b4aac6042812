"""Power cuts while recording: all that the process does on files is recorded and played to a random point."""

import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from agent.recording import capture
from agent.recording.event_files import read_meta
from agent.recording.recorder import Limits, segments_of
from tests import peers
from tests.recording.power_workload import PIECES
from tests.recording.test_capture_on_can import HEADER, kept, random_frames
from tests.recording.test_event_writer import Told, made
from tests.storage.powercut.conftest import shim  # noqa: F401 - a fixture
from tests.storage.powercut.disk import cuts, read_log

COUNT = pytest.param(100), pytest.param(5000, marks=[pytest.mark.soak, pytest.mark.timeout(1200)])


Left = tuple[Path, list[str]]


def after_cuts(library: Path, work: Path, kind: str, count: int, care: str = "careful") -> Iterator[Left]:
    """Run the workload once; yield what the disk held after cuts at random moments, and what had been
    acknowledged."""
    folder = work / "work" / "rig.db.events"
    folder.mkdir(parents=True)
    environment = os.environ | {
        "LD_PRELOAD": str(library), "DELTAK_OPLOG": str(work / "log"), "DELTAK_OPLOG_ROOT": str(folder),
    }  # fmt: skip
    command = [sys.executable, "-m", "tests.recording.power_workload", kind, str(folder), care]
    subprocess.run(command, env=environment, cwd=peers.ROOT, capture_output=True, check=True)
    left = work / "left" / "rig.db.events"
    left.mkdir(parents=True)
    for _, files, acknowledged in cuts(read_log(work / "log"), count, np.random.default_rng(7)):
        for path in left.iterdir():
            path.unlink()
        for name, content in files.items():
            (left / Path(name).name).write_bytes(content)
        yield left, acknowledged.decode().splitlines()


def lost_records(folder: Path, acknowledged: list[str]) -> int:
    """Start on the folder, as the agent does; return how many acknowledged records are not there, whole."""
    reported = Told()
    writer = made(folder.parent, reported)
    writer._take_stock()
    states = {name: (state, int(samples)) for name, state, samples in map(str.split, acknowledged)}
    there = {path.name: read_meta(path) for path in folder.iterdir()}
    assert not [name for name in there if name.endswith(".part")]
    lost = sum(not meta for meta in there.values())
    for name, (state, samples) in states.items():
        meta = there.get(name)
        # the oldest may be gone already though that was not told yet; the newest never is
        newest = name == max(states)
        if state == "purged" or (meta is None and not newest):
            continue
        wanted = {"complete"} if state == "complete" else {"complete", "cut"}
        lost += meta is None or meta.get("state") not in wanted or meta["samples"] < samples
    return lost


@pytest.mark.parametrize("count", COUNT)
def test_power_cut_leaves_every_acknowledged_event_record_whole(
    shim: Path,  # noqa: F811 - the fixture
    tmp_path: Path,
    count: int,
) -> None:
    for folder, acknowledged in after_cuts(shim, tmp_path, "events", count):
        assert lost_records(folder, acknowledged) == 0, acknowledged


def recorded_pieces(folder: Path) -> list[bytes]:
    files = segments_of(folder, HEADER, ".log", Limits()).files()
    own = [path for path in files if capture.index_of(path).exists()]
    return [piece.text for path in own for piece in capture.read_pieces(path)]


@cache
def sent_pieces() -> list[bytes]:
    return [piece.text() for piece in kept([random_frames(10, seed=number) for number in range(PIECES)])]


def lost_pieces(folder: Path, acknowledged: list[str]) -> int:
    """Return how many acknowledged pieces are missing; what is there must be what was heard, in its order."""
    sent, got = sent_pieces(), recorded_pieces(folder)
    there = set(got)
    assert [text for text in got if text] == [text for text in sent if text in there]
    return sum(text not in there for text in sent[: int(acknowledged[-1]) if acknowledged else 0])


@pytest.mark.parametrize("count", COUNT)
def test_power_cut_leaves_every_acknowledged_piece_of_a_recording(
    shim: Path,  # noqa: F811 - the fixture
    tmp_path: Path,
    count: int,
) -> None:
    for folder, acknowledged in after_cuts(shim, tmp_path, "raw", count):
        assert lost_pieces(folder, acknowledged) == 0, acknowledged


def test_power_cuts_without_syncs_lose_what_was_acknowledged(shim: Path, tmp_path: Path) -> None:  # noqa: F811 - the fixture
    """The red twin: were the syncs left out, this suite would see it."""
    for kind, lost in (("events", lost_records), ("raw", lost_pieces)):
        found = [lost(*left) for left in after_cuts(shim, tmp_path / kind, kind, 30, "lazy")]
        assert sum(n > 0 for n in found) > 5, kind
