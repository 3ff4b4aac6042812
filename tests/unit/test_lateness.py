"""An agent that is behind its samples says so once, with an alarm that names the rig, and once when it keeps up."""

from agent.runtime.pending import Lateness
from agent.types import AlarmTransition, HealthEvent, Record

S = 1_000_000_000


def said(records: list[Record]) -> list[tuple[str, str]]:
    return [
        (r.cause, r.message) if isinstance(r, HealthEvent) else (f"{r.kind} {r.parameter}", r.to_state)
        for r in records
        if isinstance(r, HealthEvent | AlarmTransition)
    ]


def test_lateness_over_two_seconds_is_told_once_and_its_end_once() -> None:
    lateness, reported = Lateness("press-7"), []
    for waited in (0.01, 1.9, 2.5, 9.0, 3.0, 0.6, 0.3, 0.1):
        reported += lateness.step(round(waited * S), 0)
    assert said(reported) == [
        ("behind", "press-7: computing is 2.5 s behind its samples"), ("source computing", "UNACK"),
        ("recovered", "press-7: computing keeps up again"), ("source computing", "RTNUN"),
    ]  # fmt: skip


def test_lateness_that_stood_before_a_restart_is_cleared() -> None:
    lateness = Lateness("press-7")
    lateness.standing = True
    assert [kind for kind, _ in said(lateness.step(0, 0))] == ["recovered", "source computing"]


def test_lateness_is_not_what_two_clocks_differ_by() -> None:
    lateness = Lateness("press-7")
    assert not lateness.step(2700 * S, 0)
    assert not lateness.step(2701 * S, 0)
    assert lateness.step(2703 * S, 0)
