import json
import os
import sqlite3
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.special import stdtrit

from agent.errors import StoreError
from agent.records import HealthEvent, LearntRecord, SourceClock
from agent.storage.database import connect
from agent.storage.database.checksum import row_crc
from agent.storage.database.columns import columns_of, numbers_crc
from agent.storage.database.schema import APPLICATION_ID, SCHEMA_VERSION, version_mark
from agent.storage.read import queries
from agent.storage.write.store import Store
from agent.types import EstimateBatch, Learnt, Reason, Status
from tests.storage.rows import HOP, PARAMETERS, START, batch, ledger, run_info, select, step, verdict, warming

CONTRACT = {
    "v_estimates": "rig run_id time t_ns parameter unit value delta reference baseline_id sd lower upper "
    "status reason held held_age_s window_s n_used n_missing span_s method sd_repeat",
    "v_latest": "rig run_id time t_ns parameter unit value delta reference baseline_id sd lower upper "
    "status reason held held_age_s window_s n_used n_missing span_s method sd_repeat",
    "v_alarms": "id rig run_id kind parameter priority state raised_at cleared_at acked_at acked_by "
    "shelved_until delta sd limit_value probability message advice percent site labels",
    "v_alarm_events": "id alarm_id t_ns time from_state to_state cause by comment",
    "v_notifications": "id alarm_event_id target state attempts last_error done_at",
    "v_health": "rig source t_ns time received used rejected dropped gaps lag_s drift_ppm drift_sd_ppm "
    "skew_s skew_sd_s",
    "v_health_reasons": "rig source t_ns kind reason count",
    "v_runs": "run_id rig kind started_at code_version config_sha256 baseline_id boot_id",
    "v_verdicts": "rig run_id t_ns time hypothesis size sd unit probability",
    "v_baselines": "baseline_id rig parameter unit reference sd spread_sd within_sd days_sd correlation_s "
    "n_effective covariates learnt_from learnt_until n newest from_ns until_ns graph",
    "v_meta": "key value",
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def stored(path: Path, *records: object, kind: str = "live") -> int:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info(kind=kind))
        store.write(run_id, list(records))
    return run_id


@pytest.mark.parametrize("view", CONTRACT)
def test_views_of_a_new_file_have_exactly_the_promised_columns(path: Path, view: str) -> None:
    stored(path)
    with sqlite3.connect(path) as connection:
        names = [c[0] for c in connection.execute(f"SELECT * FROM {view}").description]
    connection.close()
    assert names == CONTRACT[view].split()


def test_tables_are_strict_and_have_a_growing_seq(path: Path) -> None:
    stored(path)
    tables = select(
        path, "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND name NOT LIKE '%sqlite%'"
    )
    assert len(tables) == 31
    for name, sql in tables:
        assert sql.endswith("STRICT"), name
        assert "seq INTEGER PRIMARY KEY" in sql, name


def test_marks_say_whose_file_it_is_and_which_version(path: Path) -> None:
    stored(path)
    head = path.read_bytes()[:100]
    assert int.from_bytes(head[68:72], "big") == APPLICATION_ID
    assert int.from_bytes(head[60:64], "big") == version_mark(SCHEMA_VERSION)
    assert select(path, "SELECT value FROM v_meta WHERE key = 'schema_version'") == [(str(SCHEMA_VERSION),)]


def test_write_is_full_and_in_the_write_ahead_log(path: Path) -> None:
    with Store.open(path) as store:
        asked = ("journal_mode", "synchronous", "mmap_size", "page_size")
        got = [store.connection.execute(f"PRAGMA {name}").fetchone()[0] for name in asked]
    assert got == ["wal", 2, 0, 1024]


