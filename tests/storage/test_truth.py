"""Damage is never shown as truth: a bit that flips is met by an error or a count of refused rows."""

import shutil
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.errors import AgentError, StoreError
from agent.records import ClockRecord, EventRecord, RunInfo
from agent.storage import maintenance
from agent.storage.database.files import beside
from agent.storage.database.schema import own_schema
from agent.storage.read import queries
from agent.storage.read.points import points_of
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from tests import peers
from tests.figures import figure
from tests.storage.rows import START, batch, ledger, run_info, step, warming

SECOND, DAY = 10**9, 86_400 * 10**9
Shown = Counter[tuple[object, ...]]
RECORD = EventRecord(
    "press-7", START, "level", "k1", 1, "e/press-7-0-k1.npz", "complete", START, START, 9, 9, 7
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rigs, a replay that covers a part of a run, a clock that was set back, minutes, alarms, ledgers and
    records."""
    path = tmp_path_factory.mktemp("whole") / "rig.db"
    with Store.open(path, Retention(full_s=60.0)) as store:
        run = store.begin_run(run_info())
        store.write(run, [warming(5), batch(30, first=5, hop_ns=4 * 10**9), RECORD])
        store.write(
            run, [step("NORM", "UNACK"), step("UNACK", "ACKED", by="anna"), ledger(), ledger(START + 10**10)]
        )
        store.maintain(finish=True)
        other = store.begin_run(run_info("press-8"))
        store.write(other, [batch(10, rig="press-8"), ledger(rig="press-8")])
        again = store.begin_run(run_info(kind="replay"))
        store.write(again, [batch(8, start=START + 1000, hop_ns=4 * 10**9)])
        stepped = store.begin_run(
            RunInfo("press-9", "live", START, "0.1.0", "ab" * 32, None, "boot-1", START)
        )
        for first, offset in ((0, START), (300, START - DAY)):
            clock = ClockRecord("press-9", offset + first * SECOND, first, offset)
            rows = batch(6, rig="press-9", start=clock.t_ns, hop_ns=SECOND, index=np.arange(first, first + 6))
            store.write(stepped, [clock, rows])
    return path


ANSWERS: dict[str, Callable[[Path], Any]] = {
    "estimates": queries.estimates, "latest": queries.latest, "alarms": queries.alarms,
    "health": queries.health,
    "runs": queries.runs, "records": queries.event_records, "events": queries.events,
}  # fmt: skip


WHOLE_ANSWERS = ("estimates", "latest", "alarms", "health", "runs", "records", "events", "alarm_events")
"""Questions that leave out no row without saying so; of a trend that holds for the newest row."""


def asked(path: Path, caplog: pytest.LogCaptureFixture) -> dict[str, Shown | None]:
    """Return what each question shows; None where it ends in an error or says that rows were refused."""
    found: dict[str, Shown | None] = {}
    for name, ask in ANSWERS.items():
        found[name] = _shown(lambda ask=ask: ask(path), caplog)
    for rig in ("press-7", "press-9"):
        found[f"trend of {rig}"] = _shown(lambda rig=rig: _points(path, rig), caplog)
    for what in ("tiers", "alarm_events"):
        found[what] = _shown(lambda what=what: _exported(path, what), caplog)
    return found


def _exported(path: Path, what: str) -> list[dict[int, object]]:
    return [dict(enumerate(row)) for row in maintenance.export(path, what)[1]]


def _points(path: Path, rig: str) -> list[dict[str, object]]:
    got = points_of(path, rig, "k1")
    return [
        dict(zip("tvs", cells, strict=True)) for cells in zip(got.t_ns, got.value, got.sd, strict=True)
    ] + [{"unit": got.unit, "reference": got.reference}]


def _shown(ask: Callable[[], Any], caplog: pytest.LogCaptureFixture) -> Shown | None:
    caplog.clear()
    try:
        rows = ask()
    except (AgentError, sqlite3.Error, UnicodeDecodeError):
        return None
    return None if "are not shown" in caplog.text else Counter(tuple(map(str, row.values())) for row in rows)


def flip(path: Path, place: int, bit: int) -> None:
    with path.open("r+b") as file:
        file.seek(place)
        octet = file.read(1)[0]
        file.seek(place)
        file.write(bytes([octet ^ 1 << bit]))


FEW_AND_MANY = [40, pytest.param(3000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]


@pytest.mark.parametrize("count", FEW_AND_MANY)
def test_flipped_bit_anywhere_shows_no_changed_row(
    whole: Path, memory: Path, rng: np.random.Generator, caplog: pytest.LogCaptureFixture, count: int
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    truth = asked(path, caplog)
    assert None not in truth.values()
    size, reported, wrong, silent = whole.stat().st_size, 0, [], []
    for _ in range(count):
        place, bit = int(rng.integers(size)), int(rng.integers(8))
        flip(path, place, bit)
        found = asked(path, caplog)
        reported += None in found.values()
        wrong += [
            (place, bit, name)
            for name, rows in found.items()
            if rows is not None and rows - (truth[name] or Shown())
        ]
        silent += [
            (place, bit, name)
            for name in WHOLE_ANSWERS
            if found[name] is not None and truth[name] != found[name]
        ]
        flip(path, place, bit)
    figure(f"bits flipped anywhere: {count}, {reported} said so by a question, {len(wrong)} answers with a "
           f"changed row, {len(silent)} with one left out and nothing said")  # fmt: skip
    assert wrong == []
    assert silent == []


def numbers_of(path: Path, table: str) -> list[tuple[int, int]]:
    """Return the places and widths, in octets, of what numbers the rows in the last leaf of a table: their
    count first.

    The format is in https://www.sqlite.org/fileformat2.html#b_tree_pages.
    """
    octets = path.read_bytes()
    with closing(sqlite3.connect(path)) as file:
        size = file.execute("PRAGMA page_size").fetchone()[0]
        page = file.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()[0]
    interior, leaf = 0x05, 0x0D
    while octets[start := (page - 1) * size] == interior:
        page = int.from_bytes(octets[start + 8 : start + 12])
    assert octets[start] == leaf
    count = int.from_bytes(octets[start + 3 : start + 5])
    places = [(start + 3, 2)]
    for cell in range(count):
        pointer = start + 8 + 2 * cell
        at = start + int.from_bytes(octets[pointer : pointer + 2])
        places.append((at + _varint(octets, at), _varint(octets, at + _varint(octets, at))))
    return places


def test_run_that_is_not_live_any_more_is_missed(
    whole: Path, memory: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    place, width = numbers_of(path, "runs")[-1]
    kind = path.read_bytes().index(
        bytes([13 + 2 * len("live")]), place + width
    )  # its type: a text of four letters
    assert kind < place + width + 8
    flip(path, kind, 2)
    assert [name for name, rows in asked(path, caplog).items() if rows is not None] == []


def _varint(octets: bytes, at: int) -> int:
    return next(n for n in range(1, 10) if octets[at + n - 1] < 0x80)


SELDOM = [pytest.param(table, marks=pytest.mark.soak) for table in ("clocks", "overlaps")]


@pytest.mark.parametrize("table", ["runs", "series", "rigs", "alarms", *SELDOM])
def test_row_that_its_page_no_longer_numbers_is_missed(
    whole: Path, memory: Path, caplog: pytest.LogCaptureFixture, table: str
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    truth = asked(path, caplog)
    count, *cells = numbers_of(path, table)
    places = [place + octet for place, width in (count, cells[-1]) for octet in range(width)]
    passed = []
    for place, bit in ((place, bit) for place in places for bit in range(8)):
        flip(path, place, bit)
        found = asked(path, caplog)
        passed += [(place, bit, name) for name, rows in found.items() if rows not in (None, truth[name])]
        flip(path, place, bit)
    assert passed == []


@pytest.mark.parametrize("count", FEW_AND_MANY)
def test_flipped_bit_in_the_text_of_a_view_is_noticed_by_check_and_by_every_question(
    whole: Path, memory: Path, rng: np.random.Generator, caplog: pytest.LogCaptureFixture, count: int
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    places = view_text(path)
    for place in rng.choice(places, count):
        bit = int(rng.integers(8))
        flip(path, int(place), bit)
        assert not any(rows is not None for rows in asked(path, caplog).values()), (
            f"bit {bit} of byte {place}"
        )
        assert _problems(path), f"bit {bit} of byte {place}"
        flip(path, int(place), bit)
    figure(f"bits flipped in the text of views: {count}, all noticed by db check and by every question")


def _problems(path: Path) -> list[str]:
    try:
        return maintenance.check(path).problems
    except AgentError as error:
        return [str(error)]


def view_text(path: Path) -> list[int]:
    """Return the places of a file that hold a view's text."""
    octets, places = path.read_bytes(), []
    for (kind, _), (_, text) in own_schema().items():
        if kind == "view":
            words = str(text).encode()
            for first in range(0, len(words) - 40, 20):  # long texts go on in other pages
                at = octets.find(words[first : first + 40])
                places += range(at, at + 40) if at >= 0 else ()
    assert len(places) > 5000
    return sorted(set(places))


def test_rows_that_are_refused_are_counted(whole: Path, memory: Path) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as file:
        file.execute(
            "UPDATE estimates SET value = 9 "
            "WHERE seq IN (SELECT seq FROM estimates ORDER BY seq DESC LIMIT 3)"
        )
        file.commit()
    program = (sys.executable, "-m", "agent", "estimates", path, "--json")
    done = subprocess.run(program, capture_output=True, text=True, check=True, cwd=peers.ROOT, timeout=60)
    assert '"refused": 3}' in done.stdout
    assert "3 rows are not shown, their checksums are wrong; `deltak db check` tells more" in done.stderr
    assert len(queries.estimates(path)) == len(queries.estimates(whole)) - 3


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE clocks SET offset_ns = offset_ns + 3600000000000",
        "UPDATE clocks SET part_of = run_id",
        "UPDATE runs SET kind = 'replay'",
        (
            "UPDATE hops SET t_ns = t_ns + 60000000000 "
            "WHERE t_ns = (SELECT max(t_ns) FROM hops h WHERE h.run_id = 5)"
        ),
    ],
)
def test_damage_to_what_orders_the_parts_of_a_run_is_not_shown_as_time(
    whole: Path, memory: Path, caplog: pytest.LogCaptureFixture, statement: str
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    assert _shown(lambda: _points(path, "press-9"), caplog) is not None
    with closing(sqlite3.connect(path)) as file:
        assert file.execute(statement).rowcount >= 1
        file.commit()
    for ask in (lambda: _points(path, "press-9"), lambda: queries.estimates(path, "press-9", "k1")):
        assert _shown(ask, caplog) is None


@pytest.mark.parametrize("index", ["clocks_by_run", "overlaps_by_run"])
def test_index_that_leaves_out_a_row_that_hides_others_is_damage(
    whole: Path, memory: Path, index: str
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    leave_out(path, index, "seq < 0")
    for ask in (queries.estimates, lambda path: points_of(path, "press-7", "k1")):
        with pytest.raises(StoreError, match="an index does not list what its table holds"):
            ask(path)


def leave_out(path: Path, index: str, condition: str) -> None:
    """Make an index leave out rows, as damage to its pages may; its text says nothing of it."""
    with closing(sqlite3.connect(path)) as file:
        text = file.execute("SELECT sql FROM sqlite_master WHERE name = ?", (index,)).fetchone()[0]
        file.execute("PRAGMA writable_schema = ON")
        file.execute("UPDATE sqlite_master SET sql = sql || ? WHERE name = ?", (f" WHERE {condition}", index))
        file.commit()
    with closing(sqlite3.connect(path)) as file:
        file.execute(f"REINDEX {index}")
        file.execute("PRAGMA writable_schema = ON")
        file.execute("UPDATE sqlite_master SET sql = ? WHERE name = ?", (text, index))
        file.commit()


NEWEST = "(SELECT max(seq) FROM hops WHERE run_id = 1 AND span = 0)"


def _newest_hop(path: Path) -> int:
    with closing(sqlite3.connect(path)) as file:
        return int(file.execute(f"SELECT {NEWEST}").fetchone()[0])


def test_newest_row_that_the_index_leaves_out_is_not_replaced_by_an_older_one(
    whole: Path, memory: Path
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    leave_out(path, "hops_by_time", f"seq <> {_newest_hop(path)}")
    for ask in (queries.latest, queries.estimates, lambda path: list(maintenance.export(path, "tiers")[1])):
        with pytest.raises(StoreError, match="an index does not list what its table holds"):
            ask(path)


def test_newest_row_of_all_that_the_index_leaves_out_is_missed_by_a_trend(memory: Path) -> None:
    path = memory / "rig.db"
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(30)])
    leave_out(path, "hops_by_time", "seq < 30")
    with pytest.raises(StoreError, match="an index does not list what its table holds"):
        points_of(path, "press-7", "k1")


@pytest.mark.parametrize(
    "damage",
    ["DELETE FROM estimates", "UPDATE estimates SET value = 9.0", "UPDATE estimates SET series_id = 99"],
)
def test_newest_estimate_that_is_damaged_is_counted_by_latest_and_estimates(
    whole: Path, memory: Path, damage: str
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as file:
        assert file.execute(f"{damage} WHERE seq = {NEWEST} * 1024 + 1").rowcount == 1
        file.commit()
    assert queries.latest(path, "press-7").refused == 1
    assert queries.estimates(path, "press-7").refused == 1
    assert queries.estimates(path, "press-7", "k2").refused == 1
    assert queries.estimates(path, "press-7", "k1").refused == 0


@pytest.mark.parametrize(
    ("table", "ask"),
    [
        ("alarms", queries.alarms), ("events", queries.events), ("health", queries.health),
        ("event_records", queries.event_records), ("runs", queries.runs),
    ],
)  # fmt: skip
def test_damaged_newest_row_of_other_answers_is_counted(
    whole: Path, memory: Path, table: str, ask: Callable[[Path], queries.Rows]
) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as file:
        if table == "events":
            file.execute("INSERT INTO events VALUES (1, 1, 'clock', 1, 'a', 'b', 7)")
        newest = (
            f"(SELECT max(seq) FROM {table} "
            "WHERE seq NOT IN (SELECT run_id FROM clocks WHERE run_id <> part_of))"
        )
        file.execute(f"UPDATE {table} SET crc = crc + 1 WHERE seq = {newest}")
        file.commit()
    assert ask(path).refused >= 1


RECURSIVE = (
    "CREATE VIEW {} AS WITH RECURSIVE n (key) AS (SELECT 1 UNION ALL SELECT key + 1 FROM n) SELECT key FROM n"
)


@pytest.mark.parametrize("name", ["v_meta", "v_latest", "json_each"])
def test_views_of_a_foreign_file_are_not_executed(whole: Path, memory: Path, name: str) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as file:
        if name.startswith("v_"):
            file.execute(f"DROP VIEW {name}")
        file.execute(RECURSIVE.format(name))
        file.commit()
    begin = time.monotonic()
    for ask in (points_of, queries.estimates):
        with pytest.raises(StoreError, match=name):
            ask(path, "press-7", "k1")
    assert any(name in problem for problem in maintenance.check(path).problems)
    assert time.monotonic() - begin < 20.0


def test_views_and_tables_that_users_add_are_left_alone(whole: Path, memory: Path) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as file:
        file.execute("CREATE VIEW mine AS SELECT parameter, value FROM v_latest")
        file.commit()
    assert maintenance.check(path).problems == []
    with Store.open(path) as store:
        assert store.recovery is None
    assert not beside(path, ".corrupt-").exists()


def test_start_on_a_file_whose_view_was_changed_makes_it_anew(whole: Path, memory: Path) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    shown = queries.estimates(path)
    flip(path, path.read_bytes().index(b"e.value - s.reference AS delta"), 0)
    with Store.open(path) as store:
        assert store.recovery is not None
        assert "the text of view v_" in store.recovery.cause
    assert queries.estimates(path) == shown


def test_file_whose_schema_became_bytes_is_set_aside(whole: Path, memory: Path) -> None:
    path = memory / "rig.db"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as file:
        file.execute("PRAGMA writable_schema = ON")
        file.execute("UPDATE sqlite_master SET sql = CAST(sql AS BLOB) WHERE name = 'conditions'")
        file.commit()
    with Store.open(path):
        assert list(memory.glob("rig.db.corrupt-*"))
