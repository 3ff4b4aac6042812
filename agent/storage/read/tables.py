"""Histories from elsewhere: a CSV or Parquet table of time, value and, where there is one, sd."""

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import compress
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from agent.errors import UsageError
from agent.storage.read.points import Points
from agent.storage.read.times import age_ns, parse_time
from agent.storage.tuning import LARGEST, LONGEST_LINE

ENDINGS = frozenset({".csv", ".parquet", ".pq"})
_TIMES = ("time", "t", "t_ns")
_WHEN = "seconds, or ISO 8601, from 1678 to 2261"
_FIRST_NS, _LAST_NS = -(2**63) + 1, 2**63 - 1
"""Fixed by 64 bits: years 1677 and 2262: what 64 bits of nanoseconds hold."""
_ADVICE = "a history has the columns time (ISO 8601, or seconds), value and, where there is one, sd"


def is_table(path: Path) -> bool:
    """Tell whether a file is a table by its name's end; a folder is one where it holds Parquet files."""
    is_archive = path.is_dir() and next(path.rglob("*.parquet"), None) is not None
    return is_archive or path.suffix.lower() in ENDINGS


def table_points(
    path: Path, since: str | None = None, until: str | None = None, parameter: str | None = None
) -> tuple[Points, int]:
    """Return the history in a table in order of time, and how many rows stood before an earlier one.

    parameter: the one meant, where the table has a column of that name. Rows without a number are left out,
    those of infinite sd, and those whose status, where there is such a column, is not valid. A row without
    an sd beside rows with one takes their median.

    Raises UsageError for a file that cannot be read or is no history.
    """
    columns = _meant(path, _columns(path), parameter)
    clock = next(filter(columns.__contains__, _TIMES), None)
    if clock is None or "value" not in columns:
        raise UsageError.at(path, f"has the columns {', '.join(columns) or 'none'}", _ADVICE)
    t_ns = np.array(
        [_instant(path, row, cell, clock) for row, cell in enumerate(columns[clock], 2)], dtype=np.int64
    )
    value = _numbers(path, "value", columns["value"])
    sd = _deviations(path, columns["sd"]) if "sd" in columns else np.zeros(len(value))
    keep = np.isfinite(value) & np.isfinite(sd)
    backward = int(np.sum(np.diff(t_ns[keep]) < 0))
    order = np.flatnonzero(keep)[np.argsort(t_ns[keep], kind="stable")]
    t_ns, value, sd = t_ns[order], value[order], sd[order]
    first, last = (_bound(text, t_ns) for text in (since, until))
    kept = np.ones(len(t_ns), dtype=np.bool_)
    if first is not None:
        kept &= t_ns >= first
    if last is not None:
        kept &= t_ns <= last
    t_ns, value, sd = t_ns[kept], value[kept], sd[kept]
    found = Points(path.stem, "value", "1", t_ns, value, sd, sd, np.zeros_like(t_ns), first, last, None, 0)
    return found, backward


def _meant(
    path: Path, columns: Mapping[str, Sequence[Any]], parameter: str | None
) -> Mapping[str, Sequence[Any]]:
    """Return the rows of one parameter of one rig that are valid, of a table that says of which they are."""
    wanted = {"rig": _only(path, "rig", columns), "status": "valid"}
    wanted["parameter"] = _only(path, "parameter", columns) if parameter is None else parameter
    there = sorted({str(cell) for cell in columns.get("parameter", ())})
    if there and parameter is not None and parameter not in there:
        raise UsageError.at(path, f"holds no {parameter}", f"it holds {', '.join(there[:20])}")
    keep = [True] * max(map(len, columns.values()), default=0)
    for name in wanted.keys() & columns.keys():
        keep = [kept and cell == wanted[name] for kept, cell in zip(keep, columns[name], strict=True)]
    return {name: list(compress(cells, keep)) for name, cells in columns.items()}


def _only(path: Path, name: str, columns: Mapping[str, Sequence[Any]]) -> Any:
    """Return what a column holds throughout. Raises UsageError where that differs."""
    there = sorted({str(cell) for cell in columns.get(name, ())})
    if len(there) > 1:
        raise UsageError.at(path, f"holds several of {name}: {', '.join(there[:20])}", f"name the {name}")
    return there[0] if there else None


