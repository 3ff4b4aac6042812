"""A damaged file: put aside whole, never deleted; what can be read and proves itself goes into a new one."""

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from agent.storage.database.checksum import with_crc
from agent.storage.database.columns import COLUMN_BITS, TABLES, columns_of, insert_sql
from agent.storage.database.connect import build, empty_log
from agent.storage.database.files import beside, make_alike, remove_database, sync_folder
from agent.storage.database.verify import good_rows
from agent.storage.recovery.loss_estimate import REPORTED, LossEstimate
from agent.storage.recovery.page_carving import scan
from agent.storage.tables.rows import VERDICTS, Row
from agent.storage.tuning import KEPT_ASIDE, LEAP_ROWS, ROWS_READ

_LONG = frozenset({"hops", "estimates", "spreads"})
_MOST_FAILURES = {
    True: 200,
    False: 20,
}  # halvings a long or short table; a sick root would take for ever, and pages are scanned after


@dataclass(frozen=True, slots=True)
class Recovery:
    """What became of a damaged file: where it lies now, why, how many rows were saved and how many were lost.

    unread: part of it could not be read and may have held more rows than are known to be lost.
    """

    aside: Path
    cause: str
    saved: int
    refused: int
    unread: bool = False

    @property
    def lost(self) -> str:
        """How many rows were lost, in words."""
        if not self.unread:
            return f"{self.refused} were lost"
        return f"at least {self.refused} were lost" if self.refused else "how many were lost cannot be told"

    def __str__(self) -> str:
        return (
            f"the database was damaged ({self.cause}); {self.saved} rows were saved, {self.lost}; "
            f"the damaged file is {self.aside.name}"
        )


def finish_interrupted(path: Path) -> Path | None:
    """Complete a replacement that a power cut interrupted; return where the damaged file lies, None if none.

    A log without its database is what somebody left who removed that: it is put aside, and no damage.
    """
    remove_database(beside(path, ".salvaging"))
    salvaged = beside(path, ".salvaged")
    if salvaged.exists():
        return _exchange(path, salvaged)
    if beside(path, "-wal").exists() and (not path.exists() or path.stat().st_size == 0):
        # SQLite would read the log of a lost file into a new one of the same name.
        aside = _put_aside(path)
        return aside if aside.exists() else None
    return None


def recover(path: Path, cause: str, highs: Mapping[str, int] | None = None) -> Recovery:
    """Replace the damaged, closed file at a path by a new one that holds every row of it that proves itself.

    highs: the highest numbers known to have been given out, by table.
    """
    fresh = beside(path, ".salvaging")
    remove_database(fresh)
    build(fresh)
    saved, lost, unread = _copy_rows(path, fresh, highs or {})
    if path.exists():
        make_alike(fresh, path)
    fresh.rename(beside(path, ".salvaged"))
    sync_folder(path.parent)
    return Recovery(_exchange(path, beside(path, ".salvaged")), cause, saved, lost, unread)


def _exchange(path: Path, salvaged: Path) -> Path:
    """Put the old file aside and the salvaged one in its place, so that every cut between leaves a way on.

    The old log goes first: were it to meet the new file, SQLite would read it into that one.
    """
    aside = _put_aside(path)
    salvaged.rename(path)
    sync_folder(path.parent)
    return aside


def _put_aside(path: Path) -> Path:
    aside = _free_name(path)
    for suffix in ("-wal", "-journal", ""):
        with suppress(FileNotFoundError):
            beside(path, suffix).rename(beside(aside, suffix))
        if suffix == "-journal":
            sync_folder(path.parent)
    beside(path, "-shm").unlink(missing_ok=True)
    for old in sorted(path.parent.glob(f"{path.name}.corrupt-*Z*"))[: -2 * KEPT_ASIDE]:
        old.unlink(missing_ok=True)
    return aside


