"""Alarms that operators act on: what is stored, what is refused, and for how long a shelf lasts."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.errors import StoreError
from agent.records import ClockRecord
from agent.storage.operations import command_alarms
from agent.storage.tables.shelves import Moment
from agent.storage.write.alarm_commands import Request, carry_out, expire_shelves
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import AlarmTransition
from tests.storage.rows import START, batch, run_info, select, step

HOUR = 3600 * 10**9
BOOTED = Moment(START, 10**12, "boot-1")


def at(wall_s: float, monotonic_s: float, boot: str = "boot-1") -> Moment:
    return Moment(START + int(wall_s * 1e9), 10**12 + int(monotonic_s * 1e9), boot)


def ask(
    cause: Any, *ids: int, hours: float | None = None, by: str = "eva", comment: str | None = None
) -> Request:
    return Request(cause, ids, by, comment, None if hours is None else int(hours * HOUR))


@pytest.fixture
def store(memory: Path) -> Iterator[Store]:
    with Store.open(memory / "rig.db") as made:
        made.run = made.begin_run(run_info())  # type: ignore[attr-defined]
        made.write(made.run, [step("NORM", "UNACK")])  # type: ignore[attr-defined]
        yield made


def write(store: Store, *steps: Any) -> None:
    store.write(store.run, steps)  # type: ignore[attr-defined]


def alarms(store: Store) -> list[tuple[Any, ...]]:
    return select(
        store.path, "SELECT id, state, acked_by, cleared_at IS NULL, shelved_until IS NULL FROM v_alarms"
    )


def events(store: Store) -> list[tuple[Any, ...]]:
    return select(
        store.path, 'SELECT from_state, to_state, cause, "by", comment FROM v_alarm_events ORDER BY id'
    )


def test_acknowledged_alarm_that_clears_is_normal_though_the_detector_knew_nothing(store: Store) -> None:
    carry_out(store, ask("acknowledge", 1, comment="seen"), at(5, 5))
    assert alarms(store) == [(1, "ACKED", "eva", 1, 1)]
    write(store, step("UNACK", "RTNUN", START + 9, cause="clear"))
    assert alarms(store) == [(1, "NORM", "eva", 0, 1)]
    assert events(store)[1:] == [
        ("UNACK", "ACKED", "acknowledge", "eva", "seen"),
        ("ACKED", "NORM", "clear", None, None),
    ]


def test_alarm_is_acknowledged_once_and_the_second_is_told_by_whom(store: Store) -> None:
    carry_out(store, ask("acknowledge", 1), at(5, 5))
    before = events(store)
    with pytest.raises(
        StoreError, match=r"alarm 1: k1 was acknowledged already, by eva at 2026-01-01T00:00:05"
    ) as two:
        carry_out(store, ask("acknowledge", 1, by="tom"), at(6, 6))
    assert (two.value.exit_code, events(store)) == (3, before)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (ask("acknowledge", 7), "alarm 7: there is no such alarm; deltak alarms"),
        (ask("acknowledge", 2**70), "there is no such alarm"),
        (ask("acknowledge", 1, 7), "alarm 7: there is no such alarm"),
        (ask("unshelve", 1), "alarm 1: k1: it is not shelved"),
        (ask("return", 1), "alarm 1: k1: it is not out of service"),
    ],
)
def test_refused_request_says_why_and_changes_nothing(store: Store, request_: Request, words: str) -> None:
    before = (alarms(store), events(store))
    with pytest.raises(StoreError, match=words):
        carry_out(store, request_, at(5, 5))
    assert (alarms(store), events(store)) == before


def test_shelved_alarm_stays_silent_while_its_condition_comes_and_goes(store: Store) -> None:
    carry_out(store, ask("shelve", 1, hours=1), at(0, 0))
    write(
        store,
        step("UNACK", "RTNUN", START + 9, cause="clear"),
        step("NORM", "UNACK", START + 10, cause="raise"),
    )
    assert alarms(store) == [(1, "SHLVD", None, 1, 0)]
    carry_out(store, ask("unshelve", 1), at(9, 9))
    assert alarms(store) == [(1, "ACKED", "eva", 1, 1)]


def test_alarm_out_of_service_raises_nothing_until_it_is_returned(store: Store) -> None:
    write(store, step("UNACK", "RTNUN", START + 9, cause="clear"))
    carry_out(store, ask("acknowledge", 1), at(1, 1))
    carry_out(store, ask("out of service", 1), at(2, 2))
    write(store, step("NORM", "UNACK", START + 10, cause="raise", delta=-20.0, message="k1 fell by 20 N/m"))
    assert alarms(store) == [(1, "OOSRV", "eva", 1, 1)]
    carry_out(store, ask("return", 1), at(3, 3))
    assert alarms(store) == [(1, "UNACK", None, 1, 1)]
    assert select(store.path, "SELECT delta, message FROM v_alarms") == [(-20.0, "k1 fell by 20 N/m")]


def test_older_activation_can_be_acknowledged_but_not_shelved(store: Store) -> None:
    write(store, step("UNACK", "RTNUN", START + 9), step("RTNUN", "UNACK", START + 10))
    with pytest.raises(StoreError, match="k1 was raised again since, as alarm 2; name 2"):
        carry_out(store, ask("shelve", 1, hours=1), at(1, 1))
    carry_out(store, ask("acknowledge", 1), at(1, 1))
    assert [row[:2] for row in alarms(store)] == [(1, "NORM"), (2, "UNACK")]


@pytest.mark.parametrize("step_s", [-86_400.0, 0.0, 86_400.0 * 365])
def test_shelf_ends_by_elapsed_time_whatever_the_wall_clock_says(store: Store, step_s: float) -> None:
    carry_out(store, ask("shelve", 1, hours=1), at(0, 0))
    assert expire_shelves(store, at(step_s + 3599, 3599)) == []
    (ended,) = expire_shelves(store, at(step_s + 3601, 3601))
    assert (ended.step.cause, ended.step.to_state, alarms(store)[0][1]) == ("expire", "UNACK", "UNACK")


def test_shelf_goes_on_over_restarts_of_the_agent_and_of_the_machine(store: Store) -> None:
    carry_out(store, ask("shelve", 1, hours=2), BOOTED)
    write(store, ClockRecord("press-7", START, 0, START - 10**12), batch(2, hop_ns=HOUR))
    store.close()
    for moment, left in (
        (at(100 * 3600, 3600), True),  # the same boot, the wall clock a hundred hours ahead
        (Moment(START + HOUR + HOUR // 2, 5 * 10**9, "boot-2"), True),  # an hour ran, half an hour nothing
        (Moment(START + HOUR + HOUR // 2, 5 * 10**9 + HOUR // 2 - 10**9, "boot-2"), True),
        (Moment(START + HOUR + HOUR // 2, 5 * 10**9 + HOUR // 2 + 10**9, "boot-2"), False),
    ):
        with Store.open(store.path) as again:
            again.begin_run(run_info())
            assert (expire_shelves(again, moment) == []) is left
    assert alarms(store)[0][1] == "UNACK"


def test_shelf_over_while_nothing_ran_ends_before_the_next_command(store: Store) -> None:
    carry_out(store, ask("shelve", 1, hours=1), at(0, 0))
    carry_out(store, ask("acknowledge", 1), at(7200, 7200))
    assert [e[:3] for e in events(store)[-2:]] == [
        ("SHLVD", "UNACK", "expire"),
        ("UNACK", "ACKED", "acknowledge"),
    ]


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (ask("shelve", 1), "--for: an alarm is not shelved for ever; give a time such as --for 8h"),
        (ask("shelve", 1, hours=24 * 8), "--for: 8 days are not within 7 days"),
        (ask("acknowledge", 1, comment="x" * 2000), "--comment: is no text of at most 1000"),
        (ask("acknowledge", 1, by=""), "--by: is empty"),
        (ask("raise", 1), "is no command on alarms"),
    ],
)
def test_request_that_makes_no_sense_is_refused_by_whoever_reads_it(request_: Request, words: str) -> None:
    with pytest.raises(StoreError, match=words):
        Request.read(request_.document())


def test_comment_is_kept_as_text_whatever_it_looks_like(store: Store) -> None:
    words = "'); DROP TABLE alarms;-- <script>alert(1)</script> \x1b[31m\x00"
    carry_out(store, ask("acknowledge", 1, by=words, comment=words), at(1, 1))
    assert events(store)[-1][3:] == (words, words)


def test_without_an_agent_the_command_takes_the_lock(store: Store) -> None:
    store.close()
    (found,) = command_alarms(store.path, ask("acknowledge", 1))
    assert (found["id"], found["from_state"], found["to_state"], found["by"]) == (1, "UNACK", "ACKED", "eva")
    with pytest.raises(StoreError, match="there is no such database"):
        command_alarms(store.path.with_name("none.db"), ask("acknowledge", 1))


@pytest.fixture
def writer(memory: Path) -> Iterator[StoreWriter]:
    made = StoreWriter(lambda: Store.open(memory / "rig.db"), [run_info()], served={})
    made.start()
    made.publish([step("NORM", "UNACK"), step("NORM", "UNACK", parameter="k2")])
    assert made.flush()
    yield made
    made.stop()


def test_of_two_clients_at_once_one_wins_and_both_are_told(writer: StoreWriter, memory: Path) -> None:
    noted: list[AlarmTransition] = []
    writer.on_alarm = noted.append
    answers: list[str] = []

    def client(name: str) -> None:
        try:
            answers.append(command_alarms(memory / "rig.db", ask("acknowledge", 1, by=name))[0]["by"])
        except StoreError as error:
            answers.append(str(error))

    threads = [threading.Thread(target=client, args=(name,)) for name in ("eva", "tom")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    won, lost = sorted(answers, key=len)
    assert won in {"eva", "tom"}
    assert f"was acknowledged already, by {won}" in lost
    assert [(change.by, change.to_state) for change in noted] == [(won, "ACKED")]
    assert select(memory / "rig.db", "SELECT state, acked_by FROM v_alarms WHERE id = 1") == [("ACKED", won)]


def test_next_run_goes_on_with_what_was_commanded(writer: StoreWriter, memory: Path) -> None:
    command_alarms(memory / "rig.db", ask("acknowledge", 1))
    command_alarms(memory / "rig.db", ask("shelve", 2, hours=1))
    writer.stop()
    with Store.open(memory / "rig.db") as store:
        store.begin_run(run_info())
        assert {row.parameter: row.state for row in store.open_alarms("press-7")} == {
            "k1": "ACKED",
            "k2": "SHLVD",
        }


def test_alarm_that_asks_again_is_the_same_activation(store: Store) -> None:
    carry_out(store, ask("acknowledge", 1), at(1, 1))
    write(store, step("ACKED", "UNACK", START + 9, cause="re-alarm"))
    assert alarms(store) == [(1, "UNACK", None, 1, 1)]
    carry_out(store, ask("acknowledge", 1, by="tom"), at(2, 2))
    assert alarms(store) == [(1, "ACKED", "tom", 1, 1)]


def test_alarm_suppressed_by_design_that_is_over_is_normal_when_it_speaks_again(store: Store) -> None:
    silence, speak = step("UNACK", "DSUPR", cause="suppress"), step("DSUPR", "UNACK", cause="unsuppress")
    write(store, silence)
    assert alarms(store) == [(1, "DSUPR", None, 1, 1)]
    write(store, speak, silence, step("UNACK", "RTNUN", START + 9, cause="clear"), speak, silence)
    assert alarms(store) == [(1, "NORM", None, 0, 1)]
    assert [event[:3] for event in events(store)[1:]] == [
        ("UNACK", "DSUPR", "suppress"), ("DSUPR", "UNACK", "unsuppress"), ("UNACK", "DSUPR", "suppress"),
        ("DSUPR", "DSUPR", "clear"), ("DSUPR", "NORM", "unsuppress"),
    ]  # fmt: skip
