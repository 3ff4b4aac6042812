"""What a CAN bus carried, for recording: the text of `candump -L`, and beside it what that text cannot carry.

A line has microseconds, the identifier, the data, and of a CAN FD frame the flags for its bit rate and error
state. Beside it stand (each only where there is something to say)

    finer      what of each time stamp is finer than a microsecond, ns: base64 of u16, little-endian
    dropped    frames that the bus lost before they could be read since the piece before, by reason
    text       messages of a daemon or adapter that were no frame, since the piece before
    reopened   the bus was closed and opened anew before these frames

Not kept are frames that the bus's filter holds back, and the length codes 9 to 15 of classic frames of eight
bytes.
"""

import base64
import binascii
import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from drivers.can.codec.frames import (
    ERROR,
    EXTENDED,
    EXTENDED_MASK,
    REMOTE,
    STANDARD_MASK,
    Frames,
    FrameTable,
    candump_frames,
    joined,
    no_frames,
)
from drivers.port import Capture, Driver, DriverConfigError, IntArray, SampleBlock

_BIT_RATE_AND_STATE = 0x03
_FD = 0x07  # fixed by linux/can.h
_LONGEST_NAME = 15  # fixed by IFNAMSIZ of linux/if.h


class CanCapture(Driver):
    """A driver that makes samples of frames, and can keep the frames for a recording."""

    capture_suffix: ClassVar[str | None] = ".log"
    _keeper: "Keeper | None" = None

    @abstractmethod
    def prepare(self) -> None:
        """Make ready to decode, without a bus; DriverConfigError when that cannot be."""

    @abstractmethod
    def decoded(self, frames: Frames) -> SampleBlock:
        """Return the samples that frames complete."""

    @abstractmethod
    def restart(self) -> None:
        """Forget samples that are not whole."""

    def keep_capture(self) -> None:
        self._keeper = Keeper(getattr(self.request.settings, "channel", "can"))

    def keep(self, frames: Frames) -> None:
        """Keep frames for the recording, if there is one."""
        if self._keeper is not None:
            self._keeper.add(frames, self.counts.dropped, self.counts.rejected["text"], self.counts.reopened)

    def take_capture(self) -> Capture | None:
        return None if self._keeper is None else self._keeper.take()

    def decode_capture(self, text: bytes, beside: Mapping[str, Any]) -> SampleBlock:
        self.prepare()
        if beside.get("reopened"):
            self.restart()
            self.counts.reopened += int(beside["reopened"])
        self.counts.dropped.update({str(reason): int(n) for reason, n in beside.get("dropped", {}).items()})
        bad = int(beside.get("text", 0))
        if bad:
            self.counts.received += bad
            self.counts.rejected["text"] += bad
        return self.decoded(captured_frames(text, beside))


class Keeper:
    """The frames that wait to be recorded, and how far the bus's own counts had come."""

    def __init__(self, channel: str) -> None:
        self._channel = channel
        self._frames = no_frames()
        self._dropped: Counter[str] = Counter()
        self._text = self._reopened = 0
        self._beside: dict[str, Any] = {}

    def add(self, frames: Frames, dropped: Counter[str], text: int, reopened: int) -> None:
        """Take frames, and what became of the counts since the last ones."""
        lost = {
            reason: n - self._dropped[reason] for reason, n in dropped.items() if n > self._dropped[reason]
        }
        since = {"dropped": lost, "text": text - self._text, "reopened": reopened - self._reopened}
        self._dropped = Counter(dropped)
        self._text = text
        self._reopened = reopened
        self._beside |= {key: value for key, value in since.items() if value}
        self._frames = joined(self._frames, frames) if len(self._frames) else frames

    def take(self) -> Capture | None:
        """Return what waits and forget it; None when that is nothing."""
        frames, beside = self._frames, self._beside
        self._frames = no_frames()
        self._beside = {}
        if not len(frames) and not beside:
            return None
        finer = (frames.t_ns % 1000).astype("<u2")
        if finer.any():
            beside["finer"] = base64.b64encode(finer.tobytes()).decode("ascii")
        return Capture(lambda: candump_text(frames, self._channel), len(frames), beside)


def captured_frames(text: bytes, beside: Mapping[str, Any]) -> Frames:
    """Return the frames of a recorded piece. Raises DriverConfigError when they are not what was recorded."""
    frames, bad = candump_frames(text.decode("latin-1").splitlines())
    if bad:
        raise DriverConfigError(f"a line of the recording is no frame: {text.splitlines()[bad[0]][:80]!r}")
    if "finer" not in beside:
        return frames
    try:
        finer = np.frombuffer(base64.b64decode(beside["finer"], validate=True), "<u2")
        return Frames(frames.table, frames.t_ns + finer)
    except (ValueError, TypeError, binascii.Error) as error:
        raise DriverConfigError(f"the times beside the recording cannot be read: {error}") from error


def candump_text(frames: Frames, channel: str) -> bytes:
    """Return frames as lines of `candump -L`."""
    name = interface_name(channel)
    return "".join(_lines(frames.table, frames.t_ns, name)).encode("ascii")


def interface_name(channel: str) -> str:
    """Return a channel's interface name for tools: its last part, letters and digits, 15 at most."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", channel.rsplit("/", 1)[-1])[:_LONGEST_NAME] or "can"


def _lines(table: FrameTable, t_ns: IntArray, name: str) -> Iterator[str]:
    micros = t_ns // 1000
    columns = (table["id"].tolist(), table["length"].tolist(), table["flags"].tolist(), micros.tolist())
    octets = np.ascontiguousarray(table["data"]).tobytes().hex().upper()
    width = 2 * table.dtype["data"].shape[0]
    for row, (number, length, flags, time) in enumerate(zip(*columns, strict=True)):
        data = octets[row * width : row * width + 2 * length]
        yield f"({time // 1_000_000}.{time % 1_000_000:06d}) {name} {_frame(number, length, flags, data)}\n"


def _frame(number: int, length: int, flags: int, data: str) -> str:
    """Return one frame in can-utils' notation."""
    if number & ERROR:
        head = f"{number & (ERROR | EXTENDED_MASK):08X}"
    else:
        head = f"{number & EXTENDED_MASK:08X}" if number & EXTENDED else f"{number & STANDARD_MASK:03X}"
    if number & REMOTE:
        return f"{head}#R{length or ''}"
    if flags & _FD or length > 8:
        return f"{head}##{flags & _BIT_RATE_AND_STATE:X}{data}"
    return f"{head}#{data}"
