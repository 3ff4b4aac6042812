"""The trends and forecasts of one rig: made of what its database holds, without anything that came later."""

import json
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agent.blocks.advisory.outlook import Outlook
from agent.clock import wall_ns
from agent.config import Alarm, RigConfig
from agent.errors import AgentError
from agent.prognosis.change import Change, change
from agent.prognosis.crossing import representative
from agent.prognosis.forecast import Forecast, forecast
from agent.prognosis.history import History
from agent.prognosis.learnt import Learnt
from agent.prognosis.steps import events, find_steps, without
from agent.prognosis.tuning import FARTHEST
from agent.records import ForecastRecord, HealthEvent, Record, TrendRecord
from agent.runtime.forecasts.compensated import compensated
from agent.runtime.forecasts.histories import common_sd, history_of, like_machines, window_s
from agent.runtime.forecasts.scoring import scores_of
from agent.runtime.tuning import FORECAST_ROWS, MOMENT
from agent.storage.read import queries
from agent.storage.read.points import Points, points_of
from agent.text import iso_time
from agent.units import DAY_NS

SOURCE, FAILURE = "forecast", "failure"
"""What events of forecasts that could not be made are called."""
_LAST_NS = 2**63 - 1  # fixed by 64 bits

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Made:
    """What one look at a rig led to: records for the store, outlooks for its alarms."""

    records: tuple[Record, ...] = ()
    outlooks: tuple[Outlook, ...] = ()


class Forecaster:
    """Says how the parameters of one rig move, makes and scores its forecasts; what fails becomes an event.

    config: the rig's. db: its database, which is only read.
    """

    def __init__(self, config: RigConfig, db: Path) -> None:
        self.rig, self._db, self._asked = config.rig.name, db, config.forecast
        self._limits = {alarm.parameter: alarm for alarm in config.alarm if alarm.has_limit}
        self.parameters = tuple(config.parameters)
        self._window_s = max(config.estimator.windows_s, default=None)
        self._like: dict[tuple[str, float], Learnt | None] = {}
        self._reported: dict[str, str] = {}

    def make(self, cause: str, parameters: Sequence[str], until_ns: int | None = None) -> Made:
        """Return trends and forecasts of parameters, and the scores of earlier forecasts that are due.

        until_ns: the newest instant that may be looked at; None for all.
        """
        found = [self._kept(cause, parameter, until_ns) for parameter in parameters]
        records = tuple(record for made in found for record in made.records)
        return Made(records, tuple(outlook for made in found for outlook in made.outlooks))

    def _kept(self, cause: str, parameter: str, until_ns: int | None) -> Made:
        try:
            made = self._made(cause, parameter, until_ns)
        except Exception as error:
            # a forecast is never worth a rig: whatever fails is reported once and tried again when the next
            # is due
            words = f"no forecast of {parameter}: {error}"
            log.debug("%s: %s", self.rig, words, exc_info=not isinstance(error, AgentError))
            return self._failed(parameter, words, until_ns)
        self._reported.pop(parameter, None)
        return made

    def _failed(self, parameter: str, words: str, until_ns: int | None) -> Made:
        if words == self._reported.get(parameter):
            return Made()
        self._reported[parameter] = words
        log.warning("%s: %s", self.rig, words)
        return Made(
            (HealthEvent(self.rig, SOURCE, wall_ns() if until_ns is None else until_ns, FAILURE, words),)
        )

    def _made(self, cause: str, parameter: str, until_ns: int | None) -> Made:
        if parameter not in queries.parameters(self._db, self.rig):
            return Made()  # no row yet
        until = None if until_ns is None else iso_time(until_ns)
        points = points_of(self._db, self.rig, parameter, until=until, most=FORECAST_ROWS)
        if not len(points.t_ns):
            return Made()
        points = compensated(self._db, points).points
        waiting = queries.forecasts(self._db, self.rig, parameter, waiting=True)
        scores = scores_of(waiting, points.t_ns, points.value)
        outlook, record = self._look(cause, points)
        return Made((*scores, *record), (outlook,))

    def _look(self, cause: str, points: Points) -> tuple[Outlook, list[Record]]:
        seen = self._seen(points)
        rule = self._limits.get(points.parameter)
        if rule is None:
            return _outlook(seen, None, None), [_trend(seen)]
        way = _way(rule, seen.reference)
        side = _side(rule, seen.change, seen.level - seen.reference)
        limit = seen.reference + side * way
        made = self._forecast(seen, limit)
        if made.status == "too short" and side * (seen.level - limit) >= 0.0:
            made = Forecast("crossed", horizon=made.horizon, chance=1.0)
        return _outlook(seen, way, made), [_trend(seen), _record(cause, seen, made, limit)]

    def _seen(self, points: Points) -> "_Seen":
        window = self._window_s if self._window_s is not None else window_s(self._db, points.parameter)
        history = history_of(points, window)
        long_enough = history.span * 86_400.0 * MOMENT >= self._asked.every
        asked = change(without(history, events(find_steps(history)))) if long_enough else None
        reference = points.reference if points.reference is not None else float(points.value[0])
        return _Seen(points, history, long_enough, asked, reference)

    def _forecast(self, seen: "_Seen", limit: float) -> Forecast:
        horizon = None if self._asked.horizon is None else self._asked.horizon / 86_400.0
        if not seen.long_enough:
            return Forecast("too short", horizon=seen.history.span if horizon is None else horizon)
        return forecast(seen.history, limit, horizon, self._learnt(seen.points.parameter, limit))

    def _learnt(self, parameter: str, limit: float) -> Learnt | None:
        """Return what like machines teach of a limit, looked at once."""
        key = (parameter, limit)
        if key not in self._like:
            self._like.clear()
            self._like[key] = like_machines(self._asked.like, parameter, limit, "forecast.like")
        return self._like[key]


