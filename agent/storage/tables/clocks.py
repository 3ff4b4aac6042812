"""The settings of the wall clock that the rows of one run were stamped by: each has its own row in `runs`.

So stamps of one such part never go back, and a tier, a purge or a replay that covers one of them touches no
other. What stretch of time each covers, and so hides of earlier runs in the views, is here too.
"""

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from agent.records import ClockRecord, RunInfo
from agent.storage.tables.rows import Names, Numbers, Plan
from agent.storage.tuning import MOST_ANCHORS
from agent.tuning import STEP_NS
from agent.types import EstimateBatch


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


@dataclass(slots=True)
class _Part:
    seq: int
    offset_ns: int | None


class ClockRows:
    """The parts of one run, by the samples from which their stamps begin.

    Args:
        run_id, rig_id: the run's and its rig's numbers.
        run: what it is.
    """

    def __init__(self, run_id: int, rig_id: int, run: RunInfo) -> None:
        self._run_id, self._rig_id, self.run = run_id, rig_id, run
        self._parts = [_Part(run_id, run.offset_ns)]
        self._anchors: list[tuple[int, _Part]] = [(-(2**62), self._parts[0])]
        self._begun: set[int] = set()
        self.records: list[ClockRecord] = []
        """What was taken in."""

    def apply(self, record: ClockRecord, numbers: Numbers) -> int:
        """Note that stamps follow another clock setting; return their part, which may be an earlier one."""
        self.records.append(record)
        part = next((p for p in reversed(self._parts) if _same(p.offset_ns, record.offset_ns)), None)
        if len(self._anchors) == 1:
            part = self._parts[0]  # whatever the clock was set to before the first sample
        elif part is None:
            part = _Part(numbers.take("runs"), record.offset_ns)
            self._parts.append(part)
        part.offset_ns = record.offset_ns
        self._anchors.append((record.index, part))
        del self._anchors[1:-MOST_ANCHORS], self.records[:-MOST_ANCHORS]
        return part.seq

    def split(self, batch: EstimateBatch, names: Names, numbers: Numbers) -> list[tuple[int, EstimateBatch]]:
        """Return the rows of a batch by part; the next commit takes along the parts that begin with them."""
        pieces = list(self._pieces(batch))
        for part, piece in pieces:
            if part.seq not in self._begun:
                self._begin(names.fresh, part, int(np.min(piece.t_ns)), numbers)
        return [(part.seq, piece) for part, piece in pieces]

    def _pieces(self, batch: EstimateBatch) -> Iterator[tuple[_Part, EstimateBatch]]:
        first, newest = self._anchors[-1]
        if int(np.min(batch.index)) >= first:
            yield newest, batch
            return
        number = np.searchsorted([first for first, _ in self._anchors], batch.index, side="right") - 1
        for one in np.unique(number):
            yield self._anchors[one][1], batch.part(number == one)

    @property
    def newest(self) -> int:
        """The part that stamps are of now, if it has rows; else the run itself."""
        seq = self._anchors[-1][1].seq
        return seq if seq in self._begun else self._run_id

    @property
    def offset_ns(self) -> int | None:
        """Wall clock minus monotonic clock, as stamps are made now; None where that is not known."""
        return self._anchors[-1][1].offset_ns

    def _begin(self, plan: Plan, part: _Part, from_ns: int, numbers: Numbers) -> None:
        self._begun.add(part.seq)
        if part.seq != self._run_id:
            add_run(plan, part.seq, self._rig_id, self.run, from_ns)
        plan.sealed("clocks", numbers.take("clocks"), part.seq, self._run_id, part.offset_ns, from_ns)


def add_run(plan: Plan, seq: int, rig_id: int, run: RunInfo, from_ns: int) -> None:
    """Add the row of a run, or of a part of one, whose first stamp is from_ns."""
    facts = (run.kind, from_ns, run.code_version, run.config_sha256, run.baseline_id, run.boot_id)
    plan.sealed("runs", seq, rig_id, *facts, None, None)


def _same(one: int | None, other: int) -> bool:
    return one is not None and abs(one - other) <= STEP_NS
