"""An agent that is behind its samples says so once, with an alarm that names the rig, and once when it keeps
up."""

from pathlib import Path

import pytest

from agent.config import load
from agent.records import HealthEvent, Record
from agent.runtime import rig_runtime
from agent.runtime.pending import Lateness
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.sources import Arrival, Use
from agent.types import AlarmTransition
from drivers.port import Counts
from tests.scenario.live import example
from tests.scenario.test_isolation import blocks

S = 1_000_000_000


def said(records: list[Record]) -> list[tuple[str, str]]:
    return [
        (r.cause, r.message) if isinstance(r, HealthEvent) else (f"{r.kind} {r.parameter}", r.to_state)
        for r in records
        if isinstance(r, HealthEvent | AlarmTransition)
    ]


def settled(least_s: float = 0.0) -> Lateness:
    """Return what has watched a rig for longer than a start takes, of which samples wait so long at least."""
    lateness = Lateness("press-7")
    assert not lateness.step(round(least_s * S), 0, 5 * S)
    return lateness


def test_lateness_over_two_seconds_is_told_once_and_its_end_once() -> None:
    lateness, reported = settled(), []
    for waited in (0.01, 1.9, 2.5, 9.0, 3.0, 0.6, 0.3, 0.1):
        reported += lateness.step(round(waited * S), 0, 66 * S)
    assert said(reported) == [
        ("behind", "press-7: computing is 2.5 s behind its samples"), ("source computing", "UNACK"),
        ("recovered", "press-7: computing keeps up again"), ("source computing", "RTNUN"),
    ]  # fmt: skip


def test_lateness_of_a_rig_that_begins_is_told_where_it_is_more_than_learning_takes_or_lasts() -> None:
    beginning = settled()
    assert not [told for at in range(6, 60) for told in beginning.step(9 * S, 0, at * S)]
    assert said(beginning.step(9 * S, 0, 66 * S))[1:] == [("source computing", "UNACK")]
    assert said(settled().step(21 * S, 0, 6 * S))[1:] == [("source computing", "UNACK")]


def test_lateness_that_stood_before_a_restart_is_cleared() -> None:
    lateness = Lateness("press-7")
    lateness.standing = True
    assert [kind for kind, _ in said(lateness.step(0, 0, 0))] == ["recovered", "source computing"]


def test_lateness_is_not_what_two_clocks_differ_by() -> None:
    lateness = settled(2700)
    assert not lateness.step(2701 * S, 0, 66 * S)
    assert lateness.step(2703 * S, 0, 66 * S)


@pytest.mark.parametrize("bus", ["can", "serial", "modbus"])
def test_lateness_on_each_bus_is_one_event_and_one_alarm_that_names_the_rig(
    bus: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = load(example(bus, tmp_path))
    published: list[Record] = []
    rig = RigRuntime(config, published.extend)
    use = Use(config.rig.name, config.source[0].name, (0, 1, 2))
    for number, block in enumerate(blocks(1)):
        late_ns = 21 * S if 5 <= number < 15 else 0
        monkeypatch.setattr(rig_runtime, "monotonic_ns", lambda at=block.arrival_ns + late_ns: at)
        rig.waiting.add(use, Arrival(block, Counts(), None))
        rig.work()
    assert said([record for record in published if "computing" in getattr(record, "message", "")]) == [
        ("behind", "two-mass-rig: computing is 21.0 s behind its samples"), ("source computing", "UNACK"),
        ("recovered", "two-mass-rig: computing keeps up again"), ("source computing", "RTNUN"),
    ]  # fmt: skip
