# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Rows of trends, and of forecasts: added as they are made; forecasts change once, when they are scored."""

import sqlite3

from agent.records import ForecastRecord, ForecastScore, TrendRecord
from agent.storage.database.columns import columns_of
from agent.storage.tables.rows import Numbers, Plan

_NAMES = columns_of("forecasts")[:-1]
_ROW = f"SELECT {', '.join(_NAMES)} FROM forecasts WHERE seq = ?"
_SCORE = ("scored_ns", "crossed_ns", "crps", "held")


def add_forecast(plan: Plan, record: ForecastRecord, run_id: int, numbers: Numbers) -> None:
    """Add a forecast that is not scored yet."""
    made = (record.parameter, record.t_ns, record.level, record.limit, record.status)
    when = (record.p10_ns, record.p50_ns, record.p90_ns, record.chance, record.horizon_s)
    rest = (record.family, record.draws, record.cause, *(None for _ in _SCORE))
    plan.sealed("forecasts", numbers.take("forecasts"), run_id, *made, *when, *rest)


def add_trend(plan: Plan, record: TrendRecord, run_id: int, numbers: Numbers) -> None:
    """Add how a parameter moves."""
    line = (record.value, record.sd, record.slope_per_day, record.slope_sd, int(record.trend))
    plan.sealed("trends", numbers.take("trends"), run_id, record.parameter, record.t_ns, *line)


def add_score(plan: Plan, score: ForecastScore, connection: sqlite3.Connection) -> None:
    """Add what became of a forecast to its row; one that is scored already, or is gone, stays as it is."""
    found = connection.execute(_ROW, (score.number,)).fetchone()
    row = {} if found is None else dict(zip(_NAMES, found, strict=True))
    same = (row.get("parameter"), row.get("made_ns")) == (score.parameter, score.made_ns)
    if not same or row["scored_ns"] is not None:
        return
    held = None if score.held is None else int(score.held)
    row.update(zip(_SCORE, (score.t_ns, score.crossed_ns, score.crps, held), strict=True))
    plan.sealed("forecasts", *row.values())
