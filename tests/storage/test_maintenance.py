import csv
import io
import shutil
import sqlite3
import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.cli.tables import db as commands_db
from agent.errors import StoreError, UsageError
from agent.storage import maintenance
from agent.storage.database import compaction
from agent.storage.read import queries
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from tests.storage.rows import START, batch, ledger, run_info, select, step


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "rig.db"
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(500), step("NORM", "UNACK"), ledger()])
    return path


def spoil(path: Path) -> None:
    octets = bytearray(path.read_bytes())
    place = octets.index(b"k1 fell by 16")
    octets[place] ^= 1
    path.write_bytes(octets)


def test_check_of_a_sound_file_counts_its_rows(path: Path) -> None:
    report = maintenance.check(path)
    assert report.problems == []
    assert report.rows["v_estimates_windows"] == 2000
    assert report.bytes == path.stat().st_size


def test_check_finds_one_flipped_bit_of_a_text_and_repair_leaves_that_row_out(path: Path) -> None:
    spoil(path)
    assert maintenance.check(path).problems == ["1 rows of alarms have a wrong checksum"]
    result = maintenance.repair(path)
    assert result is not None
    assert (result.refused, result.unread) == (2, False)  # and the step that it had taken
    assert maintenance.check(path).problems == []
    assert len(queries.estimates(path)) == 2000
    assert queries.alarms(path) == []


@pytest.mark.parametrize("table", ["health", "alarm_events"])
def test_repair_of_a_file_whose_pages_are_destroyed_never_says_that_nothing_was_lost(
    path: Path, table: str
) -> None:
    with closing(sqlite3.connect(path)) as file:
        query = "SELECT rootpage FROM sqlite_master WHERE name = ?"
        pages = [file.execute(query, (name,)).fetchone()[0] for name in (table, "health_by_run")]
    octets = bytearray(path.read_bytes())
    for page in pages:
        octets[1024 * (page - 1) : 1024 * page] = np.random.default_rng(5).bytes(1024)
    path.write_bytes(octets)
    result = maintenance.repair(path)
    assert result is not None
    assert "at least 1 were lost" in str(result)


def test_repair_of_destroyed_estimates_counts_what_saved_instants_lack(path: Path) -> None:
    octets = bytearray(path.read_bytes())
    place = 3 * len(octets) // 4096 * 1024  # of estimates, which follow the hops that they are of
    octets[place : place + 4096] = bytes(4096)
    path.write_bytes(octets)
    result = maintenance.repair(path)
    assert result is not None
    assert result.unread
    assert result.refused >= 2000 - len(queries.estimates(path)) > 0


def test_repair_of_a_sound_file_does_nothing(path: Path) -> None:
    before = path.read_bytes()
    assert maintenance.repair(path) is None
    assert path.read_bytes() == before


def test_repair_while_an_agent_writes_is_refused(path: Path) -> None:
    with Store.open(path), pytest.raises(StoreError, match="is writing to this database"):
        maintenance.repair(path)


def test_compact_gives_space_back_and_keeps_every_row(path: Path) -> None:
    with Store.open(path, Retention(full_s=3600.0)) as store:
        run_id = store.begin_run(run_info())
        for i in range(10):
            store.write(run_id, [batch(1000, first=1000 * i, hop_ns=10**9)])
            store.maintain()
    rows = select(path, "SELECT * FROM v_estimates")
    before, after = maintenance.compact(path)
    assert after < 0.9 * before
    assert select(path, "SELECT * FROM v_estimates") == rows
    assert maintenance.check(path).problems == []


@pytest.mark.parametrize("looks", [0, 3])
def test_compaction_broken_off_while_it_copies_back_changes_nothing(
    path: Path, monkeypatch: pytest.MonkeyPatch, looks: int
) -> None:
    rows = select(path, "SELECT * FROM v_estimates")
    monkeypatch.setattr(compaction, "COPIED_PAGES", 8)
    with Store.open(path) as store:
        asked = iter([False] * looks + [True])
        with pytest.raises(compaction.BrokenOffError):
            compaction.compact(store.connection, path, lambda: next(asked))
        later = batch(1, first=1000)
        store.write(store.begin_run(run_info(started_ns=START + 1)), [later])
    assert select(path, "SELECT * FROM v_estimates WHERE run_id = 1") == rows
    assert len(select(path, "SELECT * FROM v_estimates")) == len(rows) + 4
    assert not list(path.parent.glob("*.compact"))
    assert maintenance.check(path).problems == []


def test_what_a_killed_compaction_left_is_removed_at_the_next_start(path: Path) -> None:
    left = path.with_name(path.name + ".compact")
    left.write_bytes(b"half")
    with Store.open(path):
        assert not left.exists()


def test_backup_while_the_agent_writes_is_one_sound_state(path: Path, tmp_path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info(started_ns=START + 1))
        stop = threading.Event()

        def write() -> None:
            number = 0
            while not stop.is_set():
                store.write(run_id, [batch(5, first=1000 + 5 * number)])
                number += 1

        thread = threading.Thread(target=write)
        thread.start()
        sizes = [maintenance.backup(path, tmp_path / f"copy-{i}.db") for i in range(4)]
        stop.set()
        thread.join()
    assert all(size > 100_000 for size in sizes)
    counts = [len(queries.estimates(tmp_path / f"copy-{i}.db")) for i in range(4)]
    assert counts == sorted(counts)
    assert all(count % 20 == 0 and count >= 2000 for count in counts)
    assert not list(tmp_path.glob("*.part*"))


