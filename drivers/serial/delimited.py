"""Frames that an end divides (COBS, SLIP) on a serial line to samples. Pure: no I/O."""

import numpy as np

from drivers.serial.codec import Frame, Samples, SerialDecoder, Skipped
from drivers.serial.framing import Framing


class EndedDecoder(SerialDecoder):
    """Frames of one length once decoded: packed fields, check (low byte first, over the fields).

    Rejects by "crc", by "length" and by "coding" (a COBS length that leads out of the frame, a SLIP escape of
    nothing); what is no frame is counted by its bytes, as so many frames as they make up.
    """

    def __init__(self, framing: Framing, frame: Frame) -> None:
        self._framing = framing
        self._fields = frame
        self._counts = frame.counts
        self._size = frame.size
        self._longest = 2 * self._size + 2
        self.modulus = frame.modulus
        self._skipped = Skipped(frame.counts, self._size + 2)
        self.restart()

    def restart(self) -> None:
        self._rest = b""
        self._overlong = False
        self._skipped.restart()

    def resolution(self) -> tuple[float, ...]:
        return self._fields.steps

    def feed(self, data: bytes) -> Samples:
        *pieces, rest = (self._rest + data).split(self._framing.end)
        frames = [self._frame(piece) for piece in pieces]
        self._rest = self._shortened(rest)
        if self._skipped.many():
            self._skipped.settle()
        return self._samples([frame for frame in frames if frame is not None])

    def _frame(self, piece: bytes) -> bytes | None:
        """Return fields and check of what stands between two ends; None if it is no frame of this length."""
        overlong, self._overlong = self._overlong, False
        frame = None if overlong else self._framing.decode(piece)
        if frame is not None and len(frame) == self._size:
            self._skipped.good()
            return frame
        reason = "coding" if frame is None and not overlong else "length"
        self._skipped.add(len(piece) + bool(piece), reason)
        if piece:
            self._counts.show_bad(reason, piece.hex(" "))
        return None

    def _shortened(self, rest: bytes) -> bytes:
        """Return what may become a frame; what is too long for one is none, nor is its end still to come."""
        if len(rest) <= self._longest and not self._overlong:
            return rest
        self._overlong = True
        self._skipped.add(len(rest), "length")
        return b""

    def _samples(self, frames: list[bytes]) -> Samples:
        rows = np.frombuffer(b"".join(frames), np.uint8).reshape(len(frames), self._size)
        good = self._fields.sound(rows)
        self._counts.received += len(rows)
        if not good.all():
            self._counts.rejected["crc"] += int((~good).sum())
            self._counts.show_bad("crc", *(row.tobytes().hex(" ") for row in rows[~good]))
            rows = rows[good]
        return self._fields.samples(rows, rows)
