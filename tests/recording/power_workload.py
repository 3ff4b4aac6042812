"""A process that records and says on its standard output what is on the disk; for the tests that cut its
power.

python -m tests.recording.power_workload events|raw FOLDER careful|lazy: lazy leaves every sync out.
"""

import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from agent.recording.recorder import Limits, Recorder
from agent.records import EventRecord, Record
from drivers.port import SampleBlock
from tests.recording.test_capture_on_can import HEADER, kept, random_frames
from tests.recording.test_event_writer import job, made

RECORDS, PIECES, AT_ONCE = 8, 40, 3


HELD: list[int] = []


def tell(folder: Path, records: Sequence[Record]) -> None:
    for record in records:
        if isinstance(record, EventRecord):
            if record.state != "purged":
                # the log knows files by their inodes: one that is held is not given to another file
                HELD.append(os.open(folder / Path(record.file).name, os.O_RDONLY))
            os.write(1, f"{Path(record.file).name} {record.state} {record.samples}\n".encode())


def events(folder: Path) -> None:
    """Write records twice each, as an alarm does; only three of them are kept."""
    writer = made(folder.parent, partial(tell, folder), max_count=3)  # type: ignore[arg-type]
    writer._take_stock()
    for _ in range(RECORDS):
        name = writer.name("level", "k1")
        for state, samples in (("recording", 100), ("complete", 200)):
            writer._write(job(name, state, samples))
            writer._prune()


def raw(folder: Path) -> None:
    """Record pieces of a bus, some at once, into files of a few kilobytes."""
    recorder = Recorder(folder, HEADER, ".log", Limits(segment_bytes=2000))
    pieces = kept([random_frames(10, seed=number) for number in range(PIECES)])
    for start in range(0, PIECES, AT_ONCE):
        some = pieces[start : start + AT_ONCE]
        recorder._write([(SampleBlock([[0.0]], start + i), piece) for i, piece in enumerate(some)])  # type: ignore[arg-type]
        os.write(1, b"%d\n" % (start + len(some)))


def main(kind: str, folder: str, care: str) -> None:
    if care == "lazy":
        os.fsync = os.fdatasync = lambda _: None  # type: ignore[assignment]
    {"events": events, "raw": raw}[kind](Path(folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