def test_backup_that_is_put_in_place_is_gone_on_from(path: Path, tmp_path: Path) -> None:
    maintenance.backup(path, tmp_path / "kept")
    kept = queries.estimates(tmp_path / "kept")
    with Store.open(path) as store:
        store.write(store.begin_run(run_info(started_ns=START + 1)), [batch(5, first=5000)])
    for file in path.parent.glob(f"{path.name}*"):
        file.rename(tmp_path / f"away-{file.name}")
    shutil.copy(tmp_path / "kept", path)
    with Store.open(path) as store:
        assert store.recovery is None
        store.write(store.begin_run(run_info(started_ns=START + 2)), [batch(5, first=9000)])
    rows = queries.estimates(path)
    assert len(rows) == len(kept) + 20
    assert [row for row in rows if row["run_id"] == kept[0]["run_id"]] == kept


def test_backup_refuses_an_existing_target_and_a_damaged_source(path: Path, tmp_path: Path) -> None:
    target = tmp_path / "copy.db"
    target.write_text("mine")
    with pytest.raises(UsageError, match="exists already"):
        maintenance.backup(path, target)
    assert target.read_text() == "mine"
    spoil(path)
    with pytest.raises(StoreError, match="damaged"):
        maintenance.backup(path, tmp_path / "other.db")
    assert not (tmp_path / "other.db").exists()


def test_export_csv_is_the_view_to_the_last_digit(path: Path) -> None:
    output = io.StringIO()
    assert maintenance.export_csv(path, "estimates", output, rig="press-7") == 2000
    rows = list(csv.DictReader(io.StringIO(output.getvalue())))
    shown = queries.estimates(path)
    assert [float(r["value"]) for r in rows] == [r["value"] for r in shown]
    assert rows[0]["held"] == ""
    assert list(rows[0]) == list(shown[0])


@pytest.mark.parametrize("name", ["rows.csv", "rows.parquet"])
def test_export_to_where_nothing_can_be_written_is_refused(path: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="give a file in a folder that you may write to"):
        commands_db.export(path, "estimates", None, tmp_path / "none" / name)


def test_export_parquet_is_the_view(path: Path, tmp_path: Path) -> None:
    from pyarrow import parquet

    target = tmp_path / "rows.parquet"
    assert maintenance.export_parquet(path, "estimates", target) == 2000
    table = parquet.read_table(target)
    assert table.column("value").to_pylist() == [r["value"] for r in queries.estimates(path)]
    assert table.column("reason").null_count == 2000


def test_parquet_of_many_rows_has_one_type_a_column_and_is_written_a_batch_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pyarrow import parquet

    from agent.storage import parquet_table

    monkeypatch.setattr(parquet_table, "ROWS_READ", 3)
    rows = [(i, None if i < 8 else f"r{i}", float(i) if i > 4 else i, None) for i in range(10)]
    assert parquet_table.write(["a", "b", "c", "d"], rows, tmp_path / "t.parquet") == 10
    table = parquet.read_table(tmp_path / "t.parquet")
    assert [str(kind) for kind in table.schema.types] == ["int64", "string", "double", "null"]
    assert list(zip(*(column.to_pylist() for column in table.columns), strict=True)) == rows
    assert parquet.ParquetFile(tmp_path / "t.parquet").num_row_groups == 4
    assert parquet_table.write(["a", "b"], [], tmp_path / "none.parquet") == 0
    assert parquet.read_table(tmp_path / "none.parquet").column_names == ["a", "b"]
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["none.parquet", "t.parquet"]


def test_export_of_one_rig_has_its_steps_of_alarms_alone(tmp_path: Path) -> None:
    path = tmp_path / "both.db"
    with Store.open(path) as store:
        for rig in ("left", "right"):
            store.write(store.begin_run(run_info(rig)), [replace(step("NORM", "UNACK"), rig=rig)])
    for rig, number in (("left", 1), ("right", 2)):
        columns, rows = maintenance.export(path, "alarm_events", rig)
        assert [row[columns.index("alarm_id")] for row in rows] == [number]


@pytest.mark.parametrize(
    ("arguments", "words"), [(("nothing",), "no view"), (("estimates", "press-9"), 'no rig "press-9"')]
)
def test_export_of_what_is_not_there_is_refused(path: Path, arguments: tuple[str, ...], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        maintenance.export(path, *arguments)


@pytest.mark.parametrize("act", [maintenance.check, maintenance.repair, maintenance.compact])
def test_commands_on_what_is_not_a_database_change_nothing(tmp_path: Path, act: object) -> None:
    assert callable(act)
    for name, make in (("none.db", None), ("text.db", "not a database"), ("dir.db", "")):
        path = tmp_path / name
        if make:
            path.write_text(make)
        elif make == "":
            path.mkdir()
        before = sorted(p.name for p in tmp_path.iterdir())
        with pytest.raises(StoreError):
            act(path)
        assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_plain_connections_of_others_may_read_views_while_a_compaction_waits(path: Path) -> None:
    with sqlite3.connect(path) as plain:
        assert plain.execute("SELECT count(*) FROM v_estimates").fetchone() == (2000,)
    plain.close()


@pytest.mark.parametrize("what", ["events", "tiers", "trend"])
def test_export_by_the_command_line_knows_every_view(
    path: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    commands_db.export(path, what, None, None)
    assert capsys.readouterr().out.partition("\n")[0].split(",") == maintenance.export(path, what)[0]
