import numpy as np
import pytest

from agent.records import Record
from agent.storage.write.decimation import Thinner
from agent.types import COMPUTING, WORKER, AlarmTransition, EstimateBatch
from tests.storage.rows import HOP, START, batch, ledger, step

SECOND = 10**9


def times(records: list[Record]) -> list[int]:
    return sorted(int(t) for r in records if isinstance(r, EstimateBatch) for t in r.t_ns)


def fed(steps: list[list[Record]], every_s: float = 1.0) -> list[Record]:
    thinner = Thinner(every_s)
    out = [record for records in steps for record in thinner.feed(records)]
    return out + thinner.flush()


def cut(hops: int, sizes: list[int], alarms: list[int]) -> list[list[Record]]:
    """Cut hops into steps; an alarm transition travels in the step of its row."""
    steps: list[list[Record]] = []
    first = 0
    while first < hops:
        size = min(sizes[len(steps) % len(sizes)], hops - first)
        inside = [a for a in alarms if first <= a < first + size]
        steps.append([batch(size, first=first), *(step("NORM", "UNACK", START + a * HOP) for a in inside)])
        first += size
    return steps


def expected(hops: int, alarms: list[int], every: int = SECOND) -> list[int]:
    """Say row by row what the rule keeps."""
    all_times = [START + i * HOP for i in range(hops)]
    newest = {t // every: t for t in all_times}
    near = {t for t in all_times for a in alarms if -10 * SECOND <= t - (START + a * HOP) <= 60 * SECOND}
    return sorted(set(newest.values()) | near)


def test_thinner_with_zero_keeps_everything() -> None:
    records: list[Record] = [batch(7), ledger(), step("NORM", "UNACK")]
    assert Thinner(0.0).feed(records) == records


@pytest.mark.parametrize("sizes", [[1], [3, 17, 1], [400], [5000]])
@pytest.mark.parametrize("alarms", [[], [1500], [0, 1, 2999], [700, 705, 1900]])
def test_thinner_keeps_the_newest_of_each_period_and_all_around_alarms(
    sizes: list[int], alarms: list[int]
) -> None:
    out = fed(cut(3000, sizes, alarms))
    assert times(out) == expected(3000, alarms)
    assert len([r for r in out if isinstance(r, AlarmTransition)]) == len(alarms)


@pytest.mark.parametrize(("name", "is_all_kept"), [(COMPUTING, False), (WORKER, False), ("can", True)])
def test_thinner_keeps_no_more_rows_where_the_agent_itself_is_late_or_began_anew(
    name: str, is_all_kept: bool
) -> None:
    alarm = step("NORM", "UNACK", START + 1500 * HOP, kind="source", parameter=name)
    out = fed([[batch(1500)], [batch(1500, first=1500), alarm]])
    assert times(out) == expected(3000, [1500] if is_all_kept else [])
    assert alarm in out


@pytest.mark.parametrize("every_s", [0.01, 0.05, 0.3, 7.0, 100.0])
def test_thinner_counts_periods_from_the_epoch(every_s: float) -> None:
    assert times(fed(cut(2500, [20], []), every_s)) == expected(2500, [], round(every_s * 1e9))


def test_thinner_passes_on_rows_whole(rng: np.random.Generator) -> None:
    out = fed(cut(200, [7], []))
    row = next(r for r in out if isinstance(r, EstimateBatch) and len(r))
    place = int((row.t_ns[0] - START) // HOP)
    assert row.index[0] == 250 + 50 * place
    assert row.value[0, 2] == 27.0 + 0.1 * np.sin(place)


def test_thinner_holds_a_live_row_back_no_longer_than_its_period() -> None:
    thinner = Thinner(1.0)
    out = [thinner.feed([batch(1, first=i)]) for i in range(41)]
    assert [i for i, records in enumerate(out) if records] == [20, 40]


def test_thinner_whose_time_is_set_back_holds_no_more_rows_than_otherwise() -> None:
    thinner, before, after = Thinner(1.0), [batch(1, first=i) for i in range(1000)], []
    hour = 3600 * SECOND // HOP
    after = [batch(1, first=i, start=START - hour * HOP) for i in range(1000, 2000)]
    kept = [record for one in (*before, *after) for record in thinner.feed([one])]
    assert thinner._held is not None
    assert len(thinner._held) <= 10 * SECOND // HOP + 1
    newest = [START + i * HOP for i in (*range(19, 1000, 20), *range(1019 - hour, 1999 - hour, 20))]
    assert times(kept) == sorted(newest)


def test_thinner_starts_afresh_when_the_reference_changes() -> None:
    changed = batch(30, first=30, reference=np.full(4, 1.0))
    out = [r for r in fed([[batch(30)], [changed]]) if isinstance(r, EstimateBatch)]
    assert [(r.reference[0], times([r])[-1]) for r in out] == [
        (25.0, START + 19 * HOP), (25.0, START + 29 * HOP), (1.0, START + 39 * HOP), (1.0, START + 59 * HOP),
    ]  # fmt: skip
