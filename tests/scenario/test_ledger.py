"""The ledger while a source is silent, or sends nothing that could be used: it tells what was counted all the
same."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.runtime.replay import replay
from agent.runtime.service import Service
from drivers.port import Counts, SampleBlock
from drivers.reconnect import Delivery
from tests.scenario.live import example, rows

LEDGER = "SELECT received, used, rejected, dropped FROM v_health ORDER BY received"


class Told:
    """One source of a running service whose driver is played by the test, turn after turn."""

    def __init__(self, service: Service, db: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.service, self.db = service, db
        (self.connection,) = service.connections
        (self.writer,) = service.writers.values()
        self._count, self._next = self._nothing, np.arange(0)
        self.connection._driver.counter_modulus = 2**32
        monkeypatch.setattr(self.connection._link, "read", self._read)

    def _nothing(self, _counts: Counts) -> None: ...

    def _read(self, _timeout_s: float) -> Delivery:
        counts, counter = self.connection._driver.counts, self._next
        counts.received += len(counter)
        self._count(counts)
        arrival = (int(counter[-1]) if len(counter) else 0) * 1_000_000
        return Delivery(
            SampleBlock(np.random.default_rng(1).normal(size=(len(counter), 3)), arrival, counter), ()
        )

    def samples(self, first: int, count: int) -> None:
        """Let samples arrive."""
        self._count, self._next = self._nothing, np.arange(first, first + count)
        self.connection._turn()

    def nothing_but(self, count: Callable[[Counts], None]) -> None:
        """Let the driver count something in a read that brings no sample."""
        self._count, self._next = count, np.arange(0)
        self.connection._turn()

    def ledger(self) -> list[tuple[int, ...]]:
        """Let the next ledger be told; return all that are stored."""
        self.service.process()
        self.service.rig_set.ledgers()
        assert self.writer.flush()
        return rows(self.db, LEDGER)


@pytest.fixture
def reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Told]:
    db = tmp_path / "rig.db"
    service = Service([load(example("modbus", tmp_path))], db, "live")
    (writer,) = service.writers.values()
    writer.start()
    yield Told(service, db, monkeypatch)
    writer.stop()


def refused(counts: Counts) -> None:
    """Count thirty broken frames."""
    counts.received += 30
    counts.rejected["crc"] += 30


def overrun(counts: Counts) -> None:
    """Count samples that a device overwrote before they were read."""
    counts.dropped["overrun"] += 70


def test_ledger_of_a_silent_source_is_one_row(reported: Told) -> None:
    reported.samples(0, 50)
    assert [reported.ledger() for _ in range(4)] == [[(50, 50, 0, 0)]] * 4
    reported.samples(50, 50)
    assert reported.ledger() == [(50, 50, 0, 0), (100, 100, 0, 0)]


def test_ledger_of_a_source_that_was_never_heard_is_one_row(reported: Told) -> None:
    assert [reported.ledger() for _ in range(4)] == [[(0, 0, 0, 0)]] * 4


def test_replay_ends_with_one_row_of_the_ledger(tmp_path: Path) -> None:
    recording, db = tmp_path / "short.csv", tmp_path / "replayed.db"
    values = np.random.default_rng(2).normal(size=(400, 3)).tolist()
    lines = [f"{number / 1000},{a},{b},{c}" for number, (a, b, c) in enumerate(values)]
    recording.write_text("\n".join(["t,force,x1,x2", *lines]), encoding="utf-8")
    document = replay(config=example("modbus", tmp_path), recordings=[recording], db=db)
    found = rows(db, "SELECT t_ns, received, used + rejected + dropped FROM v_health")
    assert found == [(399_000_000, 400, 400)]
    assert document["samples"]["received"] == 400


def test_ledger_tells_what_was_refused_after_the_last_good_sample(reported: Told) -> None:
    reported.samples(0, 50)
    reported.ledger()
    reported.nothing_but(refused)
    reported.nothing_but(overrun)
    assert reported.ledger() == [(150, 50, 30, 70)]
    (rig,) = reported.service.rigs.values()
    assert rig.summary.samples() == {
        "received": 150, "used": 50, "rejected": {"crc": 30}, "dropped": {"overrun": 70}, "gaps": 0,
    }  # fmt: skip


def test_ledger_tells_what_was_refused_of_a_source_without_any_good_sample(reported: Told) -> None:
    reported.nothing_but(refused)
    assert reported.ledger() == [(30, 0, 30, 0)]
    reported.nothing_but(overrun)
    assert reported.ledger() == [(100, 0, 30, 70)]
    reported.samples(0, 50)
    assert reported.ledger()[-1] == (150, 50, 30, 70)


def test_ledger_balances_in_every_row_while_samples_wait_and_frames_are_refused(reported: Told) -> None:
    for number in range(5):
        reported.samples(50 * number, 50)
        reported.nothing_but(refused)
        found = reported.ledger()
        assert found[-1] == (80 * (number + 1), 50 * (number + 1), 30 * (number + 1), 0)
    assert reported.connection.counts.rejected == Counter(crc=150)