@dataclass(frozen=True, slots=True)
class _Seen:
    """A parameter's rows, as its history says them.

    Attributes:
        points: the rows; history: the same in days.
        long_enough: whether there is anything to forecast from.
        change: None where there are too few rows for a slope.
        reference: what a change is counted from.
    """

    points: Points
    history: History
    long_enough: bool
    change: Change | None
    reference: float

    @property
    def level(self) -> float:
        """Where the parameter is now: on its line, else at its newest row."""
        return self.change.level if self.change is not None else float(self.points.value[-1])


def _outlook(seen: _Seen, way: float | None, made: Forecast | None) -> Outlook:
    points = seen.points
    return Outlook(
        points.parameter, points.unit, int(points.t_ns[-1]), float(points.value[-1]), float(points.sd[-1]),
        seen.reference, way, made, seen.change,
    )  # fmt: skip


def _way(rule: Alarm, reference: float) -> float:
    """Return |change| at an alarm's limit, in the unit."""
    return rule.limit if rule.limit is not None else abs(reference) * (rule.limit_percent or 0.0) / 100.0


def _side(rule: Alarm, asked: Change | None, delta: float) -> float:
    """Return the side on which the limit that matters lies: the one asked for, else that it moves to."""
    if rule.side != "both":
        return -1.0 if rule.side == "low" else 1.0
    moves = delta if asked is None else asked.newest
    return 1.0 if moves > 0.0 else -1.0


def _trend(seen: _Seen) -> TrendRecord:
    """Return a parameter's level and slope as they are stored."""
    points, asked = seen.points, seen.change
    of = (points.rig, points.parameter, int(points.t_ns[-1]))
    if asked is None:
        return TrendRecord(*of, seen.level, float(points.sd[-1]), None, None, trend=False)
    sd = math.hypot(asked.level_sd, common_sd(points))
    return TrendRecord(*of, asked.level, sd, asked.slope, asked.slope_sd, trend=asked.trend)


def _record(cause: str, seen: _Seen, made: Forecast, limit: float) -> ForecastRecord:
    """Return a forecast as it is stored; what lies past the last instant there is becomes that one."""
    points = seen.points
    newest = int(points.t_ns[-1])

    def instant(days: float | None) -> int | None:
        return None if days is None else min(newest + round(days * DAY_NS), _LAST_NS)

    draws = [
        float(f"{days * 86_400.0:.6g}")
        for days in representative(made.passages, FARTHEST * seen.history.span)
    ]
    return ForecastRecord(
        points.rig, points.parameter, newest, seen.level, limit, made.status, instant(made.p10),
        instant(made.p50), instant(made.p90), made.chance, made.horizon * 86_400.0,
        json.dumps({name: round(weight, 4) for name, weight in made.family.items()}), json.dumps(draws),
        cause,
    )  # fmt: skip