def test_estimates_written_come_back_to_the_last_bit(path: Path) -> None:
    sent = batch(40)
    stored(path, sent)
    rows = queries.estimates(path)
    assert len(rows) == 160
    for name in ("value", "sd"):
        got = np.array([r[name] for r in rows]).reshape(40, 4)
        assert np.array_equal(got, getattr(sent, name))
    for name in ("lower", "upper"):
        got = np.array([r[name] for r in rows]).reshape(40, 4)
        assert np.allclose(got, getattr(sent, name), rtol=0, atol=1e-12)
    assert rows[0]["time"] == "2026-01-01T00:00:00.000000000Z"
    assert rows[4]["time"] == "2026-01-01T00:00:00.050000000Z"
    assert [r["parameter"] for r in rows[:4]] == list(PARAMETERS)
    assert rows[1]["delta"] == rows[1]["value"] - 26.0
    facts = {
        name: rows[0][name]
        for name in ("status", "reason", "held", "window_s", "n_used", "n_missing", "span_s")
    }
    assert facts == {"status": "valid", "reason": None, "held": None, "window_s": 0.25, "n_used": 250,
                     "n_missing": 0, "span_s": 0}  # fmt: skip


def test_estimates_with_bounds_that_are_not_students_keep_them(path: Path) -> None:
    sent = batch(3)
    odd = batch(3, lower=sent.value - 1.0, upper=sent.value + 5.0)
    stored(path, odd)
    rows = queries.estimates(path, parameter="k2")
    assert [r["lower"] for r in rows] == (sent.value[:, 1] - 1.0).tolist()
    assert [r["upper"] for r in rows] == (sent.value[:, 1] + 5.0).tolist()


def test_estimates_withoutnumbers_are_null_and_infinities_never_stored(path: Path) -> None:
    bad = batch(1, first=5, value=np.array([[np.inf, -np.inf, np.nan, 1.0]]), lower=np.full((1, 4), -np.inf))
    stored(path, warming(5), bad)
    rows = queries.estimates(path)
    assert all(r["value"] is None and r["sd"] is None and r["lower"] is None for r in rows[:20])
    assert {r["status"] for r in rows[:20]} == {"warming"}
    last = rows[20:]
    assert [r["value"] for r in last] == [None, None, None, 1.0]
    assert [(r["status"], r["reason"]) for r in last] == [("invalid", "diverged")] * 3 + [("valid", None)]
    assert last[3]["lower"] is None
    cells = select(path, "SELECT value, sd, lower, upper FROM estimates")
    assert all(c is None or abs(c) < 1e300 for row in cells for c in row)


def test_estimates_unexcited_show_reason_in_words_and_the_held_value(path: Path) -> None:
    shape = (2, 4)
    held = batch(
        2, status=np.full(shape, Status.UNEXCITED, np.uint8),
        reason=np.full(shape, Reason.DRY_FRICTION, np.uint8),
        held=np.full(shape, 24.5), held_age_s=np.full(shape, 1.25),
    )  # fmt: skip
    stored(path, held)
    row = queries.estimates(path)[0]
    assert (row["status"], row["reason"]) == ("unexcited", "dry friction")
    assert (row["held"], row["held_age_s"]) == (24.5, 1.25)


def test_estimates_before_1970_and_far_ahead_have_times(path: Path) -> None:
    stored(path, batch(1, start=-1), batch(1, start=-(10**18)), batch(1, start=9_223_372_036_854_775_807))
    times = sorted(r["time"] for r in queries.estimates(path, parameter="k1"))
    assert times[0] == "1938-04-24T22:13:20.000000000Z"
    assert times[1] == "1969-12-31T23:59:59.999999999Z"
    assert times[2] == "2262-04-11T23:47:16.854775807Z"


