"""Read-only questions about baselines: those of a rig, and of which graph its rows are."""

from pathlib import Path

from agent.records import Baseline
from agent.storage.database.checksum import checked
from agent.storage.read.proof import FIRST, LAST
from agent.storage.read.queries import Rows, view_rows
from agent.storage.read.selection import reading
from agent.storage.tables.baselines import standing_baselines

_GRAPHS = """SELECT x.seq, x.run_id, x.graph, x.crc FROM graphs x JOIN runs r ON r.seq = x.run_id
 JOIN rigs g ON g.seq = r.rig_id WHERE g.name = ? AND EXISTS (SELECT 1 FROM hops h WHERE h.run_id = r.seq
 AND h.span IN (0, 60, 3600) AND h.t_ns BETWEEN ? AND ?) ORDER BY x.seq"""


def baselines(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_baselines, oldest first; rig: None for all. Raises StoreError."""
    with reading(db) as connection:
        condition, values = ("rig = ?", (rig,)) if rig is not None else ("1 = 1", ())
        return view_rows(connection, "v_baselines", f"{condition} ORDER BY baseline_id", values)


def standing(db: Path | str, rig: str) -> tuple[Baseline, ...]:
    """Return the baselines that a rig counts from, one a parameter. Raises StoreError."""
    with reading(db) as connection:
        return standing_baselines(connection, rig)


def graphs(db: Path | str, rig: str, first_ns: int = FIRST, last_ns: int = LAST) -> list[str]:
    """Return the graphs of a rig's rows in a stretch, oldest first; runs that state none are passed over."""
    with reading(db) as connection:
        rows = connection.execute(_GRAPHS, (rig, first_ns, last_ns)).fetchall()
    return list(dict.fromkeys(cells[-1] for cells in map(checked, rows) if cells is not None))
