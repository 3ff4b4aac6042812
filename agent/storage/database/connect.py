"""Connections to the file: the one that writes, and those that only read."""

import errno
import os
import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from agent.errors import StoreError
from agent.storage.database.files import (
    Kind,
    beside,
    check_place,
    hand_over,
    kind_of,
    opened,
    refuse,
    refuse_links,
    remove_database,
    sync_folder,
)
from agent.storage.database.schema import PAGE_SIZE, SCHEMA_VERSION, strange_schema, version_of, write_schema
from agent.storage.tuning import WAL_BOUND

FRAME_BYTES = PAGE_SIZE + 24  # fixed by SQLite's file format
_WRITER = (
    "PRAGMA synchronous = FULL",  # NORMAL loses acknowledged rows at a power cut
    "PRAGMA mmap_size = 0",  # a stray write must not reach the file
    "PRAGMA wal_autocheckpoint = 0",  # the store checkpoints by itself, between commits
    f"PRAGMA journal_size_limit = {WAL_BOUND // 4}",
    "PRAGMA cache_size = -2000",  # grows to this within the first hours; more was not quicker
    "PRAGMA cell_size_check = ON",
    "PRAGMA secure_delete = OFF",  # purged pages need not be written once more
    "PRAGMA temp_store = MEMORY",
)
_TRANSIENT = frozenset({
    sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED,
})  # fmt: skip


def code_of(error: BaseException) -> int:
    """Return SQLite's primary code of an error; 0 when it has none."""
    return int(getattr(error, "sqlite_errorcode", 0) or 0) & 0xFF


def is_damage(error: BaseException) -> bool:
    """Tell whether an error says that the file's content is broken."""
    return code_of(error) in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}


def damaged(words: str) -> sqlite3.DatabaseError:
    """Return the error with which SQLite says that a file is broken, of what it does not see itself."""
    error = sqlite3.DatabaseError(words)
    error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    return error


def cause_of(error: BaseException) -> str:
    """Return why a write failed, as a few words."""
    code = code_of(error)
    no_index = (
        getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_IOERR_SHMSIZE
    )  # no room for the log's index
    if (
        code == sqlite3.SQLITE_FULL
        or no_index
        or getattr(error, "errno", None) in {errno.ENOSPC, errno.EDQUOT}
    ):
        return "disk full"
    if code == sqlite3.SQLITE_READONLY or getattr(error, "errno", None) == errno.EROFS:
        return "read only"
    if is_damage(error):
        return "damaged"
    return "busy" if code in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED} else "input output error"


def may_pass(error: BaseException) -> bool:
    """Tell whether trying again later can help."""
    return isinstance(error, OSError) or code_of(error) in _TRANSIENT


def create(path: Path) -> None:
    """Make a new database at a path in one step: built under another name, then renamed."""
    fresh = beside(path, ".new")
    remove_database(fresh)
    build(fresh)
    fresh.rename(path)
    sync_folder(path.parent)


