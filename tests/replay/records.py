"""Replays of example configurations, with some lines changed, into a database, and what the database then
says."""

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.runtime.replay import replay
from tests.peers import ROOT

EXAMPLES = ROOT / "deploy" / "examples"


@dataclass(frozen=True)
class Replayed:
    """The document of a replay and the rows that it left."""

    document: dict[str, Any]
    rows: list[dict[str, Any]]

    def last(self, parameter: str) -> dict[str, Any]:
        """Return the newest valid row of a parameter."""
        return next(row for row in reversed(self.of(parameter)) if row["status"] == "valid")

    def of(self, parameter: str) -> list[dict[str, Any]]:
        """Return the rows of a parameter in order of time."""
        return [row for row in self.rows if row["parameter"] == parameter]


def replayed(
    example: str, recording: Path, folder: Path, changes: Sequence[tuple[str, str]] = ()
) -> Replayed:
    """Replay a recording through an example's configuration, each change (old text, new text) made in it."""
    text = (EXAMPLES / example).read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, f"{example} has no {old!r}"
        text = text.replace(old, new)
    config, database = folder / example, folder / "replayed.db"
    config.write_text(text, encoding="utf-8")
    database.unlink(missing_ok=True)
    document = replay(config=config, recordings=[recording], db=database)
    return Replayed(document, rows_of(database))


def rows_of(database: Path) -> list[dict[str, Any]]:
    """Return all rows of v_estimates in order of time."""
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)
    connection.row_factory = sqlite3.Row
    rows = [dict(row) for row in connection.execute("select * from v_estimates order by t_ns, parameter")]
    connection.close()
    return rows
