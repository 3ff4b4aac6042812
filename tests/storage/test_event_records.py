"""The index of event records in the database; how the records themselves are made is tested in
tests/recording."""

import gzip
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest

from agent.errors import StoreError
from agent.records import EventRecord
from agent.storage import maintenance
from agent.storage.database.connect import connect_reader
from agent.storage.database.schema import SCHEMA_VERSION
from agent.storage.read import queries
from agent.storage.write.store import Store
from tests.storage.rows import START, batch, run_info, select, step

FIRST_VERSION = Path(__file__).parent / "fixtures" / "version-1.db.gz"
RAISED = START + 2_000_000_000
RECORD = EventRecord(
    "press-7", RAISED, "level", "k1", 1, "rig.db.events/press-7-00000000-k1.npz", "recording", START, RAISED,
    2000,
    9000, 7,
)  # fmt: skip


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def test_record_is_listed_with_its_alarm_and_the_provenance_of_its_run(path: Path) -> None:
    with Store.open(path) as store:
        run = store.begin_run(run_info())
        store.write(run, [batch(40), step("NORM", "UNACK", RAISED), RECORD])
    (row,) = queries.event_records(path, "press-7")
    facts = {"alarm_id": 1, "run_id": 1, "t_ns": RAISED, "state": "recording", "samples": 2000, "bytes": 9000,
             "config_sha256": "ab" * 32, "code_version": "0.1.0", "baseline_id": 7, "kind": "level",
             "time": "2026-01-01T00:00:02.000000000Z", "from_ns": START}  # fmt: skip
    assert row.items() >= facts.items()


def test_record_that_goes_on_keeps_its_row_and_its_run(path: Path) -> None:
    with Store.open(path) as store:
        first = store.begin_run(run_info())
        store.write(first, [RECORD, replace(RECORD, samples=3000)])
        second = store.begin_run(run_info())
        store.write(second, [replace(RECORD, state="complete", samples=4000)])
    with Store.open(path) as store:
        third = store.begin_run(run_info())
        store.write(third, [replace(RECORD, state="purged")])
    (row,) = queries.event_records(path)
    assert (row["id"], row["run_id"], row["state"], row["samples"]) == (1, first, "purged", 2000)


def test_records_are_exported(path: Path, tmp_path: Path) -> None:
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [RECORD])
    with (tmp_path / "out.csv").open("w", encoding="utf-8") as file:
        assert maintenance.export_csv(path, "event_records", file, "press-7") == 1
    assert "press-7-00000000-k1.npz" in (tmp_path / "out.csv").read_text(encoding="utf-8")


def test_records_survive_the_repair_of_a_damaged_file(path: Path) -> None:
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(40), RECORD])
        page = store.connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'hops'").fetchone()[
            0
        ]
    octets = bytearray(path.read_bytes())
    octets[(page - 1) * 1024 : page * 1024] = b"\xa5" * 1024
    path.write_bytes(octets)
    assert maintenance.repair(path) is not None
    assert [row["file"] for row in queries.event_records(path)] == [RECORD.file]


def first_version(path: Path) -> None:
    path.write_bytes(gzip.decompress(FIRST_VERSION.read_bytes()))


def test_file_of_the_first_version_is_upgraded_with_every_row(path: Path) -> None:
    first_version(path)
    connection = sqlite3.connect(path)
    before = connection.execute("SELECT *, sd FROM v_estimates").fetchall()
    connection.close()
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [RECORD])
    assert select(path, "SELECT * FROM v_estimates") == before
    assert len(before) == 168
    assert select(path, "SELECT value FROM v_meta WHERE key = 'schema_version'") == [(str(SCHEMA_VERSION),)]
    assert maintenance.check(path).problems == []
    assert [row["file"] for row in queries.event_records(path)] == [RECORD.file]


def test_file_of_the_first_version_is_not_read_before_the_agent_has_upgraded_it(path: Path) -> None:
    first_version(path)
    with pytest.raises(StoreError, match="older version 1") as caught:
        connect_reader(path)
    assert caught.value.exit_code == 3
