"""The archive: by schedule, parted by rig and day, each row once, and a trend reads it."""

import json
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from agent.cli.app import app
from agent.config.sections.north import North
from agent.northbound.interface.peer import Batch, Place
from agent.northbound.parquet.peer import ParquetPeer
from agent.storage.read.forward import Feed
from tests.northbound.supply import events, numbers, supplied
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import START, batch, ledger, step

__all__ = ["memory"]
HOUR = 3_600_000_000_000
ARCHIVE = North(name="archive", kind="parquet", folder=Path("archive"), every="1h")


def archived(folder: Path, topic: str) -> list[dict[str, Any]]:
    files = sorted((folder / "archive" / topic).rglob("*.parquet"))
    return [row for file in files for row in parquet.ParquetFile(file).read().to_pylist()]


def test_archive_has_each_row_once_parted_by_day_and_waits_for_its_next_period(
    memory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, now = memory / "rig.db", [START]
    monkeypatch.setattr("agent.northbound.forwarder.wall_ns", lambda: now[0])
    with supplied(path, [ARCHIVE]) as (writer, forwarders):
        wait_until(lambda: forwarders[0]._numbers.get("period") == START // HOUR, "the first period", 30)
        writer.publish([batch(300, hop_ns=HOUR // 10), ledger(), step("NORM", "UNACK")])
        writer.flush()
        assert (forwarders[0].sent, forwarders[0].document()["state"]) == (0, "ok")
        now[0] += HOUR
        forwarders[0].wake()
        wait_until(lambda: forwarders[0].sent == 1202, "the archive", 30)
    assert [row["seq"] for row in archived(memory, "estimates")] == numbers(path)
    assert len(archived(memory, "alarm_events")) == len(archived(memory, "health")) == 1
    days = sorted(one.name for one in (memory / "archive" / "estimates" / "rig=press-7").iterdir())
    assert days == ["day=2026-01-01", "day=2026-01-02"]
    answer = CliRunner().invoke(app, ["trend", str(memory / "archive" / "estimates"), "k2", "--json"])
    assert json.loads(answer.stdout)["n"] > 0
    assert json.loads(answer.stdout)["parameter"] == "k2"
    vague = CliRunner().invoke(app, ["trend", str(memory / "archive" / "estimates"), "--json"])
    assert "holds several of parameter: B1, B2, k1, k2" in str(vague.exception)


def test_batch_that_is_delivered_again_leaves_no_row_twice(memory: Path) -> None:
    path = memory / "rig.db"
    with supplied(path, []) as (writer, _):
        writer.publish([batch(50)])
        writer.flush()
    feed = Feed(path)
    peer = ParquetPeer(ARCHIVE, Place(path, memory))
    peer.open()
    for most in (20, 50):
        peer.deliver(Batch("estimates", feed.after("estimates", 0, None, most).rows, 0, backfill=False))
    feed.close()
    assert [row["seq"] for row in archived(memory, "estimates")] == numbers(path)


def test_folder_that_cannot_be_written_is_one_event(memory: Path) -> None:
    (memory / "archive").write_text("a file", encoding="utf-8")
    path = memory / "rig.db"
    with supplied(path, [ARCHIVE]) as (writer, forwarders):
        writer.publish([batch(5)])
        wait_until(lambda: forwarders[0]._failures > 2, "attempts", 10)
    assert [cause for cause, _ in events(path)] == ["consumer failed"]
