"""Stored forecasts whose time has come, held against the history since."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agent.prognosis.crossing import beyond, score
from agent.records import ForecastScore
from agent.runtime.tuning import LONG_TIMES
from agent.types import FloatArray, IntArray

Row = Mapping[str, Any]
"""A row of v_forecast."""


def scores_of(waiting: Sequence[Row], t_ns: IntArray, value: FloatArray) -> list[ForecastScore]:
    """Return the scores that are due.

    waiting: rows of one parameter that are not scored. t_ns, value (n,): its history until now, in order of
    time.
    """
    if not len(t_ns):
        return []
    found = (_scored(row, t_ns, value) for row in waiting)
    return [one for one in found if one is not None]


def _scored(row: Row, t_ns: IntArray, value: FloatArray) -> ForecastScore | None:
    now = int(t_ns[-1])
    if row["status"] == "crossed":
        return _score(row, now, None)
    way = row["limit_value"] - row["level"]
    later = int(np.searchsorted(t_ns, row["made_at_ns"], side="right"))
    reached = np.flatnonzero(beyond(value[later:], row["limit_value"], way))
    if len(reached):
        return _score(row, now, int(t_ns[later + reached[0]]))
    return _score(row, now, None) if now > _until(row) else None


def _until(row: Row) -> float:
    """Return until when a passage is awaited, ns."""
    if row["p90_ns"] is None:
        return float(row["made_at_ns"]) + 1e9 * float(row["horizon_s"])
    return float(row["made_at_ns"]) + LONG_TIMES * float(row["p90_ns"] - row["made_at_ns"])


def _score(row: Row, now: int, crossed: int | None) -> ForecastScore:
    came_s = ((now if crossed is None else crossed) - row["made_at_ns"]) / 1e9
    draws = np.array([] if row["status"] == "crossed" else json.loads(row["draws"]))
    held = None
    if row["p10_ns"] is not None and row["status"] != "crossed":
        held = crossed is not None and row["p10_ns"] <= crossed <= row["p90_ns"]
    crps = score(draws, came_s, censored=crossed is None)
    return ForecastScore(row["rig"], row["parameter"], row["id"], row["made_at_ns"], now, crossed, crps, held)
