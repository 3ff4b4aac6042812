"""A wall clock that is wrong deletes nothing, hides nothing, and the newest row is the one that came last."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from agent.clock import SampleLabels
from agent.records import ClockRecord, RunInfo
from agent.storage.read import queries
from agent.storage.read.points import points_of
from agent.storage.tables.ages import Part, shifts
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from tests.storage.rows import START, batch, ledger, select

SECOND = 10**9
HOUR, DAY, YEAR = 3600 * SECOND, 86_400 * SECOND, 365 * 86_400 * SECOND
TO_1995 = 788_918_400 * SECOND - START
KEEP = Retention(full_s=3 * 3600.0, minute_s=12 * 3600.0)
STEPS = {
    "+1 s": SECOND, "-1 s": -SECOND, "+1.5 s": 3 * SECOND // 2, "+1 h": HOUR, "-1 h": -HOUR,
    "-2 h": -2 * HOUR,
    "+1 year": YEAR, "1995": TO_1995,
}  # fmt: skip


@dataclass
class Machine:
    """A machine with a wall clock that may be wrong, whose true time is known; its agent stores a row each 10
    s.

    Attributes:
        true_ns: since the first start; stands still only while nothing does.
        error_ns: what the wall clock is ahead.
        begun: true time at which its boots began: the monotonic clock counts from there.
        truth: true time of each row, by its number.
    """

    path: Path
    keep: Retention = KEEP
    true_ns: int = 0
    error_ns: int = 0
    boot: int = 0
    begun: int = 0
    truth: dict[int, int] = field(default_factory=dict)

    @property
    def offset_ns(self) -> int:
        return START + self.begun + self.error_ns

    def reboot(self, off_ns: int = 60 * SECOND) -> None:
        """Let the machine be off; its monotonic clock begins anew."""
        self.true_ns += off_ns
        self.begun, self.boot = self.true_ns, self.boot + 1

    def run(self, *stretches: tuple[int, int]) -> None:
        """Let an agent run; stretches: how long, ns, and the error of the wall clock meanwhile."""
        labels, sample = SampleLabels(0.1), 0
        self.error_ns = stretches[0][1]
        with Store.open(self.path, self.keep) as store:
            boot = f"boot-{self.boot}"
            run = RunInfo("press-7", "live", self.wall_ns, "0.1.0", "ab" * 32, None, boot, self.offset_ns)
            run_id = store.begin_run(run)
            for length_ns, error_ns in stretches:
                self.error_ns = error_ns
                for sizes in _cut(length_ns // (10 * SECOND)):
                    index = np.arange(sample, sample + sizes, dtype=np.int64)
                    sample += sizes
                    self._store(store, run_id, labels, index)
            store.maintain(finish=True)

    @property
    def wall_ns(self) -> int:
        return self.offset_ns + self.true_ns - self.begun

    def _store(self, store: Store, run_id: int, labels: SampleLabels, index: np.ndarray) -> None:  # type: ignore[type-arg]
        true = self.true_ns + 10 * SECOND * (1 + np.arange(len(index)))
        self.true_ns = int(true[-1])
        t_ns = labels.label(index, self.true_ns - self.begun, self.offset_ns)
        clocks = [ClockRecord("press-7", a.label_ns, a.first, a.offset_ns) for a in labels.anchors]
        labels.anchors.clear()
        first = store.numbers.high("hops") + 1
        rows = batch(len(index), t_ns=t_ns, index=index, parameters=("k1",))
        store.write(run_id, [*clocks, rows, ledger(int(t_ns[-1]), received=int(index[-1]))])
        self.truth |= dict(zip(range(first, first + len(index)), true.tolist(), strict=True))
        store.maintain()

    def lost(self) -> list[int]:
        """Return the rows that retention by true age would keep and that are gone."""
        left = {seq for (seq,) in select(self.path, "SELECT seq FROM hops WHERE span = 0")}
        young = {seq for seq, true in self.truth.items() if self.true_ns - true < self.keep.full_s * SECOND}
        return sorted(young - left)

    def shown(self) -> set[int]:
        """Return the numbers of samples of full rows that v_estimates shows."""
        return {t for (t,) in select(self.path, "SELECT t_ns FROM v_estimates WHERE span_s = 0")}


def _cut(rows: int) -> Iterator[int]:
    for first in range(0, rows, 180):
        yield min(180, rows - first)


@pytest.fixture
def machine(memory: Path) -> Machine:
    return Machine(memory / "rig.db")


@pytest.mark.parametrize("step", STEPS.values(), ids=STEPS)
@pytest.mark.parametrize("moment", ["before", "in", "after"])
def test_step_of_the_wall_clock_loses_no_row_that_true_age_would_keep(
    machine: Machine, step: int, moment: str
) -> None:
    machine.run((2 * HOUR, 0))
    if moment == "before":
        machine.run((60 * SECOND, step))
    elif moment == "in":
        machine.run((600 * SECOND, 0), (600 * SECOND, step), (600 * SECOND, 0))
    else:
        machine.run((600 * SECOND, 0), (600 * SECOND, step))
    assert machine.lost() == []
    for reboot in (False, True):
        if reboot:
            machine.reboot()
        machine.run((60 * SECOND, step))
        machine.run((60 * SECOND, 0))
        assert machine.lost() == []
    (newest,) = select(machine.path, "SELECT t_ns FROM v_latest")[0]
    assert newest == machine.wall_ns


@pytest.mark.parametrize("step", STEPS.values(), ids=STEPS)
def test_rows_around_a_step_are_purged_by_true_age(machine: Machine, step: int) -> None:
    machine.run((HOUR, 0), (HOUR, step), (8 * HOUR, 0))
    left = {seq for (seq,) in select(machine.path, "SELECT seq FROM hops WHERE span = 0")}
    old = {seq for seq, true in machine.truth.items() if machine.true_ns - true > 5 * HOUR}
    assert len(old & left) <= 360  # the hour in which the clock was stepped waits for the end of the run
    assert machine.lost() == []
    minutes = select(machine.path, "SELECT sum(n) FROM v_tiers WHERE span_s = 60")[0][0]
    assert minutes == len(machine.truth)


@pytest.mark.parametrize("step", [-2 * HOUR, TO_1995, YEAR], ids=["-2 h", "1995", "+1 year"])
@pytest.mark.parametrize("restart", [False, True])
def test_newest_since_and_trend_follow_time_and_not_the_stamp(
    machine: Machine, step: int, restart: bool
) -> None:
    if restart:
        machine.run((HOUR, 0))
        machine.run((600 * SECOND, step))
    else:
        machine.run((HOUR, 0), (600 * SECOND, step))
    now = machine.wall_ns
    ((newest, value),) = select(machine.path, "SELECT t_ns, value FROM v_latest")
    assert newest == now
    assert queries.latest(machine.path)[0]["t_ns"] == now
    rows = queries.estimates(machine.path, since="50s")
    assert [row["t_ns"] for row in rows] == [now - 10 * SECOND * i for i in range(5, -1, -1)]
    points = points_of(machine.path, None, "k1", since="50s")
    assert points.t_ns.tolist() == [row["t_ns"] for row in rows]
    assert points.value[-1] == value
    every = points_of(machine.path, None, "k1")
    assert len(every.t_ns) == 420
    assert restart or every.clock_steps == 1
    if not (restart and step > 0):  # then nothing contradicts the clock yet
        np.testing.assert_array_less(np.diff(every.t_ns), 70 * SECOND)
    assert len(queries.estimates(machine.path)) == 420


def test_excursion_of_three_seconds_moves_nothing_once_it_is_over(machine: Machine) -> None:
    machine.run((HOUR, 0))
    machine.run((60 * SECOND, YEAR))
    machine.run((HOUR, 0))
    rows = queries.estimates(machine.path, since="90m")
    assert len(rows) == 541
    assert rows[-1]["t_ns"] == machine.wall_ns
    points = points_of(machine.path, None, "k1")
    np.testing.assert_array_less(np.diff(points.t_ns), 70 * SECOND)


def test_clock_that_flaps_between_two_settings_makes_two_parts(machine: Machine) -> None:
    machine.run(*[(60 * SECOND, YEAR * (i % 2)) for i in range(20)])
    assert select(machine.path, "SELECT count(*) FROM runs") == [(2,)]
    assert select(machine.path, "SELECT count(*), count(DISTINCT run_id) FROM v_estimates") == [(120, 1)]
    assert select(machine.path, "SELECT count(*) FROM v_runs") == [(1,)]
    assert len({row["t_ns"] for row in queries.estimates(machine.path)}) == 120
    assert queries.health(machine.path)[0]["received"] == 119


def test_clock_that_was_a_year_ahead_for_a_moment_leaves_the_newest_ledger(machine: Machine) -> None:
    machine.run((60 * SECOND, 0), (60 * SECOND, YEAR), (60 * SECOND, 0))
    assert [row["received"] for row in queries.health(machine.path)] == [17]


def test_pause_counts_once_the_clock_is_confirmed_on_both_sides(machine: Machine) -> None:
    for _ in range(2):
        machine.run((14 * HOUR, 0))
        machine.reboot()
    machine.reboot(10 * DAY)
    machine.run((60 * SECOND, 0))
    kept = select(machine.path, "SELECT count(*) FROM hops WHERE span = 60")[0][0]
    assert kept > 600  # twelve hours of minutes by the time that ran, though all are ten days old
    for _ in range(2):
        machine.run((14 * HOUR, 0))
    assert select(machine.path, "SELECT min(t_ns) FROM hops WHERE span = 60")[0][0] > START + 10 * DAY
    assert machine.lost() == []


def test_clock_stays_known_when_a_damaged_file_is_replaced(
    memory: Path, caplog: pytest.LogCaptureFixture
) -> None:
    offset, index = START, np.arange(200, 210)
    run = RunInfo("press-7", "live", START, "0.1.0", "ab" * 32, None, "boot-0", offset)
    ahead = {"t_ns": START + YEAR + HOUR + SECOND * index, "index": index}
    with Store.open(memory / "rig.db") as store:
        one = store.begin_run(run)
        store.write(one, [ClockRecord("press-7", START, 0, offset), batch(10, index=np.arange(10))])
        store.write(one, [ClockRecord("press-7", START + YEAR, 100, offset + YEAR), batch(10, **ahead)])
        store.recover("planted")
        store.write(store.begin_run(run), [batch(10, **(ahead | {"t_ns": ahead["t_ns"] + HOUR}))])
    assert queries.latest(memory / "rig.db")[0]["t_ns"] == ahead["t_ns"][-1] + HOUR
    kept = select(memory / "rig.db", "SELECT offset_ns FROM clocks ORDER BY seq")
    assert kept == [(offset,), (offset + YEAR,), (offset + YEAR,)]
    assert not [record for record in caplog.records if "wall clock" in record.getMessage()]


def part(run: int, begin_s: int, length_s: int, ahead_s: int = 0) -> Part:
    return Part(
        run, run, True, 0, (begin_s + ahead_s) * SECOND, (begin_s + ahead_s + length_s) * SECOND, True
    )


@pytest.mark.parametrize("wrong", [YEAR // SECOND, -YEAR // SECOND])
def test_runs_with_a_wrong_clock_are_passed_over(wrong: int) -> None:
    parts = [part(1, 0, 900), part(2, 1000, 50, wrong), part(3, 2000, 100)]
    found = shifts(parts)
    true = [(p.from_ns + found[p.seq]) // SECOND for p in parts]
    assert (true[0], true[2]) == (0, 2000)
    assert 900 <= true[1] <= 2000
    assert shifts(parts, confirmed=True)[1] == 1050 * SECOND  # nothing but what ran counts


def test_each_step_between_runs_is_one_event_and_one_warning(
    machine: Machine, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        machine.run((60 * SECOND, 0))
        machine.run((60 * SECOND, HOUR))
        machine.run((60 * SECOND, HOUR))
        machine.reboot()
        machine.run((60 * SECOND, TO_1995))
    words = [
        message for (message,) in select(machine.path, "SELECT message FROM v_events WHERE source = 'clock'")
    ]
    assert ["+3600.000 s" in words[0], "behind" in words[1], len(words)] == [True, True, 2]
    assert sum("wall clock" in record.getMessage() for record in caplog.records) == 2
