"""Each step of an alarm reaches each of its targets once, whatever the target or the agent does meanwhile."""

import random
import signal
import subprocess
import sys
import threading
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from agent.config.sections.results import Notify
from agent.errors import StoreError
from agent.notification.message import Message
from agent.notification.routing import concerns
from agent.notification.senders import SendError
from agent.storage.operations import command_alarms, resend_notifications
from agent.storage.write.alarm_commands import Request
from agent.types import AlarmTransition
from tests.notification.targets import LATE_S, MailRoom, Post, agent, mail_server, webhook
from tests.peers import ROOT
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import START, select, step

__all__ = ["memory"]
SHIFT = Notify(name="shift", kind="command", command=("true",))


def hook(url: str, **keys: Any) -> Notify:
    return Notify(name="hook", kind="webhook", url=url, timeout_s=LATE_S, **keys)


def rows(path: Path, columns: str = "state") -> list[tuple[Any, ...]]:
    return select(path, f"SELECT {columns} FROM v_notifications ORDER BY id")


def steps(count: int) -> list[Any]:
    return [step("NORM", "UNACK", START + n, parameter=f"p{n}") for n in range(count)]


def settled(path: Path, count: int) -> bool:
    return [state for (state,) in rows(path)].count("done") == count


def keys_of(path: Path) -> list[str]:
    return [
        f"press-7-{seq}-{t}" for seq, t in select(path, "SELECT id, t_ns FROM v_alarm_events ORDER BY id")
    ]


FATES = ["500", "late", "lost", "fine", "hang", "fine", "500", "500", "lost"]


def test_webhook_that_fails_hangs_closes_and_answers_late_has_each_step_once_and_in_order(
    memory: Path,
) -> None:
    post = Post([*FATES])
    path = memory / "rig.db"
    with webhook(post) as url, agent(path, [hook(url)]) as (writer, _):
        writer.publish(steps(4))
        wait_until(lambda: settled(path, 4), "all to be delivered", 20)
        assert post.accepted == keys_of(path)
        assert sorted(set(post.attempts), key=post.attempts.index) == post.accepted
        assert len(post.attempts) == 4 + sum(fate != "fine" for fate in FATES)
        assert [attempts for (attempts,) in rows(path, "attempts")] == list(post.doubles.values())


@pytest.mark.soak
def test_each_step_once_per_target_over_fifty_failures(memory: Path) -> None:
    rng = random.Random(5)
    posts = [Post([rng.choice(FATES) for _ in range(60)]) for _ in range(2)]
    path = memory / "rig.db"
    with webhook(posts[0]) as one, webhook(posts[1]) as two:
        targets = [hook(one), hook(two).model_copy(update={"name": "other"})]
        with agent(path, targets) as (writer, _):
            for one_step in steps(30):
                writer.publish([one_step])
            wait_until(lambda: settled(path, 60), "all to be delivered", 90)
            assert [post.accepted for post in posts] == [keys_of(path)] * 2


def test_mail_refused_for_now_is_sent_again_with_the_same_message_id(memory: Path) -> None:
    room = MailRoom(Post(["451", "451"]))
    path = memory / "rig.db"
    with mail_server(room) as port:
        target = Notify(name="mail", kind="smtp", host="127.0.0.1", port=port, tls="none",
                        sender="rig@example.org", recipients=("shift@example.org",))  # fmt: skip
        with agent(path, [target]) as (writer, _):
            writer.publish([step("NORM", "UNACK", advice="check the hub bolts")])
            wait_until(lambda: settled(path, 1), "the mail to be taken", 20)
    (key,) = keys_of(path)
    assert room.post.attempts == [f"<{key}@deltak>"] * 3
    (mail,) = room.mails
    assert b"Subject: [high] press-7: k1 fell by 16 N/m (NORM -> UNACK)" in mail
    assert b"what to do: check the hub bolts" in mail


def test_agent_killed_between_sending_and_noting_sends_again_with_the_same_key(memory: Path) -> None:
    path, keys = memory / "rig.db", memory / "keys"
    command = [sys.executable, "-m", "tests.notification.killed", str(path), str(keys)]
    assert subprocess.run(command, cwd=ROOT, timeout=60, check=False).returncode == -signal.SIGKILL
    assert rows(path) == [("pending",)]
    again: list[str] = []
    with agent(path, [SHIFT], deliver=lambda _t, message, _f: again.append(message.key)):
        wait_until(lambda: settled(path, 1), "the rest to be sent", 20)
    assert keys.read_text(encoding="utf-8").split() == again == keys_of(path)


@pytest.mark.realtime
def test_target_that_hangs_holds_up_neither_another_nor_the_writer_nor_the_end(memory: Path) -> None:
    path, others, release = memory / "rig.db", [], threading.Event()

    def deliver(target: Notify, message: Message, _folder: Path) -> None:
        if target.name == "shift":
            release.wait(60)
        others.append(message.key)

    fine = SHIFT.model_copy(update={"name": "fine"})
    with agent(path, [SHIFT, fine], deliver=deliver) as (writer, notifiers):
        writer.publish(steps(3))
        wait_until(lambda: len(others) == 3, "the others to be served", 20)
        command_alarms(path, Request("acknowledge", (1,), "eva"))
        begun = time.monotonic()
        for notifier in notifiers:
            notifier.stop()
        writer.stop()
        assert time.monotonic() - begun < 2.0
        release.set()


