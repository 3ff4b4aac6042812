"""Which rigs give valid rows: by the views every version has, since the file may be of another version."""

import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path

from agent.clock import wall_ns

Rigs = Mapping[tuple[Path, str], int]
"""By database and rig: the newest run."""
_NEWEST = "SELECT rig, run_id, t_ns, status, held_age_s FROM v_latest"


def giving(databases: Iterable[Path], within_s: float) -> Rigs:
    """Return the rigs that have given a valid row within so many seconds."""
    since_ns = wall_ns() - int(within_s * 1e9)
    found: dict[tuple[Path, str], int] = {}
    for path in databases:
        for rig, run_id, t_ns, status, held_age_s in _newest(path):
            valid_ns = t_ns if status == "valid" else t_ns - int((held_age_s or within_s) * 1e9)
            if valid_ns > since_ns:
                found[path, rig] = max(run_id, found.get((path, rig), 0))
    return found


def silent(expected: Rigs, shown: set[tuple[Path, str]]) -> list[str]:
    """Return the rigs that have given no valid row in a run newer than the expected one.

    shown: grows by those that did; a row that is valid once counts, since a machine may come to rest right
    after.
    """
    for path in {path for path, _ in expected}:
        rows = {(path, rig) for rig, run_id, _, status, _ in _newest(path)
                if status == "valid" and run_id > expected.get((path, rig), run_id)}  # fmt: skip
        shown |= rows
    return sorted(rig for path, rig in expected if (path, rig) not in shown)


def _newest(path: Path) -> list[tuple[str, int, int, str, float | None]]:
    """Return the newest row of every parameter; none while the file is being made, migrated or damaged."""
    try:
        with closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)
        ) as connection:
            connection.execute("PRAGMA trusted_schema = OFF")
            return connection.execute(_NEWEST).fetchall()
    except sqlite3.Error:
        return []