def _bound(text: str | None, t_ns: "np.ndarray[Any, np.dtype[np.int64]]") -> int | None:
    newest = int(t_ns[-1]) if len(t_ns) else 0
    return None if text is None else parse_time(text, newest)


def _columns(path: Path) -> Mapping[str, Sequence[Any]]:
    try:
        return _csv(path) if path.suffix.lower() == ".csv" else _parquet(path)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError.at(
            path, f"cannot be read: {error}", "name a CSV or Parquet file there is"
        ) from error


def _csv(path: Path) -> dict[str, list[str]]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = csv.DictReader(_lines(path, file))
        names = [name.strip() for name in rows.fieldnames or ()]
        cells = [[cell or "" for cell in (row[name] for name in rows.fieldnames or ())] for row in rows]
    twice = sorted({name for name in names if name and names.count(name) > 1})
    if twice:
        raise UsageError.at(path, f"has the column {', '.join(twice)} more than once", _ADVICE)
    return {name: [row[i] for row in cells] for i, name in enumerate(names)}


def _lines(path: Path, file: TextIO) -> Iterator[str]:
    """Yield the lines of a file; UsageError for one that is no row of a history, before it fills memory."""
    while line := file.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise UsageError.at(path, f"has a row of {LONGEST_LINE} characters or more", _ADVICE)
        yield line


def _parquet(path: Path) -> dict[str, list[Any]]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise UsageError.at(path, "pyarrow is not installed", "pip install 'deltak[parquet]'") from error
    try:
        table = pq.read_table(path)
    except pa.ArrowInvalid as error:
        raise UsageError.at(path, f"cannot be read: {error}", "name a Parquet file") from error
    return {name: table.column(name).to_pylist() for name in table.column_names}


def _instant(path: Path, row: int, cell: Any, clock: str) -> int:
    """Return nanoseconds of a time: an ISO text, a moment, or a number of seconds (nanoseconds in t_ns)."""
    if hasattr(cell, "timestamp"):
        cell = cell.isoformat()
    if isinstance(cell, int) and clock == "t_ns":
        return cell
    try:
        seconds = float(cell)
    except (TypeError, ValueError):
        return _iso(path, row, str(cell))
    if not math.isfinite(seconds) or abs(seconds) * (1.0 if clock == "t_ns" else 1e9) > 9e18:
        raise UsageError.at(f"{path}:{row}", f'"{cell}" is no time', _WHEN)
    return int(cell) if clock == "t_ns" else round(seconds * 1e9)


def _iso(path: Path, row: int, text: str) -> int:
    try:
        if age_ns(text) is None and _FIRST_NS <= (t_ns := parse_time(text, 0)) <= _LAST_NS:
            return t_ns
    except UsageError:
        pass  # the line says more than the option that parse_time names
    raise UsageError.at(f"{path}:{row}", f'"{text}" is no time', _WHEN)


def _deviations(path: Path, cells: Sequence[Any]) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Return the sd of every row (n,): 0 where none states one."""
    sd = _numbers(path, "sd", cells)
    if (sd < 0.0).any():
        raise UsageError.at(path, f"the column sd holds {sd[sd < 0.0][0]:g}, which is no deviation", _ADVICE)
    stated = sd[np.isfinite(sd)]
    return np.where(np.isnan(sd), float(np.median(stated)) if len(stated) else 0.0, sd)


def _numbers(path: Path, name: str, cells: Sequence[Any]) -> "np.ndarray[Any, np.dtype[np.float64]]":
    try:
        found = np.array(
            [math.nan if cell in {None, ""} else float(cell) for cell in cells], dtype=np.float64
        )
    except (TypeError, ValueError) as error:
        raise UsageError.at(path, f"the column {name} holds what is no number: {error}", _ADVICE) from error
    beyond = found[np.isfinite(found) & (np.abs(found) > LARGEST)]
    if len(beyond):
        raise UsageError.at(path, f"the column {name} holds {beyond[0]:g}, past what is measured", _ADVICE)
    return found
