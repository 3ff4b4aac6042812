"""A CAN daemon that is killed and an adapter that is unplugged, again and again; the kernel's bus:
tests/vcan."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from drivers.conformance import Line
from drivers.port import SampleBlock
from tests import figures
from tests.conformance.test_can_conformance import DaemonLine, FdLine
from tests.conformance.test_can_modes_conformance import SlcanLine
from tests.faults.test_line_chaos import BACK_WITHIN_S, MOST_MB, Source, chaos, play_on, resources

LINES: dict[str, Callable[[], Line]] = {"socketcand": DaemonLine, "slcan": SlcanLine}


class Beside(Source):
    """A line without outages: the counters of all its samples are kept."""

    counters: bytearray

    def __init__(self, line: DaemonLine) -> None:
        self.counters = bytearray()
        super().__init__(line)
        line.daemon.wait_for_clients(1)

    def _take(self, block: SampleBlock) -> None:
        super()._take(block)
        assert block.counter is not None
        self.counters += bytes(block.counter.tolist())


def outages(lines: Sequence[Source], cycles: int) -> list[list[float]]:
    """Take every line away and bring it back, so many times, all at once; return the times that each took to
    return."""
    with ThreadPoolExecutor(len(lines)) as pool:
        return list(pool.map(lambda source: chaos(source, cycles), lines))


def assert_recovers(makers: dict[str, Callable[[], Line]], cycles: int, samples: int = 10) -> None:
    """Hold lines through outages while one beside them plays on: in time, nothing lost there, nothing left
    over."""
    stalls: list[float] = []
    done, beside = threading.Event(), Beside(FdLine())
    sources = {name: Source(make()) for name, make in makers.items()}
    player = threading.Thread(target=play_on, args=(beside, done, stalls, samples))
    player.start()
    try:
        outages(list(sources.values()), 1)
        begun = resources()
        took = outages(list(sources.values()), cycles)
        ended = resources()
        done.set()
        player.join()
        beside.until(lambda: beside.samples == beside.played)
    finally:
        done.set()
        player.join()
        for source in (beside, *sources.values()):
            source.stop()
    worst = {name: max(times) for name, times in zip(sources, took, strict=True)}
    words = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in worst.items())
    figures.figure(
        f"CAN, {cycles} outages each, read again at most this long after the return: {words}; "
        f"the machine itself stood still for {max(stalls):.2f} s at most; "
        f"descriptors, threads, MB {begun} before, {ended} after"
    )
    assert max(worst.values()) <= BACK_WITHIN_S + 2.0 * max(stalls), (worst, max(stalls))
    for source in sources.values():
        assert [event.cause for event in source.events] == ["lost", "recovered"] * (cycles + 1)
    assert not beside.events
    assert bytes(beside.counters) == (np.arange(beside.played) % 256).astype(np.uint8).tobytes()
    assert ended[:2] == begun[:2]
    assert ended[2] - begun[2] < MOST_MB, (begun, ended)


@pytest.mark.realtime
@pytest.mark.parametrize(
    "cycles", [5, pytest.param(200, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_daemons_and_adapters_that_go_and_come_are_read_within_two_seconds_and_others_lose_nothing(
    cycles: int,
) -> None:
    assert_recovers(LINES, cycles)
