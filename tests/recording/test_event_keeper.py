"""Which samples an event record holds: counted in samples, whatever the blocks in which they came."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config import RigConfig, load
from agent.recording import events
from agent.recording.event_files import table_of
from agent.recording.event_writer import Job
from agent.recording.events import EventKeeper
from agent.records import HealthEvent, Record
from agent.types import COMPUTING, WORKER, AlarmTransition, IntArray
from drivers.port import SampleBlock
from tests.scenario.live import example

MS = 1_000_000
START = 1_767_225_600_000_000_000


class Pen:
    """A writer that only remembers."""

    def __init__(self) -> None:
        self.jobs: list[Job] = []
        self.names = 0

    def name(self, kind: str, parameter: str) -> str:
        self.names += 1
        return f"{self.names - 1}-{kind}-{parameter}"

    def submit(self, job: Job) -> None:
        self.jobs.append(job)


class Rig:
    """A keeper, fed like the running agent feeds it."""

    def __init__(self, config: RigConfig) -> None:
        self.now_s = 100.0
        self.pen = Pen()
        self.reported: list[Record] = []
        self.keeper = EventKeeper(config, self.pen, self.reported.extend, lambda: self.now_s)
        self.at = 0

    def feed(self, samples: int, cut: int = 10, raised: Sequence[int] = (), at_once: int = 1) -> None:
        """Take samples in blocks of `cut`, so many of them before they are computed; alarms are raised at
        some."""
        end, seen = self.at + samples, self.at
        while self.at < end:
            rows = min(cut, end - self.at)
            number = np.arange(self.at, self.at + rows)
            block = SampleBlock(
                np.repeat(number[:, None], 3, axis=1).astype(float), self.at * MS, number % 65536
            )
            self.keeper.labelled(stamps)(number)
            self.keeper.take("can", block, 65536)
            self.at += rows
            if self.at >= min(end, seen + cut * at_once):
                self.keeper.see([alarm(n) for n in raised if seen <= n < self.at])
                seen = self.at

    def held(self, place: int) -> IntArray:
        job = self.pen.jobs[place]
        return table_of(job.items, job.labels, job.span).number


def stamps(number: IntArray) -> IntArray:
    return START + number * MS


def alarm(number: int, **changes: object) -> AlarmTransition:
    made = AlarmTransition(
        "press-7", "level", "k1", "high", START + number * MS, "NORM", "UNACK", "limit", "k1 fell"
    )
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> RigConfig:
    path = example("can", tmp_path_factory.mktemp("config"))
    keys = "events = { before_s = 0.3, after_s = 0.2, per_hour = 3 }"
    path.write_text(path.read_text(encoding="utf-8") + keys, encoding="utf-8")
    return load(path)


@pytest.fixture
def rig(config: RigConfig) -> Rig:
    return Rig(config)


@pytest.mark.parametrize("cut", [1, 7, 100, 5000])
def test_record_reaches_from_before_the_alarm_to_after_it(rig: Rig, cut: int) -> None:
    rig.feed(3000, cut, raised=[1500])
    states = [job.record.state for job in rig.pen.jobs]
    assert states == ["recording", "complete"]
    np.testing.assert_array_equal(rig.held(1), np.arange(1200, 1701))


@pytest.mark.parametrize("at_once", [3, 70])
def test_alarm_by_the_first_of_many_blocks_still_has_what_was_before(rig: Rig, at_once: int) -> None:
    rig.feed(1050)
    rig.feed(2100, 10, raised=[1051], at_once=at_once)
    np.testing.assert_array_equal(rig.held(1), np.arange(751, 1252))


def test_what_was_before_is_handed_over_at_once(rig: Rig) -> None:
    rig.feed(1510, 10, raised=[1500])
    assert [job.record.state for job in rig.pen.jobs] == ["recording"]
    np.testing.assert_array_equal(rig.held(0), np.arange(1200, 1510))


@pytest.mark.parametrize("cut", [10, 3000])
def test_alarm_within_a_record_lengthens_it_and_a_later_one_begins_another(rig: Rig, cut: int) -> None:
    rig.feed(3000, cut, raised=[1000, 1150, 1600])
    ends = [job.record for job in rig.pen.jobs if job.record.state == "complete"]
    assert [record.alarms for record in ends] == [2, 1]
    assert [record.t_ns for record in ends] == [START + 1000 * MS, START + 1600 * MS]
    places = [i for i, job in enumerate(rig.pen.jobs) if job.record.state == "complete"]
    np.testing.assert_array_equal(rig.held(places[0]), np.arange(700, 1351))
    np.testing.assert_array_equal(rig.held(places[1]), np.arange(1300, 1801))


def test_restless_alarm_does_not_lengthen_a_record_for_ever(rig: Rig) -> None:
    rig.feed(3000, 10, raised=range(1000, 3000, 50))
    first = next(i for i, job in enumerate(rig.pen.jobs) if job.record.state == "complete")
    assert rig.held(first)[-1] == 1000 + events.LONGEST_RECORD * 200


def test_more_records_than_an_hour_may_have_are_counted_and_told_once(rig: Rig) -> None:
    rig.feed(10_000, 10, raised=range(1000, 10_000, 1000))
    assert rig.pen.names == 3
    assert rig.keeper.skipped == 6
    assert [event.cause for event in rig.reported if isinstance(event, HealthEvent)] == [
        "event records skipped"
    ]
    rig.now_s += 3601.0
    rig.feed(2000, 10, raised=[11_000])
    assert rig.pen.names == 4


def test_record_ends_where_no_samples_come_any_more(rig: Rig) -> None:
    rig.feed(1510, 10, raised=[1500])
    rig.now_s += 0.1
    rig.keeper.poll()
    assert len(rig.pen.jobs) == 1
    rig.now_s += 0.2 + events.PATIENCE_S
    rig.keeper.poll()
    assert (rig.pen.jobs[1].record.state, rig.pen.jobs[1].record.message) == (
        "complete",
        "no more samples came",
    )


def test_record_of_an_agent_that_is_stopped_says_that_it_is_cut(rig: Rig) -> None:
    rig.feed(1510, 10, raised=[1500])
    rig.keeper.finish()
    rig.keeper.finish()
    assert [job.record.state for job in rig.pen.jobs] == ["recording", "cut"]
    assert "stopped" in rig.pen.jobs[1].record.message


def test_alarm_that_clears_or_is_acknowledged_makes_no_record(rig: Rig) -> None:
    rig.feed(100)
    rig.keeper.see([alarm(50, to_state="RTNUN"), alarm(50, to_state="ACKED")])
    assert rig.pen.jobs == []


def test_alarm_that_years_lead_to_makes_no_record(rig: Rig) -> None:
    rig.feed(100)
    rig.keeper.see([alarm(50, kind="forecast"), alarm(50, kind="rate")])
    assert rig.pen.jobs == []


@pytest.mark.parametrize("name", [COMPUTING, WORKER])
def test_alarm_of_the_agent_itself_makes_no_record(rig: Rig, name: str) -> None:
    rig.feed(100)
    rig.keeper.see([alarm(50, kind="source", parameter=name)])
    rig.feed(400)
    assert rig.pen.jobs == []


def test_alarm_of_a_source_is_placed_at_the_newest_sample(rig: Rig) -> None:
    rig.feed(1000)
    rig.keeper.see([alarm(0, kind="source", parameter="can", t_ns=123)])
    assert rig.held(0)[-1] == 999
    assert len(rig.held(0)) == 301


def test_memory_is_bounded_by_time_and_by_bytes(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.feed(5000)
    memory = rig.keeper._memory
    assert sum(len(item.block) for item in memory.items) <= 650
    assert sum(len(labels.number) for labels in memory.labels) <= 650
    monkeypatch.setattr(events, "MOST_BYTES", 10_000)
    rig.feed(1000)
    assert memory.held == sum(map(events.bytes_of, memory.items)) <= 10_000


def test_memory_is_bounded_where_samples_come_and_none_of_them_is_labelled(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events, "MOST_BYTES", 100_000)
    for number in range(2000):  # of one source, while the one whose samples make rows is away
        rig.keeper.take("can", SampleBlock(np.zeros((1, 3)), number * MS, np.array([number])), 65536)
        rig.keeper.see([])
    assert len(rig.keeper._memory.items) <= 100


def test_repeated_and_late_samples_stand_in_no_record(rig: Rig) -> None:
    rig.feed(1400)
    rig.at -= 20
    rig.feed(200, raised=[1500])
    held = rig.held(0)
    np.testing.assert_array_equal(held, np.unique(held))


def test_counters_that_wrap_are_numbered_on(rig: Rig) -> None:
    rig.feed(66_000, 500, raised=[65_600])
    np.testing.assert_array_equal(rig.held(1), np.arange(65_300, 65_801))


def test_record_without_configuration_to_the_contrary_is_ten_seconds_each_side(tmp_path: Path) -> None:
    limits = load(example("can", tmp_path)).store.events
    assert (limits.before_s, limits.after_s, limits.max_count, limits.max_mb, limits.per_hour) == (
        10,
        10,
        100,
        100,
        12,
    )
