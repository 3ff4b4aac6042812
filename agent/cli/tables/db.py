"""`deltak db` and `deltak export`: looking after a database file."""

import sys
from pathlib import Path
from typing import Any

from agent.cli.terminal.output import print_json, print_table, show, stdout_text
from agent.errors import StoreError, UsageError
from agent.storage import maintenance
from agent.text import counted

Document = dict[str, Any]
FORMS = ("", ".csv", ".parquet")
"""Ends of names that can be written; without one it is CSV."""


def check(db: Path, *, as_json: bool) -> None:
    """Read a whole file and print what is wrong with it. Raises StoreError when something is."""
    with maintenance.reported(db):
        report = maintenance.check(db)
    if as_json:
        print_json({"db": str(db), "problems": report.problems, "bytes": report.bytes, "rows": report.rows})
    else:
        print_table(
            f"{db}: {report.bytes} bytes", ("view", "rows"), ((k, str(n)) for k, n in report.rows.items())
        )
        show("sound" if not report.problems else "damaged")
    if report.problems:
        advice = f"deltak db repair {db} keeps every row that proves itself"
        raise StoreError.at(db, "; ".join(report.problems), advice)


def repair(db: Path, *, as_json: bool) -> None:
    """Replace a damaged file by one of the rows that prove themselves; print what came of it."""
    with maintenance.reported(db):
        found = maintenance.repair(db)
    words = "sound; nothing was changed" if found is None else f"repaired: {found}"
    document: Document = {"db": str(db), "repaired": found is not None}
    if found is not None:
        document |= {"saved": found.saved, "lost": found.refused, "lost_at_least": found.unread}
    _say(as_json, document, f"{db}: {words}")


def compact(db: Path, *, as_json: bool) -> None:
    """Give the file's free pages back to the disk."""
    with maintenance.reported(db):
        before, after = maintenance.compact(db)
    document = {"db": str(db), "bytes_before": before, "bytes_after": after}
    _say(as_json, document, f"{db}: {before} bytes before, {after} after")


def backup(db: Path, target: Path, *, as_json: bool) -> None:
    """Copy a file, also while an agent writes to it."""
    with maintenance.reported(db):
        size = maintenance.backup(db, target)
    _say(as_json, {"db": str(db), "target": str(target), "bytes": size}, f"{target}: {size} bytes")


def export(db: Path, what: str, rig: str | None, to: Path | None) -> None:
    """Write a view as CSV to stdout or a file, as Parquet where its name ends so. Raises UsageError."""
    if what not in maintenance.EXPORTED:
        raise UsageError.at("WHAT", f'"{what}" cannot be exported', f"{', '.join(maintenance.EXPORTED)} can")
    if to is None:
        maintenance.export_csv(db, what, stdout_text(), rig)
        return
    if to.suffix.lower() not in FORMS:
        raise UsageError.at(
            "--to", f"{to}: {to.suffix} cannot be written", "give a name that ends in .csv or .parquet"
        )
    try:
        count = _export_to(db, what, to, rig)
    except OSError as error:
        words = f"{to}: {error.strerror or error}"
        raise UsageError.at("--to", words, "give a file in a folder that you may write to") from error
    sys.stderr.write(f"{to}: {counted(count, 'row')}\n")


def _export_to(db: Path, what: str, to: Path, rig: str | None) -> int:
    if to.suffix.lower() == ".parquet":
        return maintenance.export_parquet(db, what, to, rig)
    with to.open("w", newline="", encoding="utf-8") as file:
        return maintenance.export_csv(db, what, file, rig)


def _say(as_json: bool, document: Document, words: str) -> None:
    if as_json:
        print_json(document)
    else:
        show(words)
