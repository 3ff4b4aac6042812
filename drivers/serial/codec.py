"""Bytes of a serial line to samples: frames of one length that begin with sync bytes. Pure: no I/O.

Every decoder of a line takes bytes in pieces of any size, keeps at most one unfinished frame or line, and
finds the next good one behind whatever is wrong. Lines of text are in serial_text, frames that an end divides
in serial_ends.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from drivers.crc import Crc
from drivers.fields import ByteArray, Layout
from drivers.port import BoolArray, Counts, FloatArray, IntArray, Trace
from drivers.serial.tuning import FLUSH_FRAMES

Samples = tuple[FloatArray, IntArray | None]
"""Values (n, m) and counters (n,), or None without a counter."""


class SerialDecoder(ABC):
    """Finds samples in a stream of bytes."""

    modulus: int | None = None

    @abstractmethod
    def restart(self) -> None:
        """Forget what is unfinished: the line was opened anew and may begin amid a frame."""

    @abstractmethod
    def feed(self, data: bytes) -> Samples:
        """Return the samples that are whole now."""

    @abstractmethod
    def resolution(self) -> tuple[float, ...]:
        """Smallest step of each field."""


class Skipped:
    """Bytes between good frames, counted as so many bad frames as they make up, or as stray bytes.

    Args:
        counts: where to.
        size: bytes of a frame on the line.
    """

    def __init__(self, counts: Counts, size: int) -> None:
        self._counts = counts
        self._size = size
        self.restart()

    def restart(self) -> None:
        """Forget: the line was opened anew, perhaps amid a frame."""
        self.bytes = 0
        self._reason = ""
        self._begun = False

    def add(self, count: int, reason: str) -> None:
        """Note bytes that are no good frame, and why; of several reasons the first of the alphabet stands."""
        self.bytes += count
        if count:
            self._reason = min(self._reason or reason, reason)

    def many(self) -> bool:
        """Tell whether so much is skipped that it should be counted though no good frame has come."""
        return self.bytes >= FLUSH_FRAMES * self._size

    def settle(self) -> None:
        """Count what was skipped. The piece of a frame amid which the line was opened is nobody's sample."""
        if self.bytes:
            frames = round(self.bytes / self._size) if self._begun else self.bytes // self._size
            if frames:
                self._counts.received += frames
                self._counts.rejected[self._reason] += frames
            else:
                self._counts.faults["stray bytes"] += self.bytes
            self.bytes = 0
            self._reason = ""

    def good(self) -> None:
        """Count what was skipped before a good frame."""
        self.settle()
        self._begun = True


class Frame:
    """What a binary frame holds, packed fields and then a check, and what is wanted of it.

    Args:
        layout: of the fields.
        crc: the check over what `sound` is shown of the fields, low byte first; None where there is none.
        names: of the fields that are wanted; counter: of the one that numbers samples.
        counts: where frames are shown.

    Attributes:
        size: bytes of fields and check.
        modulus: of the counter; None without one.
    """

    def __init__(
        self, layout: Layout, crc: Crc | None, names: Sequence[str], counter: str | None, counts: Counts
    ) -> None:
        self._layout = layout
        self._crc = crc
        self._names = tuple(names)
        self._counter = counter
        self.counts = counts
        self.size = layout.size + (crc.size if crc else 0)
        self.steps = layout.resolution(self._names)
        self.modulus = layout.counter_field(counter).modulus if counter else None

    @property
    def has_check(self) -> bool:
        """Tell whether a frame proves itself."""
        return self._crc is not None

    def sound(self, rows: ByteArray) -> BoolArray:
        """Tell of each row (n, size) whether its check is right; all of them where there is none."""
        if self._crc is None or not len(rows):
            return np.ones(len(rows), np.bool_)
        body, check = rows[:, : self._layout.size], rows[:, self._layout.size :]
        return np.asarray((self._crc.bytes_of(body) == check).all(axis=1))

    def samples(self, rows: ByteArray, whole: ByteArray) -> Samples:
        """Return what sound rows (n, size) say; whole (n, ...): the same with all that the line carried."""
        body = rows[:, : self._layout.size]
        counter = self._layout.counter(body, self._counter) if self._counter else None
        values = self._layout.values(body, self._names)
        if self.counts.trace is not None:
            shown = [row.tobytes().hex(" ") for row in whole[-Trace.NEWEST :]]
            self.counts.trace.good(shown, values[-Trace.NEWEST :])
        return values, counter


