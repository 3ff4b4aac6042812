"""Records one source in a thread of its own, into files that are bounded by size and age."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Protocol

from agent.recording import blocks, capture
from agent.recording.folder import SegmentFolder, make_folder, room
from agent.recording.header import RawHeader
from agent.recording.tuning import FLUSH_S, SEGMENT_BYTES, SEGMENT_S
from agent.storage.database.files import sync_folder
from drivers.port import Capture, SampleBlock

log = logging.getLogger(__name__)


class Limits(NamedTuple):
    """What the recordings of a source may take: bytes of all files, their age, and when a new file begins."""

    max_bytes: float = float(1 << 30)
    max_age_s: float = float("inf")
    segment_bytes: int = SEGMENT_BYTES


class Segment(Protocol):
    """One file while it is written."""

    path: Path

    def add(self, block: SampleBlock, capture: Capture | None) -> None: ...
    def size(self) -> int: ...
    def sync(self) -> None: ...
    def close(self) -> None: ...


class Recorder:
    """Records one source: `record` never blocks; a failing or full disk costs recordings, counted, reported.

    Args:
        folder: made if missing.
        header: what each file says of itself; files are called RIG-SOURCE-NNNNNNNN, RAW or as `suffix` says.
        suffix: of the form of what the bus carried, where the driver has one; None for its samples.
        limits: see Limits.
        most: deliveries that wait for the disk at most.
        tell: called, in the recorder's thread, when recording begins to fail and when it goes on, with cause
            and words.
    """

    def __init__(
        self,
        folder: Path,
        header: RawHeader,
        suffix: str | None = None,
        limits: Limits | None = None,
        *,
        most: int = 4096,
        tell: Callable[[str, str], None] = lambda _cause, _words: None,
    ) -> None:
        self._header, self._suffix, self._most, self._report = header, suffix, most, tell
        self._limits = limits or Limits()
        self._segments = segments_of(folder, header, suffix, self._limits)
        self._queue: deque[tuple[SampleBlock, Capture | None]] = deque()
        self._condition = threading.Condition()
        self._stopping = False
        self._segment: Segment | None = None
        self._begun_s = 0.0
        self._failing: str | None = None
        self._reported_dropped = 0
        self._thread = threading.Thread(target=self._work, name=f"recorder-{header.source}", daemon=True)
        self.progress = 0
        self.recorded = 0
        """Sample instants written and synced."""
        self.dropped = 0
        """Sample instants that the disk was too slow or too full for."""

    def start(self) -> None:
        self._thread.start()

    def is_alive(self) -> bool:
        """Tell whether the thread runs."""
        return self._thread.is_alive()

    def record(self, block: SampleBlock, what: Capture | None = None) -> None:
        """Hand over a block and what the bus carried of it; what does not fit is counted as dropped."""
        with self._condition:
            if len(self._queue) >= self._most:
                self.dropped += len(block)
                return
            self._queue.append((block, what))
            if len(self._queue) >= self._most // 2:
                self._condition.notify()

    def stop(self, timeout_s: float = 10.0) -> None:
        """Write what waits, sync and end the thread."""
        with self._condition:
            self._stopping = True
            self._condition.notify()
        self._thread.join(timeout_s)

    def _work(self) -> None:
        over = False
        while not over:
            with self._condition:
                # one write and sync a period: a flash wears by the number of them
                self._condition.wait_for(
                    lambda: self._stopping or len(self._queue) >= self._most // 2, FLUSH_S
                )
                waiting = list(self._queue)
                over = self._stopping
                self._queue.clear()
            self.progress += 1
            self._write(waiting)
        self._abandon()

    def _write(self, waiting: list[tuple[SampleBlock, Capture | None]]) -> None:
        """Append deliveries and sync; after a failure the next ones go to a new file."""
        samples = sum(len(block) for block, _ in waiting)
        try:
            if waiting:
                self._append(waiting)
                self.recorded += samples
            self._prune()
        except OSError as error:
            self._give_up(samples, error.strerror or str(error))
        except Exception as error:
            # a fault in a driver's text costs these samples, is seen by all, and no others
            log.exception("%s: cannot be recorded", self._header.source)
            self._give_up(samples, f"{type(error).__name__}: {error}")
        else:
            if waiting:
                self._recovered()

    def _prune(self) -> None:
        """Delete what is too old or too much; where that fails the disk fills, and `_make_room` says so."""
        try:
            self._segments.prune(None if self._segment is None else self._segment.path)
        except OSError as error:
            log.warning("%s: old recordings cannot be deleted: %s", self._header.source, error)

    def _give_up(self, samples: int, cause: str) -> None:
        """Count what is lost; the next deliveries go to a new file."""
        self.dropped += samples
        self._abandon()
        self._failed(cause)

    def _append(self, waiting: list[tuple[SampleBlock, Capture | None]]) -> None:
        self._make_room()
        for block, what in waiting:
            self._open().add(block, what)
        if self._segment is not None:
            self._segment.sync()

    def _make_room(self) -> None:
        """Delete the oldest files where the disk is nearly full; OSError when that does not help."""
        folder = self._segments.folder
        make_folder(folder)
        writing = None if self._segment is None else self._segment.path
        old = [path for path in self._segments.files() if path != writing]
        while room(folder) <= 0:
            if not old:
                raise OSError("the disk is nearly full; what is left is the database's")
            self._segments.delete([old.pop(0)])

    def _open(self) -> Segment:
        """Return the open file; a new one when there is none or it has had its time."""
        if self._segment is not None and (self._segment.size() >= self._limits.segment_bytes or self._aged()):
            self._segment.sync()
            self._close()
        if self._segment is None:
            path = self._segments.next(self._suffix or blocks.SUFFIX)
            make = blocks.BlockSegment if self._suffix is None else capture.CaptureSegment
            self._segment = make(path, self._header)
            self._begun_s = time.monotonic()
            sync_folder(path.parent)
        return self._segment

    def _aged(self) -> bool:
        return time.monotonic() - self._begun_s > min(SEGMENT_S, self._limits.max_age_s)

    def _close(self) -> None:
        segment, self._segment = self._segment, None
        if segment is not None:
            self._segments.end(segment.path)
            segment.close()

    def _abandon(self) -> None:
        """Leave a file that cannot be written; closing it may fail as well, and what was synced stays."""
        with suppress(OSError):
            self._close()

    def _failed(self, cause: str) -> None:
        if self._failing is None:
            self._failing, self._reported_dropped = cause, self.dropped
            self._report("recording stopped", f"{self._header.source}: cannot be recorded: {cause}")

    def _recovered(self) -> None:
        """Say once that recording goes on, and what the failure or a slow disk cost."""
        lost = self.dropped - self._reported_dropped
        if self._failing is None and not lost:
            return
        why = self._failing or "the disk was too slow"
        self._failing, self._reported_dropped = None, self.dropped
        self._report(
            "recording resumed", f"{self._header.source}: recorded again; {lost} samples were not ({why})"
        )


def segments_of(folder: Path, header: RawHeader, suffix: str | None, limits: Limits) -> SegmentFolder:
    """Return where a source's files are; all forms count as one recording, so none outlives its bounds."""
    suffixes = (blocks.SUFFIX,) if suffix is None else (blocks.SUFFIX, suffix)
    name = f"{header.rig}-{header.source}" if header.rig else header.source
    return SegmentFolder(folder, name, suffixes, (capture.INDEX,), limits.max_bytes, limits.max_age_s)