def _free_name(path: Path) -> Path:
    """Return a name for a damaged file; the wall clock only labels, a number keeps names apart."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    number = 0
    while True:
        aside = beside(path, f".corrupt-{stamp}-{number:03d}")
        if not aside.exists() and not beside(aside, "-wal").exists():
            return aside
        number += 1


def _copy_rows(damaged: Path, fresh: Path, highs: Mapping[str, int]) -> tuple[int, int, bool]:
    """Copy every row that can be read and whose checksum is right.

    Returns how many, how many are known to be lost, and whether there may have been more.
    """
    with closing(sqlite3.connect(fresh, isolation_level=None)) as target:
        target.execute("PRAGMA synchronous = FULL")
        loss = _copy_by_trees(damaged, target)
        for table, rows in scan(damaged, beside(damaged, "-wal")):
            _insert(target, table, rows)
        _drop_orphans(target)
        lost = loss.count(target, highs)
        _complete(target, highs)
        saved = sum(target.execute(f"SELECT count(*) FROM {t}").fetchone()[0] for t in REPORTED)  # noqa: S608 - own
        empty_log(target)
    return saved, lost, loss.unread


def _copy_by_trees(damaged: Path, target: sqlite3.Connection) -> LossEstimate:
    """Copy what SQLite itself can reach; returns what is known of the rest.

    With the log first, then without: where a log is torn, what it replaced may still stand in the file.
    """
    loss = LossEstimate()
    loss.begin(target)
    for mode in ("mode=ro", "mode=ro&immutable=1"):
        for source in _readable_source(damaged, mode):
            with closing(source):
                failures = sum(_copy_tree(source, target, table, loss) for table in TABLES)
                _insert_consumers(source, target)
                if mode == "mode=ro":  # what the file alone lists may have been deleted since
                    loss.settle(source, target, failures)
    return loss


def _copy_tree(source: sqlite3.Connection, target: sqlite3.Connection, table: str, loss: LossEstimate) -> int:
    """Copy the rows of a table that prove themselves; return how often its tree could not be followed."""
    tree = _Tree(source, table)
    for rows in tree.rows():
        right = good_rows(table, rows)
        loss.note(table, (row[0] for row, fine in zip(rows, right, strict=True) if not fine))
        good = [row for row, fine in zip(rows, right, strict=True) if fine]
        _insert(target, table, good)
    return tree.failures


def _readable_source(path: Path, mode: str) -> Iterator[sqlite3.Connection]:
    """Yield a connection whose schema can be read; nothing when it cannot."""
    with suppress(sqlite3.Error, UnicodeDecodeError):
        source = sqlite3.connect(f"file:{quote(str(path.absolute()))}?{mode}", uri=True, isolation_level=None)
        source.text_factory = lambda octets: octets.decode("utf-8", "surrogateescape")
        try:
            source.execute("SELECT count(*) FROM (SELECT 1 FROM meta LIMIT 0)").fetchone()
        except (sqlite3.Error, UnicodeDecodeError):
            source.close()
            raise
        yield source


@dataclass(slots=True)
class _Tree:
    """A table as SQLite reaches it; failures counts the stretches that could not be read."""

    source: sqlite3.Connection
    table: str
    failures: int = 0

    def rows(self) -> Iterator[list[Row]]:
        """Yield the rows; a stretch that cannot be read is halved until what is sick is narrowed down."""
        table = self.table
        columns = ", ".join(columns_of(self.table))
        wide = 1 << COLUMN_BITS if table in _LONG else 1
        most = _MOST_FAILURES[table in _LONG]
        todo = [(0, _newest(self.source, table))]
        query = f"SELECT {columns} FROM {table} WHERE seq BETWEEN ? AND ? ORDER BY seq"  # noqa: S608 - own names
        while todo and self.failures < most:
            first, last = todo.pop()
            cursor = self.source.cursor()
            try:
                cursor.execute(query, (first, last))
                while rows := _some(cursor):
                    first = rows[-1][0] + 1
                    yield rows
            except (sqlite3.Error, OverflowError, UnicodeDecodeError):
                self.failures += 1
                if last - first > wide:
                    middle = (first + last) // 2
                    todo += [(middle + 1, last), (first, middle)]


def _some(cursor: sqlite3.Cursor) -> list[Row]:
    """Return the next rows; those before one that cannot be read are returned, and the next call raises."""
    rows: list[Row] = []
    try:
        for row in cursor:
            rows.append(row)
            if len(rows) == ROWS_READ:
                break
    except (sqlite3.Error, UnicodeDecodeError):
        if not rows:
            raise
    return rows


def _newest(source: sqlite3.Connection, table: str) -> int:
    """Return the highest seq; where the end of the table is sick, a number beyond it."""
    with suppress(sqlite3.Error, UnicodeDecodeError):
        found = source.execute(f"SELECT max(seq) FROM {table}").fetchone()[0]  # noqa: S608 - own name
        return found if isinstance(found, int) else 0
    if table in _LONG:
        with suppress(sqlite3.Error, UnicodeDecodeError):
            return (int(source.execute("SELECT max(seq) FROM hops").fetchone()[0]) + 1) << COLUMN_BITS
    return 1 << (44 if table in _LONG else 34)


def _insert(target: sqlite3.Connection, table: str, rows: list[Row]) -> None:
    """Insert rows; one that is there, or that the table refuses, is left out."""
    statement = insert_sql(table, "INSERT OR IGNORE")
    target.execute("BEGIN IMMEDIATE")
    try:
        target.executemany(statement, rows)
    except (sqlite3.IntegrityError, sqlite3.DataError, UnicodeEncodeError):
        for row in rows:
            with suppress(sqlite3.IntegrityError, sqlite3.DataError, UnicodeEncodeError):
                target.execute(statement, row)
    target.execute("COMMIT")


def _insert_consumers(source: sqlite3.Connection, target: sqlite3.Connection) -> None:
    """Copy the cursors of consumers; a lost one makes its consumer fetch rows again, which is allowed."""
    with suppress(sqlite3.Error, UnicodeDecodeError):
        for row in source.execute("SELECT name, last_seq, topic FROM consumers").fetchall():
            target.execute("INSERT OR IGNORE INTO consumers (name, last_seq, topic) VALUES (?, ?, ?)", row)


def _drop_orphans(target: sqlite3.Connection) -> None:
    """Delete rows whose run, series or fit was lost: what they meant cannot be told any more."""
    for statement in (
        "DELETE FROM runs WHERE rig_id NOT IN (SELECT seq FROM rigs)",
        "DELETE FROM series WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM hops WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM estimates WHERE (seq >> 10) NOT IN (SELECT seq FROM hops)",
        "DELETE FROM estimates WHERE series_id NOT IN (SELECT seq FROM series)",
        "DELETE FROM estimates WHERE fit_id NOT IN (SELECT seq FROM fits)",
        "DELETE FROM spreads WHERE seq NOT IN (SELECT seq FROM estimates)",
        "DELETE FROM alarms WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM event_records WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM learnt WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM hypotheses WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM conditions WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM graphs WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM baselines WHERE rig_id NOT IN (SELECT seq FROM rigs)",
        "DELETE FROM covariates WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM forecasts WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM trends WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM clocks WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM sites WHERE run_id NOT IN (SELECT seq FROM runs)",
        "DELETE FROM alarm_events WHERE alarm_id NOT IN (SELECT seq FROM alarms)",
        "DELETE FROM shelves WHERE alarm_id NOT IN (SELECT seq FROM alarms)",
        "DELETE FROM annotations WHERE alarm_id NOT IN (SELECT seq FROM alarms)",
    ):
        target.execute(statement)


def _complete(target: sqlite3.Connection, highs: Mapping[str, int]) -> None:
    """Write again what can be derived, and see that no number is given out twice."""
    for code, texts in VERDICTS.items():
        cells = (code, *texts)
        target.execute(insert_sql("verdicts", "INSERT OR REPLACE"), with_crc(cells))
    high = dict(target.execute("SELECT name, high FROM sequences"))
    target.execute("DELETE FROM sequences")
    for number, table in enumerate(TABLES, 1):
        newest = target.execute(f"SELECT max(seq) FROM {table}").fetchone()[0] or 0  # noqa: S608 - own name
        cells = (number, table, max(newest, high.get(table, 0), highs.get(table, 0)) + LEAP_ROWS)
        target.execute(insert_sql("sequences"), with_crc(cells))
