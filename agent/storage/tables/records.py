# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Records as rows, but estimates and alarms: ledgers, events, beliefs, forecasts, means, what was learnt."""

import json
import sqlite3
from collections.abc import Callable, Mapping
from dataclasses import asdict
from operator import attrgetter
from typing import Any

from agent.records import (
    ConditionsRecord,
    CovariateMean,
    EventRecord,
    ForecastRecord,
    ForecastScore,
    Health,
    HealthEvent,
    LearntRecord,
    SourceClock,
    TrendRecord,
)
from agent.storage.database.checksum import Cell, checked
from agent.storage.database.columns import columns_of
from agent.storage.tables.rows import Numbers, Plan, finite
from agent.types import Verdict

_FORECAST = columns_of("forecasts")[:-1]
_FORECAST_ROW = f"SELECT {', '.join(_FORECAST)} FROM forecasts WHERE seq = ?"
_SCORE = ("scored_ns", "crossed_ns", "crps", "held")
_NEWEST_LEARNT = """SELECT c.seq, c.run_id, c.t_ns, c.key, c.content, c.crc
 FROM learnt c JOIN runs r ON r.seq = c.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE g.name = ? AND r.kind = ? AND c.key = ? ORDER BY c.seq DESC"""


class EventRecordRows:
    """Which row each file has; a record that changes (complete, purged) changes its row."""

    def __init__(self) -> None:
        self._rows: dict[str, tuple[int, int]] = {}

    def apply(
        self, plan: Plan, record: EventRecord, run_id: int, numbers: Numbers, connection: sqlite3.Connection
    ) -> None:
        """Add a record's row as it is now to a plan, under the run that began it."""
        seq, run = self._row(record, run_id, numbers, connection)
        plan.sealed(
            "event_records", seq, run, record.t_ns, record.kind, record.parameter, record.alarms, record.file,
            record.state, record.from_ns, record.to_ns, record.samples, record.bytes, record.baseline_id,
            record.message,
        )  # fmt: skip

    def _row(
        self, record: EventRecord, run_id: int, numbers: Numbers, connection: sqlite3.Connection
    ) -> tuple[int, int]:
        if record.file not in self._rows:
            query = "SELECT seq, run_id FROM event_records WHERE file = ? ORDER BY seq DESC LIMIT 1"
            known = connection.execute(query, (record.file,)).fetchone()
            self._rows[record.file] = known or (numbers.take("event_records"), run_id)
        return self._rows[record.file]


class HealthRows:
    """Which row each source's ledger has at its newest instant.

    There is one row an instant and source, and the last one reported counts: while no sample comes the
    instant stays, and what else was counted changes that row instead of adding more of them.
    """

    def __init__(self) -> None:
        self._rows: dict[tuple[int, str], tuple[int, int]] = {}

    def apply(self, plan: Plan, record: Health, run_id: int, numbers: Numbers) -> None:
        """Add a ledger's row to a plan; the reasons travel in it as JSON, which the view takes apart."""
        rejected, dropped = sum(record.rejected.values()), sum(record.dropped.values())
        counts = map(int, (record.received, record.used, rejected, dropped, record.gaps))
        cells = (record.source, record.t_ns, *counts, finite(record.lag_s), _reasons(record))
        plan.sealed("health", self._seq(record, run_id, numbers), run_id, *cells)

    def _seq(self, record: Health, run_id: int, numbers: Numbers) -> int:
        t_ns, seq = self._rows.get((run_id, record.source), (None, 0))
        if t_ns != record.t_ns:
            seq = numbers.take("health")
            self._rows[run_id, record.source] = record.t_ns, seq
        return seq


def _reasons(record: Health) -> str | None:
    kinds = {
        "rejected": _counted(record.rejected), "dropped": _counted(record.dropped),
        "faults": _counted(record.faults), "clock": _figures(record.clock),
    }  # fmt: skip
    known = {kind: reasons for kind, reasons in kinds.items() if reasons}
    return json.dumps(known, sort_keys=True) if known else None


def _figures(clock: SourceClock | None) -> dict[str, float]:
    """What is known of a source's time; v_health takes it out again."""
    known = {} if clock is None else asdict(clock)
    return {name: value for name, value in known.items() if value is not None}


