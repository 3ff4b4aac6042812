"""Rings behind links of every speed: what the link carries is delivered, each sample once and none torn."""

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from drivers.fields import ByteArray
from drivers.modbus.frames import Request
from drivers.modbus.ring import RingReader
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.units import LaterError
from drivers.port import Counts, DriverIOError, IntArray, SampleBlock, SourceRequest
from tests.unit.drivers.played_line import PlayedLine, played, silent

RATE, RING = 1000, 16
FIELDS = [{"name": "n", "type": "uint32"}, {"name": "x", "type": "int16"}]
Delay = Callable[[float], float]
"""Gives how long the request asked at a time takes, s; half of it passes before the device reads its
registers."""


@dataclass
class Link:
    """A device of 1 kHz whose samples carry their own number, and the reader at the other end of a link."""

    line: PlayedLine
    delay: Delay
    slots: int = 1024
    first: int = 5000
    reported: list[str] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    delivered: list[IntArray] = field(default_factory=list)
    oldest: int | None = None

    def __post_init__(self) -> None:
        settings = ModbusSettings.model_validate(
            {
                "mode": "ring",
                "index": {"address": 0},
                "ring": {"address": RING, "slots": self.slots},
                "fields": FIELDS,
            }
        )
        request = SourceRequest("press", settings, ("n",))
        self.reader = RingReader(request, settings, self.counts, lambda _: None)
        self.reader.report = self._reported
        self.begun_ns = self.line.now_ns

    def _reported(self, cause: str, words: str) -> None:
        self.reported.append(f"{cause}: {words}")

    @property
    def time_s(self) -> float:
        return (self.line.now_ns - self.begun_ns) / 1e9

    @property
    def written(self) -> int:
        return self.first + int(self.time_s * RATE)

    def ask(self, request: Request) -> ByteArray:
        """Answer a request; the slot that is written next holds rubbish already."""
        half = self.delay(self.time_s) / 2
        self.line.sleep(half)
        head = self.written
        self.line.sleep(half)
        if request.address == 0:
            self.oldest = head - self.slots + 1 if self.oldest is None else self.oldest
            return np.frombuffer(head.to_bytes(4, "big"), np.uint8)
        slot = (request.address - RING) // 3 + np.arange(request.count // 3)
        number = head - 1 - (head - 1 - slot) % self.slots
        number = np.where(slot == head % self.slots, 0xDEAD, number)
        return self.reader.layout.pack({"n": number, "x": np.zeros(len(slot))}).reshape(-1)

    def run(self, seconds: float) -> None:
        """Read for so long."""
        until = self.time_s + seconds
        while self.time_s < until:
            block = self.read()
            counter = np.empty(0, np.int64) if block.counter is None else block.counter
            assert block.values[:, 0].tolist() == counter.tolist()
            self.delivered.append(counter)

    def read(self) -> SampleBlock:
        return self.reader.read(self.ask, self.line.now_ns / 1e9 + 0.2)

    def numbers(self) -> IntArray:
        """Return all samples delivered, after seeing none came twice and each is counted where it ended."""
        found = np.concatenate(self.delivered)
        assert (np.diff(found) > 0).all()
        assert self.counts.received == len(found) + self.counts.rejected.total()
        assert self.oldest is not None
        assert self.reader._next == self.oldest + self.counts.received + self.counts.dropped.total()
        return found


@pytest.fixture
def line() -> Iterator[PlayedLine]:
    with played(silent) as machine:
        yield machine


def test_ring_behind_a_gateway_too_slow_for_its_rate_delivers_what_the_link_carries(line: PlayedLine) -> None:
    link = Link(line, lambda _: 0.04)
    link.run(60.0)
    found = link.numbers()
    # five or six requests of 41 samples and one for the index in 0.24 s and more
    assert len(found) > 0.7 * 60.0 * RATE
    stretches = np.diff(np.flatnonzero(np.diff(found, prepend=-1, append=-1) != 1))
    assert stretches[stretches > 2.0 * RATE].sum() > 0.9 * len(found)
    (reported,) = link.reported
    assert reported.startswith("too slow: press: the link is too slow for the device")
    assert "of the 1000 samples a second" in reported


def test_ring_whose_every_request_takes_a_fifth_of_it_still_delivers(line: PlayedLine) -> None:
    link = Link(line, lambda _: 0.2)
    link.run(60.0)
    assert len(link.numbers()) > 0.05 * 60.0 * RATE
    assert max(len(part) for part in link.delivered) > 0
    assert len(link.reported) == 1


