"""What `deltak db` and `deltak export` do: plain functions, each on a path."""

import csv
import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agent.errors import StoreError, StoreHeldError, UsageError
from agent.records import Baseline
from agent.storage.database.connect import cause_of, connect_reader, connect_writer, may_pass
from agent.storage.database.files import (
    Kind,
    Lock,
    beside,
    check_place,
    check_writable,
    created,
    kind_of,
    refuse,
    refuse_links,
    remove_database,
    sync_folder,
)
from agent.storage.database.verify import problems
from agent.storage.read import queries
from agent.storage.read.proof import proven
from agent.storage.read.selection import reading
from agent.storage.recovery.salvage import Recovery, recover
from agent.storage.write.command_socket import ask
from agent.storage.write.store import Store
from agent.storage.write.watermark import Watermarks

if TYPE_CHECKING:
    from _typeshed import SupportsWrite


@dataclass(frozen=True, slots=True)
class Report:
    """What a check found: problems in words (none: the file is sound), its size and its rows by view."""

    path: Path
    problems: list[str]
    bytes: int
    rows: dict[str, int]


_COUNTED = (
    "v_runs", "v_estimates_windows", "v_alarms", "v_alarm_events", "v_health", "v_events", "v_event_records",
    "v_notifications", "v_covariates",
)  # fmt: skip


@contextmanager
def reported(path: Path | str) -> Iterator[None]:
    """Turn what a disk refuses into a StoreError."""
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        what = f"{cause_of(error)} ({error})"
        is_held = "locked" in str(error)
        advice = "end the other program that holds it" if is_held else "look at its disk and its permissions"
        raise StoreError.at(path, what, advice) from error


def check(path: Path | str) -> Report:
    """Read a whole database and say what is wrong with it; changes nothing and may run while an agent writes.

    Raises:
        StoreError: missing, not ours, newer.
    """
    path = Path(path)
    check_place(path)
    kind = kind_of(path)
    if kind is Kind.DAMAGED:
        return Report(path, ["its header is damaged"], path.stat().st_size, {})
    with closing(connect_reader(path, any_schema=True)) as connection:
        connection.execute("BEGIN")  # one state of the file, however long it takes
        found = problems(connection)
        rows = {} if found else {view: _count(connection, view) for view in _COUNTED}
    return Report(path, found, path.stat().st_size, rows)


def _count(connection: sqlite3.Connection, view: str) -> int:
    return int(connection.execute(f"SELECT count(*) FROM {view}").fetchone()[0])  # noqa: S608 - own names


def repair(path: Path | str) -> Recovery | None:
    """Replace a damaged database by one of the rows that prove themselves; None if nothing is wrong with it.

    An agent that writes to it is asked to do it.

    Raises:
        StoreError: missing, not ours, newer, or a process writes to it that cannot be asked.
    """
    path = Path(path)
    check_place(path)
    kind = kind_of(path)
    refuse(path, kind)
    _refuse_missing(path, kind)
    refuse_links(path)
    if is_commanded(path):
        return _recovery(ask(path, "repair")["repaired"])
    check_writable(path)
    try:
        lock = Lock(path)
    except StoreHeldError as held:
        return _recovery(_ask_holder(path, "repair", held)["repaired"])
    try:
        watermarks = Watermarks(lock.handle, private=lock.private)
        words, torn = watermarks.missing(path)
        lost = "its header is damaged" if kind is Kind.DAMAGED else words if torn else None
        found = [lost] if lost else _problems_of(path)
        return recover(path, found[0], watermarks.highs) if found else None
    finally:
        lock.release()


def _recovery(answer: list[Any] | None) -> Recovery | None:
    return Recovery(Path(answer[0]), *answer[1:]) if answer else None


def is_commanded(path: Path) -> bool:
    """Tell whether this user may not write to a database, but there is an agent to be asked."""
    lock = beside(path, ".lock")
    return beside(path, ".sock").exists() and lock.exists() and not os.access(lock, os.W_OK)


def _problems_of(path: Path) -> list[str]:
    try:
        with closing(connect_writer(path)) as connection:
            return problems(connection)
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        if may_pass(error):
            raise
        return [str(error)]


def compact(path: Path | str) -> tuple[int, int]:
    """Give the file's free pages back to the disk; returns its size in bytes before and after.

    Needs as much free space as the file takes. An agent that writes to it is asked to do it.
    Raises StoreError as `Store.open` does.
    """
    answer = through_agent(checked_path(path), "compact", Store.compact)
    return answer["bytes_before"], answer["bytes_after"]


def store_baselines(path: Path | str, baselines: Sequence[Baseline]) -> list[int]:
    """Store baselines in a file, made if missing; returns their numbers once they are committed.

    An agent that writes to it is asked to, and counts from them at once. Raises StoreError as `Store.open`
    does.
    """

    def act(store: Store) -> dict[str, Any]:
        return {"baseline_ids": [one.baseline_id or 0 for one in store.add_baselines(baselines)]}

    fields = [asdict(one) for one in baselines]
    return list(through_agent(Path(path), "baseline", act, baselines=fields)["baseline_ids"])


