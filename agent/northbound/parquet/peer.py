"""Rows as archive files: <folder>/<topic>/rig=<rig>/day=<day of UTC>/<number before the first row>.parquet.

A file is written beside its name, synced and renamed; a batch that is delivered again has the same names, so
that no row is there twice.
"""

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pyarrow as arrow  # noqa: ICN001 - a word
from pyarrow import parquet

from agent.config.sections.north import North
from agent.northbound.interface.layout import COLUMNS, NAMES
from agent.northbound.interface.peer import Batch, PeerError, Place, Row
from agent.units import DAY_NS

_TYPES: Final[Mapping[str, Any]] = {
    "text": arrow.string(), "bigint": arrow.int64(), "double precision": arrow.float64(),
    "boolean": arrow.bool_(),
    "timestamptz": arrow.timestamp("ns", "UTC"),
}  # fmt: skip


class ParquetPeer:
    """An archive.

    Args:
        consumer: its table of the configuration.
        place: the agent around it.
    """

    def __init__(self, consumer: North, place: Place) -> None:
        self._folder = place.folder / (consumer.folder or Path())

    def open(self) -> None:
        with _failing(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)

    def deliver(self, batch: Batch) -> None:
        parts: dict[tuple[str, str], list[Row]] = {}
        for row in batch.rows:
            parts.setdefault((str(row["rig"]), _day(row["t_ns"])), []).append(row)
        for (rig, day), rows in parts.items():
            folder = self._folder / NAMES[batch.topic] / f"rig={rig}" / f"day={day}"
            with _failing(folder):
                folder.mkdir(parents=True, exist_ok=True)
                _write(folder, f"{batch.after:020d}.parquet", table_of(batch.topic, rows))

    def check(self) -> None:
        """Nothing: a folder that is gone is seen when something is written."""

    def close(self) -> None:
        """Nothing: files are closed as soon as they are written."""


def table_of(topic: str, rows: Sequence[Row]) -> Any:
    """Return rows as a table; rig and backfill are left out: the folder says the one, and order the other."""
    columns = {
        name: kind.split(" NOT")[0]
        for name, kind in COLUMNS[topic].items()
        if name not in {"rig", "backfill"}
    }
    arrays = [
        arrow.array([row["t_ns" if name == "time" else name] for row in rows], _TYPES[kind])
        for name, kind in columns.items()
    ]
    return arrow.Table.from_arrays(arrays, names=list(columns))


def _day(t_ns: int) -> str:
    """Return the day of UTC that an instant is of."""
    import numpy as np

    return str(np.datetime64(t_ns // DAY_NS, "D"))


def _write(folder: Path, name: str, table: Any) -> None:
    """Write a file that is there whole or not at all, whatever is cut."""
    beside = folder / f".{name}.part"
    with beside.open("wb") as file:
        parquet.write_table(table, file, compression="zstd")
        file.flush()
        os.fsync(file.fileno())
    beside.replace(folder / name)
    _sync(folder)


def _sync(folder: Path) -> None:
    """Sync a folder and those above it that may be new: day, rig, topic, archive."""
    for one in (folder, *list(folder.parents)[:3]):
        handle = os.open(one, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def _failing(folder: Path) -> Iterator[None]:
    """Make PeerError of what the disk refuses."""
    try:
        yield
    except (OSError, arrow.ArrowException) as error:
        full = {errno.ENOSPC, errno.EDQUOT}
        cause = "full" if getattr(error, "errno", None) in full else "refused"
        raise PeerError(cause, f"{folder}: {error}") from error