def build(path: Path) -> None:
    """Write an empty database of this version, whole and synced, with no companion files."""
    handle = opened(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
    try:
        hand_over(handle, path.parent)
    finally:
        os.close(handle)
    connection = sqlite3.connect(path, isolation_level=None)
    try:
        connection.execute(f"PRAGMA page_size = {PAGE_SIZE}")
        _use_log(connection)
        connection.execute("PRAGMA synchronous = FULL")
        write_schema(connection)
        empty_log(connection)  # closing would do so as well, but does not say when it fails
    finally:
        connection.close()


def connect_writer(path: Path) -> sqlite3.Connection:
    """Open the writing connection; transactions are explicit. Raises StoreError for a symbolic link."""
    refuse_links(path)
    with _log_kept(path):
        connection = sqlite3.connect(
            path, isolation_level=None, check_same_thread=False, timeout=1.0, cached_statements=64
        )
        try:
            _use_log(connection)
            for pragma in _WRITER:
                connection.execute(pragma).fetchall()
        except BaseException:
            connection.close()
            raise
    return connection


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Run what stands inside as one transaction: committed at its end, undone when it raises."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


@contextmanager
def _log_kept(path: Path) -> Iterator[None]:
    """See that a connection that fails to open does not take the write-ahead log with it.

    Where the log's index cannot be opened, and at the closing only for reading, SQLite (3.40) takes the log
    for empty and deletes it. It does not while another connection is there; one that only reads deletes
    nothing.
    """
    log = beside(path, "-wal")
    if not log.exists() or not log.stat().st_size:
        yield
        return
    with closing(sqlite3.connect(_uri(path, "mode=ro"), uri=True, isolation_level=None)) as guard:
        guard.execute("PRAGMA user_version").fetchone()
        yield


def _use_log(connection: sqlite3.Connection) -> None:
    """Set the journal to write-ahead log; SQLite answers another mode where a disk refuses, and goes on."""
    mode = connection.execute("PRAGMA journal_mode = WAL").fetchone()[0]
    if mode != "wal":
        error = sqlite3.OperationalError(f"the journal stays in mode {mode}")
        error.sqlite_errorcode = sqlite3.SQLITE_IOERR
        raise error


def empty_log(connection: sqlite3.Connection) -> None:
    """Move the whole write-ahead log into the file; raises where a part of it stays."""
    if connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]:
        error = sqlite3.OperationalError("the write-ahead log cannot be emptied")
        error.sqlite_errorcode = sqlite3.SQLITE_BUSY
        raise error


class Reader(sqlite3.Connection):
    """A connection for reading only.

    Attributes:
        refused: rows that were not shown because their checksums are wrong.
        whole: tables that were looked through from end to end.
        listed: tables whose indexes were compared with them, and from which row on.
        proved: rows of tables that seldom grow, with what an index said of them, that were right.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.refused = 0
        self.whole: set[str] = set()
        self.listed: dict[str, int] = {}
        self.proved: defaultdict[str, set[tuple[Any, ...]]] = defaultdict(set)

    def refuse(self, rows: int) -> None:
        """Count rows that are not shown."""
        self.refused += rows


def connect_reader(path: Path, *, any_schema: bool = False) -> Reader:
    """Open a database for reading only; usable while an agent writes to it.

    any_schema: also one whose schema is not this program's own text, for looking at its damage; its views are
    then not to be asked, since they may say and do anything.

    A file system that cannot be written to has no place for the shared index of the write-ahead log; there
    the file is read as it is (immutable), which leaves out what only the log holds.

    Raises:
        StoreError: missing, not ours, damaged, or of another version.
    """
    path = Path(path)
    check_place(path)
    kind = kind_of(path)
    if kind is Kind.MISSING:
        raise StoreError.at(path, "there is no such database", "give the path that the agent writes to")
    if kind is Kind.DAMAGED:
        raise StoreError.at(path, "the database is damaged", "run `deltak db repair`")
    refuse(path, kind)
    for mode in ("mode=ro", "mode=ro&immutable=1"):
        connection = sqlite3.connect(
            _uri(path, mode), uri=True, isolation_level=None, timeout=5.0, factory=Reader
        )
        try:
            version = version_of(connection)
            strange = strange_schema(connection)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            connection.close()
            problem = error
            continue
        return _current(connection, path, version, None if any_schema or not strange else strange[0])
    raise unreadable(path, problem)


def unreadable(path: Path, error: Exception) -> StoreError:
    """Return the error of a file that SQLite cannot read."""
    damaged = is_damage(error) or isinstance(error, UnicodeDecodeError)
    advice = "run `deltak db repair`" if damaged else "look at its permissions and its disk"
    fault = StoreError.at(path, f"the database cannot be read ({error})", advice)
    assert isinstance(fault, StoreError)  # noqa: S101 - `at` makes an error of its own class
    return fault


def _current(connection: Reader, path: Path, version: int, strange: str | None) -> Reader:
    if version < SCHEMA_VERSION:
        connection.close()
        advice = "start the agent on it once, which brings it up to date"
        raise StoreError.at(path, f"the database is of the older version {version}", advice)
    if strange is not None:
        connection.close()
        raise StoreError.at(path, f"the database is damaged ({strange})", "run `deltak db repair`")
    return connection


def _uri(path: Path, mode: str) -> str:
    return f"file:{quote(str(path.absolute()))}?{mode}"
