"""Which stretch of time a run covers, and which earlier runs of the rig it therefore hides in the views."""

import sqlite3

from agent.storage.tables.rows import Numbers, Plan


class Coverage:
    """The stretch that one part of a run covers (a run is one part until its clock is stepped), as written.

    Live runs follow one another and hide nothing of each other, whatever the wall clock said; a replay of a
    time that the file holds already hides the older rows.
    """

    def __init__(self, connection: sqlite3.Connection, run_id: int, part: int, rig: str) -> None:
        self._run_id = part
        self._own = _stretch(connection, part)
        query = (
            "SELECT r.seq FROM runs r JOIN rigs g ON g.seq = r.rig_id WHERE g.name = ?1 AND r.seq < ?2 "
            "AND NOT (r.kind = 'live' AND (SELECT own.kind FROM runs own WHERE own.seq = ?2) = 'live')"
        )
        older = [seq for (seq,) in connection.execute(query, (rig, run_id)).fetchall()]
        stretches = {seq: _stretch(connection, seq) for seq in older}
        self._older = {seq: stretch for seq, stretch in stretches.items() if stretch is not None}
        kept = connection.execute("SELECT run_id, seq FROM overlaps WHERE by_run = ?", (part,))
        self._rows: dict[int, int] = dict(kept.fetchall())

    def extend(self, plan: Plan, first: int, last: int, numbers: Numbers) -> None:
        """Take in rows from `first` to `last` (ns) and add to the plan what they hide."""
        start, end = self._own or (first, last)
        self._own = start, end = min(first, start), max(last, end)
        for run, (older_start, older_end) in self._older.items():
            if older_start <= end and older_end >= start:
                if run not in self._rows:
                    self._rows[run] = numbers.take("overlaps")
                plan.sealed("overlaps", self._rows[run], run, self._run_id, start, end)


def _stretch(connection: sqlite3.Connection, run_id: int) -> tuple[int, int] | None:
    """Return the first and last instant (ns) that a run has rows of, in any tier; None without rows."""
    bounds = [
        connection.execute(
            "SELECT (SELECT t_ns FROM hops WHERE run_id = ?1 AND span = ?2 ORDER BY t_ns LIMIT 1), "
            "(SELECT t_ns FROM hops WHERE run_id = ?1 AND span = ?2 ORDER BY t_ns DESC LIMIT 1)",
            (run_id, span),
        ).fetchone()
        for span in (0, 60, 3600)
    ]
    firsts = [first for first, _ in bounds if first is not None]
    lasts = [last for _, last in bounds if last is not None]
    return (min(firsts), max(lasts)) if firsts else None
