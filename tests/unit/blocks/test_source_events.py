"""What is told of a source: once an episode, by its most telling cause."""

from agent.blocks.source_events import Signs, SourceEvents
from agent.blocks.tuning import QUIET_NS, SETTLE_NS

MS = 1_000_000


def signs(*, restarts: int = 0, gaps: int = 0, faults: dict[str, int] | None = None, **lost: int) -> Signs:
    return Signs(
        restarts, {name.replace("_", " "): count for name, count in lost.items()}, faults or {}, gaps
    )


def begun() -> SourceEvents:
    events = SourceEvents()
    assert events.step("line", signs(crc=2), 0) is None
    return events


def test_step_first_block_is_what_later_counts_are_held_against() -> None:
    events = begun()
    assert events.step("line", signs(crc=2), 10 * QUIET_NS) is None
    assert events.finish() == {}


def test_step_broken_frame_and_its_gap_are_one_event_named_after_the_frame() -> None:
    events = begun()
    assert events.step("line", signs(crc=3, gaps=1), 100 * MS) is None
    reported = [events.step("line", signs(crc=3, gaps=1), 100 * MS + k * SETTLE_NS) for k in (1, 2, 3)]
    assert reported == [("crc", 1), None, None]


def test_step_gap_that_is_seen_before_its_cause_does_not_name_the_episode() -> None:
    events = begun()
    events.step("line", signs(crc=2, gaps=1), 100 * MS)
    events.step("line", signs(crc=2, gaps=1, backwards=90), 150 * MS)
    events.step("line", signs(crc=2, gaps=1, backwards=101, restarts=1), 200 * MS)
    assert events.step("line", signs(crc=2, gaps=1, backwards=101, restarts=1), 400 * MS) == ("restart", 1)


def test_step_trouble_that_goes_on_is_told_once_and_again_after_quiet() -> None:
    events = begun()
    reported = [events.step("line", signs(crc=2 + min(k, 20)), (k + 1) * 100 * MS) for k in range(60)]
    reported.append(events.step("line", signs(crc=30), 7000 * MS))
    reported.append(events.step("line", signs(crc=30), 7300 * MS))
    assert [one for one in reported if one] == [("crc", 4), ("crc", 8)]


def test_told_link_that_was_lost_explains_what_is_counted_until_it_has_been_back_for_a_while() -> None:
    events = begun()
    events.reported("line", 100 * MS, away=True)
    events.reported("line", 9_000 * MS, away=False)
    assert events.step("line", signs(crc=2, gaps=1, faults={"stray bytes": 5}), 9_000 * MS) is None
    assert events.step("line", signs(crc=2, gaps=1, faults={"stray bytes": 5}), 9_500 * MS) is None
    assert events.finish() == {}
    events.step("line", signs(crc=2, gaps=2, faults={"stray bytes": 5}), 11_000 * MS)
    assert events.finish() == {"line": ("gap", 1)}


def test_step_samples_of_another_source_or_a_channel_at_fault_are_no_event() -> None:
    events = begun()
    events.step("line", signs(crc=2, unpaired=7, stuck=100, saturated=3), 100 * MS)
    assert events.finish() == {}
