"""What a CAN driver made of its bus is what it makes of the recording: samples, counts, losses, restarts and
all."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.can.bus.bus import CanBus
from drivers.can.codec.frames import ERROR, REMOTE, Frames, frames_of, no_frames, pack_frame
from drivers.can.driver import CanDriver, CanSettings
from drivers.port import Counts, DriverIOError, SampleBlock, SourceRequest
from tests.conformance import test_can_conformance

FOLDER = Path(test_can_conformance.__file__).parent
SINGLE = ("RIG_SAMPLE.Force", "RIG_SAMPLE.X1"), "RIG_SAMPLE.Counter"
SPREAD = ("RIG_FORCE.Force", "RIG_MOVE.X1", "RIG_MOVE.X2"), "RIG_FORCE.Counter"
PAGES = ("RIG_PAGES.Force", "RIG_PAGES.X1"), "RIG_PAGES.Counter"
ONE_PAGE = ("RIG_PAGES.Force",), "RIG_PAGES.Counter"


class Script(CanBus):
    """A bus that delivers what it is told to, and loses frames as the kernel does."""

    def __init__(self, pieces: Sequence[Frames], counts: Counts, rng: np.random.Generator) -> None:
        self.pieces, self.counts, self.rng = list(pieces), counts, rng
        self.fail = False

    def frames(self, deadline: float) -> Frames:
        if self.fail:
            raise DriverIOError("can0: Network is down")
        if not self.pieces:
            return no_frames()
        if self.rng.random() < 0.1:
            self.counts.dropped["kernel queue"] += int(self.rng.integers(1, 5))
        if self.rng.random() < 0.1:
            self.counts.received += 1
            self.counts.rejected["text"] += 1
        return self.pieces.pop(0)

    def close(self) -> None:
        self.fail = True


def driver(fields: tuple[str, ...], counter: str) -> CanDriver:
    settings = CanSettings.model_validate({"interface": "socketcan", "channel": "can0", "dbc": "rig.dbc"})
    return CanDriver(SourceRequest("line", settings, fields, counter, FOLDER))


def pieces(seed: int, count: int) -> list[Frames]:
    """Frames of every kind in pieces of random length: some lost, repeated, swapped, short, asked for,
    broken."""
    rng = np.random.default_rng(seed)
    rows: list[bytes] = []
    for number in range(count):
        low = (number % 256).to_bytes(1, "little")
        rows.append(pack_frame(0x100, (number % 65536).to_bytes(2, "little") + rng.bytes(6)))
        rows.append(pack_frame(0x102, low + rng.bytes(7)))
        rows.append(pack_frame(0x103, low + rng.bytes(7)))
        rows.append(pack_frame(0x107, bytes([number % 3]) + low + rng.bytes(6)))
    broken = pack_frame(ERROR | 4, bytes([0, 8, 0, 0, 0, 0, 0, 0]))
    odd = [pack_frame(0x100, b"\x01"), pack_frame(0x100 | REMOTE, b"", 0, 8), broken]
    order = np.arange(len(rows)) + rng.normal(scale=1.0, size=len(rows))
    rows = [rows[place] for place in np.argsort(order, kind="stable") if rng.random() > 0.02]
    for place in rng.integers(0, len(rows), 40).tolist():
        rows.insert(place, odd[int(rng.integers(3))] if rng.random() < 0.7 else rows[place])
    stamps = 1_767_225_600_000_000_000 + np.cumsum(rng.integers(1, 10**6, len(rows)))
    edges = np.unique(rng.integers(1, len(rows), len(rows) // 5))
    found = [frames_of(rows, stamps)]
    table, t_ns = found[0].table, found[0].t_ns
    return [Frames(*cut) for cut in zip(np.split(table, edges), np.split(t_ns, edges), strict=True)]


def read_live(live: CanDriver, script: Sequence[Frames], seed: int) -> list[tuple[SampleBlock, Any]]:
    """Read a bus to its end, with it going down and up on the way; return each block with what was heard of
    it."""
    rng = np.random.default_rng(seed)
    live.prepare()
    live.keep_capture()
    bus = live._bus = Script(script, live.counts, rng)
    found = []
    while bus.pieces:
        if rng.random() < 0.02:
            live.restart()
            live.counts.reopened += 1
        found.append((live.read(0.0), live.take_capture()))
    return found


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("asked", [SINGLE, SPREAD, PAGES, ONE_PAGE])
def test_recording_makes_the_samples_counts_and_notes_of_the_live_bus(
    asked: tuple[Any, str], seed: int
) -> None:
    live, again = driver(*asked), driver(*asked)
    for block, capture in read_live(live, pieces(seed, 300), seed):
        if capture is None:
            assert not len(block)
            continue
        other = again.decode_capture(capture.text(), capture.beside)
        np.testing.assert_array_equal(other.values, block.values)
        for name in ("counter", "t_ns"):
            np.testing.assert_array_equal(getattr(other, name), getattr(block, name))
        assert other.epoch == block.epoch
    assert again.counts == live.counts
    assert again.counts.dropped["kernel queue"] > 0
    assert again.counts.received > 90
    assert again.take_notes() == live.take_notes()
    assert again.counter_modulus == live.counter_modulus


def test_driver_that_is_not_recorded_keeps_nothing() -> None:
    live = driver(*SINGLE)
    live.prepare()
    live._bus = Script(pieces(1, 10), live.counts, np.random.default_rng(1))
    live.read(0.0)
    assert live.take_capture() is None
