"""An hour of a rig: the task that a process of its own computes.

What crosses from one hour to the next is the pipeline as it is: filters, windows, what was learnt, alarms,
and the drivers' places in their files. It is handed on whole, so that hours computed by different processes
give what one process gives, to the last bit.
"""

import pickle
from typing import NamedTuple

from agent.errors import Fault, RecordingError
from agent.recording.source import OwnRecording
from agent.records import Record
from agent.runtime.playing import Playing
from agent.runtime.reestimation.archive import Recorded
from agent.runtime.replay import Known, adopted, begun, keep_freed_memory


class First(NamedTuple):
    """What the first hour of a rig begins with."""

    recorded: Recorded
    known: Known


class Part(NamedTuple):
    """What an hour led to.

    Attributes:
        rest: what the next hour goes on from; None after the last.
        records: of each block, in order.
        advice: what to tell the user, in words.
        damaged: files that could not be read to their end.
    """

    rest: bytes | None
    records: list[list[Record]]
    advice: list[str]
    damaged: list[Fault]


def computed(work: First | bytes, hour_ns: int) -> Part:
    """Compute one part of a rig's recordings, up to the next multiple of hour_ns.

    Raises ConfigError, ModelError, RecordingError.
    """
    keep_freed_memory()
    advice: list[str] = []
    if isinstance(work, bytes):
        playing: Playing = pickle.loads(work)  # noqa: S301 - `computed` made it, and it came by the scheduler
    else:
        playing = begun(work.recorded.rig, work.recorded.paths)
        advice += adopted(playing.pipeline, work.known)
    try:
        records = [found for found in playing.records(hour_ns) if found]
        damaged = _damaged(playing)
        if not playing.over:
            return Part(pickle.dumps(playing, 5), records, advice, damaged)
        faults = playing.assessed(playing.pipeline.config.rig.name)
    except OSError as error:
        raise RecordingError.at(
            playing.pipeline.config.rig.name, f"its recordings: {error}", "try again"
        ) from error
    finally:
        playing.close()
    return Part(None, records, [*advice, *map(str, faults)], damaged)


def _damaged(playing: Playing) -> list[Fault]:
    """Return the files found damaged since the last part."""
    found: list[Fault] = []
    for driver in (track.driver for track in playing.tracks):
        if isinstance(driver, OwnRecording):
            found += driver.damaged
            driver.damaged.clear()
    return found
