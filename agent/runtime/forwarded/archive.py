"""The Parquet archive of a consumer, parted by rig and day, as histories."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from agent.errors import UsageError
from agent.northbound.interface.layout import NAMES
from agent.runtime.forwarded.tiers import COLUMNS, History, piece_of

_LIMITS = ("seq", "kind", "parameter", "limit_value")


def is_archive(path: Path) -> bool:
    """Tell whether a folder is one that a consumer of kind parquet was given, or its estimates."""
    return path.is_dir() and next(_estimates(path).glob("rig=*"), None) is not None


def _estimates(path: Path) -> Path:
    return path / NAMES["estimates"] if (path / NAMES["estimates"]).is_dir() else path


class ParquetHistories:
    """An archive. Raises UsageError for what cannot be read."""

    def __init__(self, path: Path) -> None:
        self._estimates = _estimates(path)
        self._alarms = self._estimates.with_name(NAMES["alarms"])

    @cached_property
    def rigs(self) -> list[str]:
        """The names of the rigs."""
        return sorted(folder.name.partition("=")[2] for folder in self._estimates.glob("rig=*"))

    def history(self, rig: str, most: int) -> History:
        """Return what there is of a rig, day after day."""
        found = History(rig, most)
        for day in sorted((self._estimates / f"rig={rig}").glob("day=*")):
            for columns in _day(day, COLUMNS):
                found.take(piece_of(columns))
        return found

    def limits(self, rig: str) -> dict[str, float]:
        """Return the limits that level alarms of a rig were last raised at, by parameter."""
        days = sorted((self._alarms / f"rig={rig}").glob("day=*"))
        rows = sorted(
            row for day in days for columns in _day(day, _LIMITS) for row in zip(*columns, strict=True)
        )
        return {name: limit for _, kind, name, limit in rows if kind == "level" and limit is not None}


def _day(folder: Path, names: tuple[str, ...]) -> Iterator[list[list[Any]]]:
    """Yield the columns of all files of a day; nothing where there is none."""
    try:
        import pyarrow as arrow  # noqa: ICN001 - a word
        from pyarrow import parquet
    except ImportError as error:
        raise UsageError.at(folder, "pyarrow is not installed", "pip install 'deltak[parquet]'") from error
    tables = []
    for file in sorted(folder.glob("*.parquet")):
        try:
            tables.append(parquet.ParquetFile(file).read(columns=list(names)))
        except (OSError, arrow.ArrowException) as error:
            what = f"cannot be read: {' '.join(str(error).split())}"
            raise UsageError.at(file, what, "take it out of the archive, or restore it") from error
    if tables:
        whole = arrow.concat_tables(tables)
        try:
            yield [whole.column(name).to_pylist() for name in names]
        except KeyError as error:
            what = f"has not the columns of a consumer's archive: {error}"
            raise UsageError.at(folder, what, "name the folder of a consumer of kind parquet") from error