def test_write_of_many_rows_is_cut_into_transactions(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        plans = store.encode(run_id, [batch(12_000), step("NORM", "UNACK")])
        assert [len(p.rows["estimates"]) for p in plans] == [20_000, 20_000, 8_000]
        store.commit(plans)
    assert select(path, "SELECT count(*), count(DISTINCT seq) FROM estimates") == [(48_000, 48_000)]


def test_commit_twice_stores_nothing_twice(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        plans = store.encode(run_id, [batch(10), step("NORM", "UNACK"), ledger()])
        store.commit(plans)
        store.commit(plans)
    counts = select(path, "SELECT (SELECT count(*) FROM v_estimates), (SELECT count(*) FROM v_alarms), "
                          "(SELECT count(*) FROM v_alarm_events), "
                          "(SELECT count(*) FROM v_health)")  # fmt: skip
    assert counts == [(40, 1, 1, 1)]


def test_write_refused_by_the_disk_leaves_nothing_and_can_be_repeated(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        plans = store.encode(run_id, [batch(5000)])
        pages = store.connection.execute("PRAGMA page_count").fetchone()[0]
        store.connection.execute(f"PRAGMA max_page_count = {pages + 5}")
        with pytest.raises(sqlite3.OperationalError, match="full"):
            store.commit(plans)
        store.reopen()
        assert store.connection.execute("SELECT count(*) FROM hops").fetchone() == (0,)
        store.commit(plans)
    assert len(queries.estimates(path)) == 20_000


def test_checksums_of_every_row_agree_with_zlib(path: Path) -> None:
    learnt = LearntRecord("press-7", START, Learnt("ab", "{}"))
    stored(path, warming(2), batch(3, first=2), step("NORM", "UNACK"), ledger(),
           ledger(rejected={}, dropped={}), learnt, verdict(),
           HealthEvent("press-7", "can", START, "unplugged", "it's \x1f gone"))  # fmt: skip
    for table in ("rigs", "runs", "series", "fits", "verdicts", "alarms", "alarm_events", "health", "events",
                  "meta", "learnt", "hypotheses"):  # fmt: skip
        rows = select(path, f"SELECT {', '.join(columns_of(table))} FROM {table}")
        assert rows, table
        for row in rows:
            assert row_crc(row[:-1]) == row[-1], table
    for table, ints in (("estimates", 4), ("hops", 4)):
        rows = select(path, f"SELECT {', '.join(columns_of(table))} FROM {table}")
        columns = [np.array([r[i] for r in rows], dtype=np.int64 if i < ints else np.float64)
                   for i in range(len(rows[0]) - 1)]  # fmt: skip
        assert numbers_crc(table, columns).tolist() == [r[-1] for r in rows]
        packed = b"".join(c[-1:].tobytes() for c in columns)
        assert zlib.crc32(packed) == rows[-1][-1] % 2**32


def test_views_show_the_newest_run_that_covers_an_instant(path: Path) -> None:
    first = stored(path, batch(100), step("NORM", "UNACK", START + 50 * HOP))
    second = stored(path, batch(20, first=40), step("NORM", "UNACK", START + 45 * HOP), kind="replay")
    rows = queries.estimates(path, parameter="k1")
    assert [r["run_id"] for r in rows] == [first] * 40 + [second] * 20 + [first] * 40
    assert [a["run_id"] for a in queries.alarms(path)] == [second]
    assert {r["run_id"] for r in queries.latest(path)} == {first}
    third = stored(path, batch(200), kind="replay")
    assert {r["run_id"] for r in queries.estimates(path)} == {third}
    assert {r["run_id"] for r in queries.latest(path)} == {third}


def test_views_of_runs_that_follow_one_another_show_all_of_them(path: Path) -> None:
    ids = [stored(path, batch(10, first=10 * i)) for i in range(3)]
    assert [r["run_id"] for r in queries.estimates(path, parameter="B2")] == [
        i for i in ids for _ in range(10)
    ]
    assert select(path, "SELECT count(*) FROM overlaps") == [(0,)]


def test_live_run_begun_after_the_clock_was_set_back_hides_nothing_of_the_one_before(path: Path) -> None:
    first = stored(path, batch(100), step("NORM", "UNACK", START + 50 * HOP))
    second = stored(path, batch(100, first=40))
    assert [alarm["run_id"] for alarm in queries.alarms(path, active=True)] == [first]
    shown = [r["run_id"] for r in queries.estimates(path, parameter="k1")]
    assert (shown.count(first), shown.count(second)) == (100, 100)


def test_latest_is_the_newest_row_of_each_rig_and_parameter(path: Path) -> None:
    with Store.open(path) as store:
        one, two = store.begin_run(run_info()), store.begin_run(run_info("press-8"))
        store.write(one, [batch(10), batch(5, first=10, parameters=("k1", "k2"))])
        store.write(two, [batch(7, rig="press-8")])
    rows = {(r["rig"], r["parameter"]): r["t_ns"] for r in queries.latest(path)}
    assert rows["press-7", "k1"] == START + 14 * HOP
    assert rows["press-8", "k1"] == START + 6 * HOP
    assert len(rows) == 8


def test_alarm_life_is_one_row_with_figures_as_at_raising(path: Path) -> None:
    second = 10**9
    life = [
        step("NORM", "UNACK"),
        step("UNACK", "ACKED", START + second, by="anna", comment="seen", delta=-17.0, message="worse"),
        step("ACKED", "NORM", START + 2 * second, cause="cleared", delta=-1.0),
        step("NORM", "UNACK", START + 3 * second, delta=-18.0),
        step("UNACK", "RTNUN", START + 4 * second, cause="cleared"),
        step("RTNUN", "UNACK", START + 5 * second),
    ]
    stored(path, *life)
    first, second, third = queries.alarms(path)
    assert (first["state"], first["delta"], first["message"]) == ("NORM", -16.0, "k1 fell by 16 N/m")
    assert (first["acked_by"], first["acked_at"]) == ("anna", "2026-01-01T00:00:01.000000000Z")
    assert first["cleared_at"] == "2026-01-01T00:00:02.000000000Z"
    assert (second["state"], second["delta"]) == ("RTNUN", -18.0)
    assert second["cleared_at"] == "2026-01-01T00:00:04.000000000Z"
    assert (third["state"], third["cleared_at"]) == ("UNACK", None)
    assert queries.alarms(path, active=True) == [second, third]
    events = select(path, 'SELECT alarm_id, from_state, to_state, cause, "by", comment FROM v_alarm_events')
    assert events[1] == (first["id"], "UNACK", "ACKED", "limit", "anna", "seen")
    assert [e[0] for e in events] == [first["id"]] * 3 + [second["id"]] * 2 + [third["id"]]


def test_alarm_standing_at_the_end_of_a_live_run_goes_on_in_the_next(path: Path) -> None:
    stored(path, step("NORM", "UNACK"))
    with Store.open(path) as store:
        (standing,) = store.open_alarms("press-7")
        assert (standing.parameter, standing.state, standing.raised_ns) == ("k1", "UNACK", START)
        store.write(store.begin_run(run_info(kind="replay")), [step("NORM", "UNACK")])
        store.write(store.begin_run(run_info()), [step("UNACK", "RTNUN", START + 5)])
    first, replayed = queries.alarms(path)
    assert (first["state"], first["cleared_at"]) == ("RTNUN", "2026-01-01T00:00:00.000000005Z")
    assert replayed["state"] == "UNACK"


def test_health_reasons_are_counted_by_kind(path: Path) -> None:
    stored(path, ledger(), ledger(START + 10**10, rejected={}, dropped={}, lag_s=None))
    rows = select(path, "SELECT received, used, rejected, dropped, gaps, lag_s FROM v_health")
    assert rows == [(1000, 990, 5, 5, 1, 0.01), (1000, 990, 0, 0, 1, None)]
    reasons = select(path, "SELECT kind, reason, count FROM v_health_reasons ORDER BY kind, reason")
    assert reasons == [("dropped", "queue full", 5), ("rejected", "crc", 3), ("rejected", "duplicate", 2)]
    assert queries.health(path)[0]["reasons"] == {"rejected": {}, "dropped": {}}


def test_health_tells_drift_and_skew_of_a_source_and_counts_them_nowhere(path: Path) -> None:
    stored(
        path,
        ledger(clock=SourceClock(12.5, 0.25, 0.0037, 1e-5)),
        ledger(START + 10**10, clock=SourceClock(8.0, 2.0)),
    )
    rows = select(path, "SELECT drift_ppm, drift_sd_ppm, skew_s, skew_sd_s FROM v_health ORDER BY t_ns")
    assert rows == [(12.5, 0.25, 0.0037, 1e-5), (8.0, 2.0, None, None)]
    assert select(path, "SELECT DISTINCT kind FROM v_health_reasons ORDER BY kind") == [
        ("dropped",),
        ("rejected",),
    ]


def test_seq_never_goes_back_after_everything_was_deleted(path: Path) -> None:
    stored(path, batch(10))
    with Store.open(path) as store:
        before = store.numbers.high("hops")
    connection = sqlite3.connect(path)
    with connection:
        connection.execute("DELETE FROM hops")
        connection.execute("DELETE FROM estimates")
        connection.execute(
            "INSERT INTO sequences VALUES (1, 'hops', ?, ?)", (before, row_crc((1, "hops", before)))
        )
    connection.close()
    stored(path, batch(1))
    assert select(path, "SELECT min(seq) FROM hops") == [(before + 1,)]


# --- what must be refused -----------------------------------------------------------------------------------


def test_open_by_a_second_process_names_the_first(path: Path) -> None:
    code = (
        "import sys; from agent.storage.write.store import Store\nfrom agent.errors import StoreError\n"
        "try: Store.open(sys.argv[1])\nexcept StoreError as e: print(e); sys.exit(e.exit_code)"
    )
    with Store.open(path):
        done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert f"process {os.getpid()} is writing" in done.stdout
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_open_twice_in_one_process_is_refused(path: Path) -> None:
    with Store.open(path), pytest.raises(StoreError, match="is writing to this database"):
        Store.open(path)


def foreign(path: Path) -> None:
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE t (x)")
    connection.execute("PRAGMA application_id = 252006673")
    connection.commit()
    connection.close()


def newer(path: Path) -> None:
    stored(path)
    connection = sqlite3.connect(path)
    connection.execute(f"PRAGMA user_version = {version_mark(SCHEMA_VERSION + 1)}")
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()
    (path.parent / f"{path.name}.lock").unlink()
    (path.parent / f"{path.name}.ballast").unlink()


REFUSED = {
    "plain sqlite": (
        lambda p: sqlite3.connect(p).executescript("CREATE TABLE t (x)").connection.close(),
        "not a deltak",
    ),
    "another application": (foreign, "not a deltak"),
    "text": (lambda p: p.write_text("t,force\n0,1\n"), "not a deltak"),
    "rubbish": (lambda p: p.write_bytes(np.random.default_rng(1).bytes(5000)), "not a deltak"),
    "newer": (newer, "newer version"),
    "directory": (lambda p: p.mkdir(), "is a directory"),
    "pipe": (os.mkfifo, "is a pipe or a device"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_open_of_what_is_not_ours_is_refused_and_changes_nothing(path: Path, what: str) -> None:
    make, message = REFUSED[what]
    make(path)

    def state() -> list[tuple[str, bytes]]:
        return sorted((p.name, p.read_bytes() if p.is_file() else b"") for p in path.parent.iterdir())

    before = state()
    for act in (Store.open, queries.estimates):
        with pytest.raises(StoreError, match=message) as caught:
            act(path)
        assert caught.value.exit_code == 3
        assert state() == before


def test_open_without_folder_and_read_without_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no folder"):
        Store.open(tmp_path / "no" / "rig.db")
    with pytest.raises(StoreError, match="no such database"):
        queries.estimates(tmp_path / "rig.db")
    assert list(tmp_path.iterdir()) == []


def test_open_of_an_empty_file_makes_a_database(path: Path) -> None:
    path.touch()
    stored(path, batch(1))
    assert len(queries.estimates(path)) == 4


def test_names_with_sql_in_them_are_only_names(path: Path) -> None:
    evil = "x'; DROP TABLE hops; --"
    with Store.open(path) as store:
        run_id = store.begin_run(run_info(evil))
        store.write(
            run_id, [batch(2, rig=evil, parameters=(evil,)), step("NORM", "UNACK", rig=evil, parameter=evil)]
        )
    assert [r["parameter"] for r in queries.estimates(path, rig=evil, parameter=evil)] == [evil, evil]
    assert queries.alarms(path, rig=evil)[0]["parameter"] == evil


def test_encode_for_a_run_that_was_not_begun_is_refused(path: Path) -> None:
    with Store.open(path) as store, pytest.raises(StoreError, match="no run 7"):
        store.write(7, [batch(1)])


# --- readers ------------------------------------------------------------------------------------------------


def test_read_while_an_agent_writes_sees_what_was_committed(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        store.write(run_id, [batch(5)])
        assert len(queries.estimates(path)) == 20
        reader = connect.connect_reader(path)
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            reader.execute("DELETE FROM hops")
        reader.close()
        plain = subprocess.run(
            ["sqlite3", "-json", path, "SELECT count(*) AS n, min(time) AS t FROM v_estimates"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert json.loads(plain.stdout) == [{"n": 20, "t": "2026-01-01T00:00:00.000000000Z"}]


def test_reader_of_a_file_without_place_for_the_shared_index_falls_back(path: Path, monkeypatch) -> None:
    stored(path, batch(5))
    real = sqlite3.connect

    def refuse(target: str, **options: object) -> sqlite3.Connection:
        if "immutable" not in target:
            raise AssertionError(target)
        return real(target, **options)

    class Failing:
        def execute(self, *_: object) -> None:
            raise sqlite3.OperationalError("unable to open database file")

        def close(self) -> None:
            pass

    monkeypatch.setattr(
        connect.sqlite3, "connect", lambda t, **o: refuse(t, **o) if "immutable" in t else Failing()
    )
    assert len(queries.estimates(path)) == 20


def empty(*_: object) -> EstimateBatch:
    return batch(0)


def test_write_of_nothing_is_harmless(path: Path) -> None:
    stored(path, empty())
    assert queries.estimates(path) == []
    assert queries.latest(path) == []


def coloured(first: int, hops: int = 20) -> EstimateBatch:
    """Rows under coloured noise: each window finds other degrees of freedom."""
    dof = np.random.default_rng(first).uniform(30.0, 400.0, hops)
    plain = batch(hops, first=first)
    half = np.asarray(stdtrit(dof, 0.975))[:, None] * plain.sd
    return batch(hops, first=first, dof=dof, lower=plain.value - half, upper=plain.value + half)


def test_rows_under_coloured_noise_keep_their_intervals_and_name_no_fit_each(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        batches = [coloured(first) for first in range(0, 4000, 20)]
        for one in batches:
            store.write(run_id, [one])
    fits = select(path, "SELECT count(*) FROM fits")[0][0]
    assert fits < 150
    found = np.array(
        select(path, "SELECT lower, upper FROM v_estimates WHERE parameter = 'k1' ORDER BY t_ns")
    )
    np.testing.assert_array_equal(found[:, 0], np.concatenate([b.lower[:, 0] for b in batches]))
    np.testing.assert_array_equal(found[:, 1], np.concatenate([b.upper[:, 0] for b in batches]))


def test_fits_that_were_named_long_ago_take_no_memory(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.storage.tables.rows.MOST_FITS", 100)
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        for first in range(0, 1000, 20):
            store.write(run_id, [batch(20, first=first, n_missing=np.arange(first, first + 20))])
        assert len(store.names._fits) <= 100
    with Store.open(path) as store:
        assert len(store.names._fits) <= 100
        run_id = store.begin_run(run_info())
        store.write(run_id, [batch(1, first=1000)])
    query = (
        "SELECT f.n_missing FROM hops h JOIN estimates e ON e.seq = h.seq * 1024 "
        "JOIN fits f ON f.seq = e.fit_id"
    )
    assert [n for (n,) in select(path, f"{query} ORDER BY h.t_ns")] == [*range(1000), 0]