def test_ring_that_no_answer_comes_in_time_for_says_so_once_a_minute_at_most(line: PlayedLine) -> None:
    link = Link(line, lambda _: 0.2, slots=64)
    link.run(60.0)
    assert len(link.numbers()) == 0
    assert len(link.reported) == 1


def test_ring_after_a_stall_longer_than_itself_loses_no_more_than_was_overwritten(line: PlayedLine) -> None:
    link = Link(line, lambda now: 1.4 if 5.0 < now < 5.02 else 0.004)
    link.run(20.0)
    found = link.numbers()
    lost = int(found[-1] - found[0]) + 1 - len(found)
    assert 300 < lost < 700
    assert link.reported == []


def test_ring_whose_link_recovers_is_read_without_a_gap_again(line: PlayedLine) -> None:
    link = Link(line, lambda now: 0.04 if now < 20.0 else 0.004)
    link.run(30.0)
    link.delivered.clear()
    lost = link.counts.dropped.total() + link.counts.rejected.total()
    link.run(10.0)
    assert (np.diff(np.concatenate(link.delivered)) == 1).all()
    assert link.counts.dropped.total() + link.counts.rejected.total() == lost


def test_ring_that_grows_slow_again_after_a_good_while_says_so_again(line: PlayedLine) -> None:
    link = Link(line, lambda now: 0.04 if now < 20.0 or now > 120.0 else 0.004)
    link.run(140.0)
    link.numbers()
    assert len(link.reported) == 2


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("slots", "share"), [(20, 0.03), (100, 0.3), (1024, 0.8)])
def test_ring_behind_a_link_of_any_mood_delivers_each_sample_once_and_none_torn(
    line: PlayedLine, seed: int, slots: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    moods = [0.001, 0.005, 0.02, 0.04, 0.3]
    link = Link(line, lambda _: float(rng.choice(moods, p=[0.5, 0.2, 0.15, 0.1, 0.05])), slots)
    link.run(30.0)
    assert len(link.numbers()) > share * 30.0 * RATE


class BadLink(Link):
    """The same, but one reply in twenty is none: it does not come in time, or costs the connection."""

    cost_s = 0.3
    dice = random.Random(1)

    def ask(self, request: Request) -> ByteArray:
        if self.dice.random() >= 0.05:
            return super().ask(request)
        self.line.sleep(self.cost_s)
        self.reader.lost_s += self.cost_s
        if self.dice.random() < 0.5:
            raise LaterError(0.0, asked=True)
        raise DriverIOError("reset")

    def read(self) -> SampleBlock:
        try:
            return super().read()
        except LaterError:
            return self.reader.empty()
        except DriverIOError:
            self.line.sleep(0.1)
            self.reader.reopened()
            return self.reader.empty()


@pytest.mark.parametrize("cost_s", [0.05, 0.3])
def test_ring_of_which_one_reply_in_twenty_is_lost_is_read_whole_where_it_is_long_enough(
    line: PlayedLine, cost_s: float
) -> None:
    link = BadLink(line, lambda _: 0.002, 8192, 10_000)
    link.cost_s, link.dice = cost_s, random.Random(2)
    link.run(40.0)
    found = link.numbers()
    # at first contact the oldest slots are about to be overwritten
    assert link.counts.dropped.total() + link.counts.rejected.total() < 500
    assert len(found) > 0.95 * 40.0 * RATE
    assert link.reported == []


def test_ring_too_short_for_what_lost_replies_cost_is_not_called_behind_a_slow_link(line: PlayedLine) -> None:
    link = BadLink(line, lambda _: 0.01, 128)
    link.run(60.0)
    assert link.counts.rejected["overrun"] > 0
    assert len(link.numbers()) > 0.2 * 60.0 * RATE
    assert link.reported == []


def test_ring_behind_a_slow_link_that_loses_replies_too_is_still_called_so(line: PlayedLine) -> None:
    link = BadLink(line, lambda _: 0.1)
    link.run(60.0)
    (reported,) = link.reported
    carried = int(reported.partition("about ")[2].split()[0])
    assert 200 < carried < 450


def test_ring_behind_a_link_that_just_keeps_up_is_called_slow_by_nobody(line: PlayedLine) -> None:
    link = Link(line, lambda _: 0.03)
    link.run(60.0)
    assert len(link.numbers()) > 0.95 * 60.0 * RATE
    assert link.reported == []
