"""A rig that runs, and an operator who acts on its alarms: both know the same state and say what happened."""

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.config import load
from agent.records import RunInfo
from agent.runtime.process.announcing import announce
from agent.runtime.rig_runtime import RigRuntime
from agent.storage.operations import command_alarms
from agent.storage.write.alarm_commands import Request
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from drivers.reconnect import LinkEvent
from tests.peers import ROOT
from tests.storage.rows import select

CONFIG = ROOT / "deploy/examples/modbus.toml"
LOST, BACK = LinkEvent("lost", "modbus: silent for 2 s", 0.0), LinkEvent("recovered", "modbus: is back", 1.0)


class Live:
    """A rig and its writer, whose source comes and goes as told."""

    def __init__(self, db: Path) -> None:
        config = load(CONFIG)
        info = RunInfo(config.rig.name, "live", 1_000, "0", "0" * 64, site="Hall 3", labels={"line": "2"})
        self.db = db
        self.writer = StoreWriter(lambda: Store.open(db), [info], served={})
        self.writer.start()
        self.rig = RigRuntime(config, self.writer.publish, announce=announce)
        self.writer.on_alarm = self.rig.commanded
        self.rig.restore(self.writer.standing[config.rig.name])

    def link(self, event: LinkEvent) -> None:
        self.rig.link("modbus", event)
        assert self.writer.flush()

    @property
    def state(self) -> str:
        """What the rig and its database say, which is the same."""
        self.rig.poll()
        ((stored,),) = select(self.db, "SELECT state FROM v_alarms ORDER BY id DESC LIMIT 1")
        assert self.rig.states["source", "modbus"].state == stored
        return str(stored)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    made = Live(tmp_path / "rig.db")
    yield made
    made.writer.stop()


def deltak(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    code = guarded(app, list(argv))
    out, err = capsys.readouterr()
    return code, out, err


def test_alarm_acknowledged_while_its_rig_runs_clears_to_normal(
    live: Live, capsys: pytest.CaptureFixture[str]
) -> None:
    live.link(LOST)
    assert live.state == "UNACK"
    code, out, _ = deltak(
        capsys, "ack", str(live.db), "1", "--by", "eva", "--comment", "cable\x1b[2J", "--json"
    )
    (done,) = json.loads(out)["alarms"]
    assert (code, done["from_state"], done["to_state"], done["comment"]) == (
        0,
        "UNACK",
        "ACKED",
        "cable\x1b[2J",
    )
    assert live.state == "ACKED"
    live.link(BACK)
    assert live.state == "NORM"


def test_alarm_that_clears_as_it_is_acknowledged_ends_alike_on_both_sides(live: Live) -> None:
    """The rig learns of the command after it has decided its own step."""
    live.link(LOST)
    noted: list[Any] = []
    live.writer.on_alarm = noted.append
    guarded(app, ["ack", str(live.db), "1"])
    live.link(BACK)
    live.rig.commanded(noted[0])
    assert live.state == "NORM"


def test_shelved_source_comes_and_goes_in_silence(live: Live, caplog: pytest.LogCaptureFixture) -> None:
    live.link(LOST)
    assert guarded(app, ["shelve", str(live.db), "1", "--for", "8h", "--by", "eva"]) == 0
    assert live.state == "SHLVD"
    caplog.clear()
    live.link(BACK)
    live.link(LOST)
    assert live.state == "SHLVD"
    assert [record for record in caplog.records if record.name == "agent.runtime.process.announcing"] == []
    assert select(live.db, "SELECT count(*) FROM v_alarms") == [(1,)]
    assert guarded(app, ["unshelve", str(live.db), "1", "--by", "eva"]) == 0
    assert live.state == "ACKED"


def test_next_run_takes_up_what_was_commanded(live: Live) -> None:
    live.link(LOST)
    guarded(app, ["oos", str(live.db), "1", "--by", "eva"])
    live.writer.stop()
    again = Live(live.db)
    try:
        assert again.state == "OOSRV"
        again.link(BACK)
        assert again.state == "OOSRV"
        guarded(app, ["return", str(live.db), "1"])
        assert again.state == "NORM"
    finally:
        again.writer.stop()


def test_each_transition_is_a_line_of_the_log(live: Live, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    live.link(LOST)
    command_alarms(live.db, Request("acknowledge", (1,), "eva\x1b[31m", "<b>'"))
    live.rig.poll()
    raised, acked = [r.getMessage() for r in caplog.records if r.levelname == "ALARM"]
    assert "two-mass-rig: high source NORM -> UNACK at " in raised
    assert raised.endswith("modbus: silent for 2 s")
    assert acked.endswith("modbus: acknowledged by eva\\x1b[31m (<b>')")


@pytest.mark.parametrize(
    ("argv", "code", "words"),
    [
        (("ack", "DB", "7"), 3, "alarm 7: there is no such alarm; deltak alarms"),
        (("ack", "DB", "1"), 3, "alarm 1: modbus was acknowledged already, by eva at "),
        (("unshelve", "DB", "1"), 3, "alarm 1: modbus: it is not shelved"),
        (("shelve", "DB", "1"), 2, "--for: an alarm is not shelved for ever; give a time such as --for 8h"),
        (("shelve", "DB", "1", "--for", "30d"), 2, "--for: 30 days are not within 7 days"),
        (("shelve", "DB", "1", "--for", "ever"), 2, '--for: "ever" is no length of time'),
        (("ack", "DB", "one"), 2, "invalid value for 'ID...'"),
        (("ack", "DB", "1", "--comment", "x" * 1001), 2, "--comment: is no text of at most 1000 characters"),
        (("ack", "none.db", "1"), 3, "there is no such database"),
    ],
)
def test_command_that_cannot_be_done_says_why_and_changes_nothing(
    live: Live, capsys: pytest.CaptureFixture[str], argv: tuple[str, ...], code: int, words: str
) -> None:
    live.link(LOST)
    guarded(app, ["ack", str(live.db), "1", "--by", "eva"])
    capsys.readouterr()
    before = select(live.db, "SELECT * FROM v_alarm_events")
    found, _, err = deltak(capsys, *(str(live.db) if word == "DB" else word for word in argv))
    assert (found, words in err) == (code, True), err
    assert select(live.db, "SELECT * FROM v_alarm_events") == before


def test_alarms_are_shown_with_who_where_and_kind(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    live.link(LOST)
    guarded(app, ["ack", str(live.db), "1", "--by", "e\x1b[2Jva"])
    capsys.readouterr()
    code, out, _ = deltak(capsys, "alarms", str(live.db))
    assert code == 0
    assert "two-mass-rig at Hall 3, line 2" in out
    assert "ACKED by e\\x1b[2Jva" in out
    assert "source: samples do not come" in out
    assert "UNACK  -      RTNUN  ACKED" in deltak(capsys, "alarms", "--states")[1]
    stats = json.loads(deltak(capsys, "alarms", str(live.db), "--stats", "--json")[1])["stats"]
    assert (stats["announced"], stats["floods"], stats["priorities"]) == (1, [], {"high": 1})
    assert "150 are acceptable" in deltak(capsys, "alarms", str(live.db), "--stats")[1]