def test_what_was_given_up_is_listed_and_sent_again_when_asked(memory: Path) -> None:
    path, broken = memory / "rig.db", [True]

    def deliver(_target: Notify, _message: Message, _folder: Path) -> None:
        if broken[0]:
            raise SendError("exit code 3: no line")

    target = SHIFT.model_copy(update={"attempts": 2})
    with agent(path, [target], deliver=deliver) as (writer, _):
        writer.publish(steps(1))
        wait_until(lambda: rows(path) == [("dead",)], "it to be given up", 20)
        assert rows(path, "attempts, last_error, done_at") == [(2, "exit code 3: no line", None)]
        broken[0] = False
        assert resend_notifications(path, [1]) == [{"id": 1, "target": "shift", "state": "pending"}]
        wait_until(lambda: settled(path, 1), "it to be sent", 20)
        with pytest.raises(StoreError, match=r"notification 1: is not dead, but done") as refused:
            resend_notifications(path, [1, 9])
        assert [fault.path for fault in refused.value.faults] == ["notification 1", "notification 9"]


@pytest.mark.parametrize(
    ("change", "count"),
    [
        ({}, 1), ({"priority": "low"}, 0), ({"kind": "sensor"}, 0),
        ({"from_state": "UNACK", "to_state": "DSUPR", "cause": "suppress"}, 0),
    ],
)  # fmt: skip
def test_target_is_notified_of_steps_of_its_priority_and_kinds_only(
    memory: Path, change: dict[str, Any], count: int
) -> None:
    target = SHIFT.model_copy(update={"priority": "high", "kinds": ("level",)})
    path = memory / "rig.db"
    with agent(path, [target], deliver=lambda *_: None) as (writer, _):
        writer.publish([step("NORM", "UNACK", **change)])
        assert writer.flush()
    assert len(rows(path)) == count


def test_quiet_hours_hold_all_but_what_is_critical_and_what_came_before_it(memory: Path) -> None:
    path, sent, hour = memory / "rig.db", [], [23]
    target = SHIFT.model_copy(update={"quiet": (22 * 60, 6 * 60)})

    def now() -> datetime:
        return datetime(2026, 1, 1, hour[0], 30).astimezone()

    def deliver(_target: Notify, message: Message, _folder: Path) -> None:
        sent.append(message.document["parameter"])

    with agent(path, [target], deliver=deliver, now=now) as (writer, (notifier,)):
        first, second, third = steps(3)
        writer.publish([first])
        assert writer.flush()
        writer.publish([step("NORM", "UNACK", START + 5, parameter="c", priority="critical"), second])
        wait_until(lambda: sent == ["p0", "c"], "the critical one", 20)
        hour[0] = 6
        writer.publish([third])
        notifier.wake()
        wait_until(lambda: settled(path, 4), "the end of the quiet hours", 20)
    assert sent == ["p0", "c", "p1", "p2"]


def test_what_an_operator_does_is_announced_and_what_a_shelved_alarm_does_is_not(memory: Path) -> None:
    path, sent = memory / "rig.db", list[tuple[str, Any]]()

    def deliver(_target: Notify, message: Message, _folder: Path) -> None:
        sent.append((message.document["to_state"], message.document["by"]))

    with agent(path, [SHIFT], deliver=deliver) as (writer, _):
        writer.publish(steps(1))
        assert writer.flush()
        command_alarms(path, Request("shelve", (1,), "eva", length_ns=10**12))
        writer.publish(
            [step("UNACK", "RTNUN", START + 7, parameter="p0"), step("NORM", "UNACK", parameter="p0")]
        )
        assert writer.flush()
        command_alarms(path, Request("unshelve", (1,), "tom"))
        wait_until(lambda: settled(path, 3), "all to be sent", 20)
    assert sent == [("UNACK", None), ("SHLVD", "eva"), ("ACKED", "tom")]


def test_what_is_done_while_no_agent_runs_is_announced_by_the_next(memory: Path) -> None:
    path, sent = memory / "rig.db", list[str]()

    def deliver(_target: Notify, message: Message, _folder: Path) -> None:
        sent.append(message.document["to_state"])

    def wanted(step: AlarmTransition) -> bool:
        return concerns(SHIFT, step)

    with agent(path, [SHIFT], deliver=deliver, wanted=wanted) as (writer, _):
        writer.publish(steps(1))
        wait_until(lambda: settled(path, 1), "the alarm", 20)
    command_alarms(path, Request("acknowledge", (1,), "eva"))
    for _ in range(2):
        with agent(path, [SHIFT], deliver=deliver, wanted=wanted):
            wait_until(lambda: settled(path, 2), "the acknowledgement", 20)
    assert sent == ["UNACK", "ACKED"]