def checked_path(path: Path | str) -> Path:
    """Return the path of a database. Raises StoreError where there is none."""
    path = Path(path)
    check_place(path)
    _refuse_missing(path, kind_of(path))
    return path


def _refuse_missing(path: Path, kind: Kind) -> None:
    if kind is Kind.MISSING:
        raise StoreError.at(path, "there is no such database", "give the path that the agent writes to")


def through_agent(
    path: Path, command: str, act: Callable[[Store], dict[str, Any]], **arguments: Any
) -> dict[str, Any]:
    """Have a database changed by the agent that owns it, or here, under its lock, where there is none.

    Args:
        path: of the database.
        command: what the agent is asked.
        act: what is done here, answering as the agent does.
        **arguments: of the command, see `ask`.

    Raises:
        StoreError: as `Store.open` and `ask` do.
    """
    if is_commanded(path):
        return ask(path, command, **arguments)
    try:
        with Store.open(path) as store:
            return act(store)
    except StoreHeldError as held:
        return _ask_holder(path, command, held, **arguments)


def _ask_holder(path: Path, command: str, held: StoreHeldError, **arguments: Any) -> dict[str, Any]:
    """Have the agent that owns a database do it; an owner without a socket (a replay ...) cannot be asked.

    arguments: of `ask`.
    """
    if not beside(path, ".sock").exists():
        raise held
    return ask(path, command, **arguments)


def backup(path: Path | str, target: Path | str) -> int:
    """Copy a database while an agent writes to it; returns the copy's size in bytes.

    The copy is one state of the file, checked, and appears under its name only when it is whole.

    Raises:
        StoreError: the database is missing, not ours or damaged; UsageError: the target exists.
    """
    path, target = Path(path), Path(target)
    check_place(target)
    if target.exists() or target.is_symlink():
        raise UsageError.at(target, "exists already", "give a name that is free")
    check_writable(target)
    part = beside(target, ".part")
    part.unlink(missing_ok=True)
    created(part).close()
    try:
        with closing(connect_reader(path)) as source, closing(sqlite3.connect(part)) as copy:
            source.backup(copy)
            found = problems(copy)
            if found:
                raise StoreError.at(path, f"the database is damaged ({found[0]})", "run `deltak db repair`")
        part.rename(target)
        sync_folder(target.parent)
    finally:
        remove_database(part)
    return target.stat().st_size


EXPORTED = (
    "estimates", "alarms", "alarm_events", "health", "runs", "events", "tiers", "event_records", "verdicts",
    "baselines", "forecast", "trend", "covariates",
)  # fmt: skip
"""The views that can be written as files, without their v_."""


def export(path: Path | str, what: str, rig: str | None = None) -> tuple[list[str], Iterator[Sequence[Any]]]:
    """Return the columns and rows of a view for a file format; what: "estimates", "alarms" ... (without v_).

    Raises:
        StoreError: the file; UsageError: an unknown view or rig.
    """
    if what not in EXPORTED:
        raise UsageError.at("what", f'there is no view "{what}"', f"views are {', '.join(EXPORTED)}")
    if rig is not None and rig not in queries.rigs(path):
        raise UsageError.at(
            "--rig", f'the database has no rig "{rig}"', f"rigs are {', '.join(queries.rigs(path))}"
        )
    own = "alarm_id IN (SELECT id FROM v_alarms WHERE rig = ?)" if what == "alarm_events" else "rig = ?"
    condition, values = (own, (rig,)) if rig is not None else ("1 = 1", ())
    rows = _rows(Path(path), f"v_{what}", condition, values)
    columns = next(rows)
    return list(columns), rows


def _rows(path: Path, view: str, condition: str, values: Sequence[object]) -> Iterator[Sequence[Any]]:
    """Yield the names of a view's columns, then its rows that prove themselves."""
    with reading(path) as connection:
        columns, rows = proven(connection, view, condition, values)
        yield columns
        yield from rows


def export_csv(path: Path | str, what: str, output: "SupportsWrite[str]", rig: str | None = None) -> int:
    """Write a view as CSV (empty cell: NULL; floats to the last digit); returns the number of rows."""
    columns, rows = export(path, what, rig)
    writer = csv.writer(output, lineterminator="\n")
    writer.writerow(columns)
    count = 0
    for row in rows:
        writer.writerow(row)
        count += 1
    return count


def export_parquet(path: Path | str, what: str, target: Path | str, rig: str | None = None) -> int:
    """Write a view as a Parquet file; return the row count. Raises UsageError without the extra "parquet"."""
    try:
        from agent.storage import parquet_table
    except ImportError as error:
        raise UsageError.at("--parquet", "needs pyarrow", 'pip install "deltak[parquet]"') from error
    return parquet_table.write(*export(path, what, rig), Path(target))
