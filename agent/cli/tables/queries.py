"""`deltak estimates`, `records` and `verdicts`: rows of the views, as a table, JSON or CSV."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agent.cli.tables.results import verdict
from agent.cli.terminal.output import print_csv, print_rows, print_table
from agent.cli.tuning import TABLE_ROWS
from agent.storage.read import queries
from agent.text import interval, number, short_time, with_sd

Row = Mapping[str, Any]

ESTIMATE_COLUMNS = (
    "rig", "run_id", "time", "t_ns", "parameter", "unit", "value", "delta", "reference", "baseline_id", "sd",
    "lower", "upper", "status", "reason", "held", "held_age_s", "window_s", "n_used", "n_missing", "span_s",
    "method", "sd_repeat",
)  # fmt: skip
RECORD_COLUMNS = (
    "id", "rig", "run_id", "t_ns", "time", "kind", "parameter", "alarm_id", "alarms", "from_ns", "to_ns",
    "samples", "bytes", "state", "file", "config_sha256", "code_version", "baseline_id", "message",
)  # fmt: skip
VERDICT_COLUMNS = ("rig", "run_id", "t_ns", "time", "hypothesis", "size", "sd", "unit", "probability")


def estimates(
    db: Path, rig: str | None, parameter: str | None, since: str | None, until: str | None, form: str
) -> None:
    """Print a file's estimates. Raises StoreError; UsageError for a senseless rig, parameter or time."""
    if form == "csv":
        print_csv(ESTIMATE_COLUMNS, queries.each_estimate(db, rig, parameter, since, until))
    elif form == "json":
        rows = queries.estimates(db, rig, parameter, since, until)
        print_rows("rows", ESTIMATE_COLUMNS, rows, form, rows.refused)
    else:
        _print_estimate_table(queries.newest_estimates(db, rig, parameter, since, until, TABLE_ROWS + 1))


def records(db: Path, rig: str | None, form: str) -> None:
    """Print the index of event records. Raises StoreError; UsageError for an unknown rig."""
    _print(queries.event_records(db, rig), "records", RECORD_COLUMNS, form, _print_record_table)


def verdicts(db: Path, rig: str | None, form: str) -> None:
    """Print what is believed of the rigs' constants. Raises StoreError; UsageError for an unknown rig."""
    _print(queries.verdicts(db, rig), "verdicts", VERDICT_COLUMNS, form, _print_verdict_table)


def _print(
    rows: queries.Rows, what: str, columns: Sequence[str], form: str, table: Callable[[queries.Rows], None]
) -> None:
    if form == "table":
        table(rows)
    else:
        print_rows(what, columns, rows, form, rows.refused)


def _print_estimate_table(rows: Sequence[Row]) -> None:
    """Print the newest rows, with the rig where there are several."""
    if not rows:
        sys.stdout.write("no rows\n")
        return
    skip = 0 if len({row["rig"] for row in rows}) > 1 else 1
    columns = ("rig", "time", "parameter", "value ± sd", "unit", "95 %", "change", "status")
    cells = (_estimate_cells(row)[skip:] for row in rows[-TABLE_ROWS:])
    print_table("", columns[skip:], cells, right={"value ± sd", "95 %", "change"})
    if len(rows) > TABLE_ROWS:
        sys.stderr.write(f"the newest {TABLE_ROWS} rows; --csv and --json give all, --since fewer\n")


def _estimate_cells(row: Row) -> tuple[str, ...]:
    return (
        row["rig"],
        short_time(row["time"]),
        row["parameter"],
        with_sd(row["value"], row["sd"]),
        row["unit"] or "",
        interval(row["lower"], row["upper"]),
        number(row["delta"], 4),
        verdict(row),
    )


def _print_record_table(rows: Sequence[Row]) -> None:
    if not rows:
        sys.stdout.write("no records\n")
        return
    columns = ("id", "rig", "raised", "alarm", "state", "samples", "file")
    print_table("", columns, (_record_cells(row) for row in rows), right={"samples"})


def _record_cells(row: Row) -> tuple[str, ...]:
    what = f"{row['kind']} {row['parameter']}" + (
        f" and {row['alarms'] - 1} more" if row["alarms"] > 1 else ""
    )
    words = f"{row['state']}: {row['message']}" if row["message"] else row["state"]
    return str(row["id"]), row["rig"], short_time(row["time"]), what, words, str(row["samples"]), row["file"]


def _print_verdict_table(rows: Sequence[Row]) -> None:
    if not rows:
        sys.stdout.write("no verdicts\n")
        return
    columns = ("rig", "time", "what is off", "by ± sd", "unit", "probability")
    print_table(
        "", columns, (_verdict_cells(row) for row in rows[-TABLE_ROWS:]), right={"by ± sd", "probability"}
    )
    if len(rows) > TABLE_ROWS:
        sys.stderr.write(f"the newest {TABLE_ROWS} of {len(rows)} rows; --csv and --json give all\n")


def _verdict_cells(row: Row) -> tuple[str, ...]:
    size = with_sd(row["size"], row["sd"])
    what = (row["rig"], short_time(row["time"]), row["hypothesis"], size, row["unit"])
    return *what, number(row["probability"], 3)