def _counted(reasons: Mapping[str, int]) -> dict[str, int]:
    return {reason: int(count) for reason, count in reasons.items() if count}


def _conditions(record: ConditionsRecord) -> tuple[Cell, ...]:
    found = record.found
    trail = json.dumps([dict(zip(record.parameters, map(finite, row), strict=True)) for row in found.trail])
    return (
        record.t_ns, record.window_s, finite(found.defect), finite(found.defect_outputs), found.rank,
        found.rank_joined, finite(found.defect_special), int(found.z_zero), found.iterations,
        int(found.converged), finite(found.cost), finite(found.step), found.passes, finite(found.ratio),
        trail,
    )  # fmt: skip


def _forecast(record: ForecastRecord) -> tuple[Cell, ...]:
    """Return the cells of a forecast that is not scored yet."""
    return (
        record.parameter, record.t_ns, record.level, record.limit, record.status, record.p10_ns,
        record.p50_ns, record.p90_ns, record.chance, record.horizon_s, record.family, record.draws,
        record.cause, *(None for _ in _SCORE),
    )  # fmt: skip


_ONE_ROW: Mapping[type, tuple[str, Callable[[Any], tuple[Cell, ...]]]] = {
    HealthEvent: ("events", attrgetter("source", "t_ns", "cause", "message")),
    Verdict: ("hypotheses", lambda belief: (
        belief.t_ns, belief.hypothesis, finite(belief.size), finite(belief.sd), belief.unit,
        finite(belief.probability))),
    CovariateMean: ("covariates", attrgetter("span_s", "t_ns", "name", "unit", "value", "n")),
    TrendRecord: ("trends", lambda line: (
        line.parameter, line.t_ns, line.value, line.sd, line.slope_per_day, line.slope_sd, int(line.trend))),
    ConditionsRecord: ("conditions", _conditions),
    ForecastRecord: ("forecasts", _forecast),
}  # fmt: skip
"""Table, and cells behind number and run, of records that are one row and rest on none stored before.

What is no number is stored as NULL.
"""


def add_one_row(plan: Plan, record: object, run_id: int, numbers: Numbers) -> None:
    """Add a record that is one row of a table; nothing for others."""
    if type(record) in _ONE_ROW:
        table, cells = _ONE_ROW[type(record)]
        plan.sealed(table, numbers.take(table), run_id, *cells(record))


def add_score(plan: Plan, score: ForecastScore, connection: sqlite3.Connection) -> None:
    """Add what became of a forecast to its row; one that is scored already, or is gone, stays as it is."""
    found = connection.execute(_FORECAST_ROW, (score.number,)).fetchone()
    row = {} if found is None else dict(zip(_FORECAST, found, strict=True))
    same = (row.get("parameter"), row.get("made_ns")) == (score.parameter, score.made_ns)
    if not same or row["scored_ns"] is not None:
        return
    held = None if score.held is None else int(score.held)
    row.update(zip(_SCORE, (score.t_ns, score.crossed_ns, score.crps, held), strict=True))
    plan.sealed("forecasts", *row.values())


class LearntRows:
    """Which row each run has; a run that learns more changes its row."""

    def __init__(self) -> None:
        self._rows: dict[int, int] = {}

    def apply(self, plan: Plan, record: LearntRecord, run_id: int, numbers: Numbers) -> None:
        """Add what a run knows now to a plan."""
        if run_id not in self._rows:
            self._rows[run_id] = numbers.take("learnt")
        learnt = record.learnt
        plan.sealed("learnt", self._rows[run_id], run_id, record.t_ns, learnt.key, learnt.content)


def newest_learnt(connection: sqlite3.Connection, rig: str, kind: str, key: str) -> str | None:
    """Return what runs of a rig of one kind learnt last for a key, as JSON text; None for nothing.

    Whatever version of the code wrote it: the content says so itself. A damaged row is passed over.
    """
    for cells in map(checked, connection.execute(_NEWEST_LEARNT, (rig, kind, key))):
        if cells is not None and _is_json(content := str(cells[-1])):
            return content
    return None


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True
