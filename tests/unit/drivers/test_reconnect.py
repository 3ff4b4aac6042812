import random
import threading
from collections import deque
from typing import ClassVar

import numpy as np
import pytest

from drivers.port import Driver, DriverConfigError, DriverIOError, DriverSettings, SampleBlock, SourceRequest
from drivers.reconnect import Backoff
from drivers.tuning import RETRY_HERE_S, RETRY_S
from tests.links import NotedLink


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


class Scripted(Driver):
    """Does what its script says at each open and read: a number of samples, or an error."""

    settings_model: ClassVar[type[DriverSettings]] = DriverSettings

    def __init__(self) -> None:
        super().__init__(SourceRequest("press", DriverSettings(), ("a",)))
        self.opens: deque[Exception | None] = deque()
        self.reads: deque[Exception | int] = deque()
        self.closed = 0

    def open(self) -> None:
        step = self.opens.popleft() if self.opens else None
        if step:
            raise step

    def read(self, timeout_s: float) -> SampleBlock:
        step = self.reads.popleft() if self.reads else 0
        if isinstance(step, Exception):
            raise step
        return SampleBlock(np.zeros((step, 1)), 0)

    def close(self) -> None:
        self.closed += 1

    def resolution(self) -> tuple[float, ...]:
        return (0.0,)


class Stop(threading.Event):
    """An event on which waiting costs no time and moves the clock."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        self.clock.now += timeout or 0.0
        return self.is_set()


@pytest.fixture
def parts() -> tuple[Scripted, NotedLink, Clock]:
    clock, driver = Clock(), Scripted()
    wrapper = NotedLink(driver, 2.0, clock=clock, rng=random.Random(1), stop=Stop(clock))
    return driver, wrapper, clock


Parts = tuple[Scripted, NotedLink, Clock]


def causes(wrapper: NotedLink) -> list[str]:
    return [event.cause for event in wrapper.take_events()]


def test_read_of_a_sound_source_passes_its_samples_without_events(parts: Parts) -> None:
    driver, wrapper, _ = parts
    driver.reads.extend([3, 0, 2])
    assert [len(wrapper.read(0.1)) for _ in range(3)] == [3, 0, 2]
    assert causes(wrapper) == []


def test_source_that_cannot_be_opened_is_tried_for_ever_and_said_once(parts: Parts) -> None:
    driver, wrapper, clock = parts
    driver.opens.extend([DriverIOError("refused")] * 50)
    driver.reads.append(4)
    begun = clock.now
    got = [len(wrapper.read(0.2)) for _ in range(600)]
    assert sum(got) == 4
    assert causes(wrapper) == ["lost", "recovered"]
    assert clock.now - begun <= 50 * RETRY_S + 600 * 0.2


class Local(Scripted):
    """A source of which the machine knows by itself whether it is there."""

    @property
    def retry_s(self) -> float:
        return RETRY_HERE_S


def test_source_that_is_known_to_be_there_or_not_is_tried_more_often(parts: Parts) -> None:
    _, _, clock = parts
    driver = Local()
    wrapper = NotedLink(driver, 2.0, clock=clock, rng=random.Random(1), stop=Stop(clock))
    driver.opens.extend([DriverIOError("no such device")] * 60)
    pauses = []
    for _ in range(60):
        wrapper.read(0.0)
        pauses.append(wrapper.retry_in_s())
        clock.now += pauses[-1]
    assert max(pauses) <= RETRY_HERE_S
    assert len(driver.opens) == 0


def test_pauses_double_up_to_the_ceiling_with_jitter_and_start_anew() -> None:
    backoff = Backoff(random.Random(2), 0.1, 1.5)
    pauses = [backoff.next_s() for _ in range(12)]
    bounds = [0.1, 0.2, 0.4, 0.8] + [1.5] * 8
    assert all(bound / 2 <= pause <= bound for pause, bound in zip(pauses, bounds, strict=True))
    assert len(set(pauses)) == 12
    backoff.reset()
    assert backoff.next_s() <= 0.1


def test_source_that_returns_is_read_within_two_seconds(parts: Parts) -> None:
    driver, wrapper, clock = parts
    driver.opens.extend([DriverIOError("gone")] * 30)
    while driver.opens:
        wrapper.read(0.05)
    returned = clock.now
    driver.reads.append(1)
    while not len(wrapper.read(0.05)):
        assert clock.now - returned < 2.0


def test_read_that_fails_closes_the_source_and_says_why(parts: Parts) -> None:
    driver, wrapper, _ = parts
    driver.reads.extend([1, DriverIOError("unplugged")])
    wrapper.read(0.1)
    assert len(wrapper.read(0.1)) == 0
    assert driver.closed == 1
    assert not wrapper.is_open
    assert 0 < wrapper.retry_in_s() <= 0.1
    (event,) = wrapper.take_events()
    assert (event.cause, event.message) == ("lost", "unplugged")


def test_source_that_cannot_even_be_closed_is_opened_again(
    parts: Parts, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, wrapper, clock = parts
    driver.reads.extend([1, DriverIOError("unplugged"), 2])

    def gone() -> None:
        raise OSError("no such device")

    monkeypatch.setattr(driver, "close", gone)
    got = 0
    for _ in range(4):
        got += len(wrapper.read(0.2))
        clock.now += 0.2
    assert got == 3
    assert causes(wrapper) == ["lost", "recovered"]


def test_silence_beyond_stale_s_is_said_once_and_reopens(parts: Parts) -> None:
    driver, wrapper, clock = parts
    wrapper.read(0.1)
    for _ in range(100):
        clock.now += 0.5
        wrapper.read(0.1)
    assert causes(wrapper) == ["stale"]
    assert driver.closed > 5
    driver.reads.append(1)
    while not len(wrapper.read(0.1)):
        clock.now += 0.1
    assert causes(wrapper) == ["recovered"]


def test_line_that_talks_rubbish_is_not_called_silent(parts: Parts) -> None:
    driver, wrapper, clock = parts
    driver.reads.append(1)
    driver.counts.rejected["crc"] = 7  # before the last good sample: another matter
    wrapper.read(0.1)
    for _ in range(3):
        driver.counts.rejected["sync"] += 100
        driver.counts.faults["stray bytes"] += 5
        clock.now += 1.0
        wrapper.read(0.1)
    (event,) = wrapper.take_events()
    assert (event.cause, event.message) == (
        "stale",
        "press: no good sample for 2 s: 300 sync, 15 stray bytes",
    )


def test_config_error_passes_through(parts: Parts) -> None:
    driver, wrapper, _ = parts
    driver.opens.append(DriverConfigError("no such field"))
    with pytest.raises(DriverConfigError):
        wrapper.read(0.1)


def test_flapping_source_gives_one_event_a_fault_and_one_a_recovery(parts: Parts) -> None:
    driver, wrapper, _ = parts
    for _ in range(20):
        driver.reads.extend([1, DriverIOError("gone")])
    while driver.reads:
        wrapper.read(0.1)
    assert causes(wrapper) == ["lost", "recovered"] * 19 + ["lost"]