class BinaryDecoder(SerialDecoder):
    """Frames of one length: sync bytes, packed fields, check (low byte first, over all after sync).

    Bytes between good frames are counted as so many bad frames ("crc" when one of them began with the sync
    bytes, else "sync") as they make up, or, when fewer than half a frame, as stray.
    """

    def __init__(self, sync: bytes, frame: Frame) -> None:
        self._sync = np.frombuffer(sync, np.uint8)
        self._frame = frame
        self._counts = frame.counts
        self._size = len(sync) + frame.size
        self.modulus = frame.modulus
        self._skipped = Skipped(frame.counts, self._size)
        self.restart()

    def restart(self) -> None:
        self._rest = b""
        self._skipped.restart()

    def resolution(self) -> tuple[float, ...]:
        return self._frame.steps

    def feed(self, data: bytes) -> Samples:
        text = np.frombuffer(self._rest + data, np.uint8)
        starts, failed = self._frames(text)
        end = self._account(text, starts, failed)
        kept = max(end, len(text) - self._size + 1)
        self._skip(text[end:kept], bool(((failed >= end) & (failed < kept)).any()))
        if self._skipped.many():
            self._skipped.settle()
        self._rest = text[kept:].tobytes()
        return self._samples(text, starts)

    def _frames(self, text: ByteArray) -> tuple[IntArray, IntArray]:
        """Return where the good frames begin, and where bytes begin that look like a frame and are none."""
        places = self._candidates(text)
        good = self._sound(text, places)
        return _apart(places[good], self._size), places[~good]

    def _candidates(self, text: ByteArray) -> IntArray:
        last = len(text) - self._size + 1
        if last <= 0:
            return np.empty(0, np.int64)
        match = np.ones(last, np.bool_)
        for place, byte in enumerate(self._sync):
            match &= text[place : place + last] == byte
        return np.flatnonzero(match)

    def _whole(self, text: ByteArray, places: IntArray) -> ByteArray:
        return np.asarray(text[places[:, None] + np.arange(self._size)])

    def _sound(self, text: ByteArray, places: IntArray) -> BoolArray:
        if self._frame.has_check:
            return self._frame.sound(self._whole(text, places)[:, len(self._sync) :])
        return self._followed(text, places)

    def _followed(self, text: ByteArray, places: IntArray) -> BoolArray:
        """Tell of frames without a check whether the next sync bytes follow, as far as they have come."""
        good = np.ones(len(places), np.bool_)
        for place, byte in enumerate(self._sync):
            following = places + self._size + place
            there = following < len(text)
            good &= ~there | (text[np.minimum(following, len(text) - 1)] == byte)
        return good

    def _account(self, text: ByteArray, starts: IntArray, failed: IntArray) -> int:
        """Count what lies between the good frames; return where the last of them ends."""
        end = 0
        if len(starts) and not len(failed) and starts[0] == 0 and not self._skipped.bytes:
            jumps = np.flatnonzero(np.diff(starts) != self._size)
            if not len(jumps):
                self._skipped.good()
                return int(starts[-1]) + self._size
        for start in starts.tolist():
            self._skip(text[end:start], bool(((failed >= end) & (failed < start)).any()))
            self._skipped.good()
            end = start + self._size
        return end

    def _skip(self, piece: ByteArray, crc_failed: bool) -> None:
        reason = "crc" if crc_failed else "sync"
        self._skipped.add(len(piece), reason)
        if len(piece) >= self._size:
            shown = piece[: self._size].tobytes().hex(" ")
            why = (
                "has another checksum than crc"
                if crc_failed
                else f"does not begin with sync {self._sync_text}"
            )
            self._counts.first.setdefault(reason, f"{shown} {why}")
        if 2 * len(piece) >= self._size and self._counts.trace is not None:
            self._counts.trace.bad(reason, [piece[: 2 * self._size].tobytes().hex(" ")])

    @property
    def _sync_text(self) -> str:
        return str(self._sync.tobytes().hex(" "))

    def _samples(self, text: ByteArray, starts: IntArray) -> Samples:
        whole = self._whole(text, starts)
        self._counts.received += len(starts)
        return self._frame.samples(whole[:, len(self._sync) :], whole)


def _apart(places: IntArray, size: int) -> IntArray:
    """Return the places but for those that lie within a frame that began before."""
    if len(places) < 2 or (np.diff(places) >= size).all():
        return places
    kept = [int(places[0])]
    for place in places[1:].tolist():
        if place >= kept[-1] + size:
            kept.append(place)
    return np.array(kept, np.int64)
