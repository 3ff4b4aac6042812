"""How well the agent did on a scenario: errors, delays, missed and false alarms, samples lost, recovery.

Everything is counted in sample numbers of the device, so no clock comes in.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.blocks.rig_model import hop_plan
from agent.evaluation.score.match import Matched, Played, match, played
from agent.evaluation.score.play import Outcome
from agent.evaluation.tuning import ALARM_GRACE_S
from agent.records import HealthEvent
from agent.types import AlarmTransition, BoolArray, EstimateBatch, FloatArray, IntArray, Status

_GOOD_NEWS = frozenset({"recovered", "restarted", "error-active"})


@dataclass(frozen=True)
class Rows:
    """All rows of a run: index, t_ns (n,); value, sd, lower, upper, window (samples), valid (n, q)."""

    batches: Sequence[EstimateBatch]
    rate_hz: float

    def _all(self, name: str) -> NDArray[Any]:
        return np.concatenate([getattr(batch, name) for batch in self.batches])

    @cached_property
    def index(self) -> IntArray:
        """The newest sample of each window."""
        return self._all("index")

    @cached_property
    def valid(self) -> BoolArray:
        """Which estimates are valid."""
        return np.asarray(self._all("status") == Status.VALID)

    @cached_property
    def window(self) -> IntArray:
        """Samples of each window."""
        return np.asarray(np.rint(self._all("window_s") * self.rate_hz).astype(np.int64))

    @cached_property
    def t_ns(self) -> IntArray:
        """Time stamps."""
        return self._all("t_ns")

    def column(self, name: str, parameter: int) -> FloatArray:
        """Return one parameter's values of a kind."""
        return np.asarray(self._all(name)[:, parameter])


class Assessment:
    """One run held against what was played.

    Args:
        outcome: what the agent made of it.
        strikes: the faults as (source, name, first sample, end).
    """

    def __init__(self, outcome: Outcome, strikes: Sequence[tuple[str, str, int, int]]) -> None:
        self._outcome = outcome
        self._strikes = strikes
        self._config = outcome.config
        self._rate = self._config.rig.sample_rate_hz
        self.truth: Played = played(self._config, outcome.truth)
        self.matched: Matched = match(outcome.samples, self.truth)
        batches = [record for record in outcome.records if isinstance(record, EstimateBatch)]
        self.rows = Rows(batches, self._rate) if batches else None
        self.names = batches[0].parameters if batches else self._config.estimator.estimate

    def document(self) -> dict[str, Any]:
        """Return all measures."""
        return {
            "samples": self.samples(),
            "parameters": self.parameters(),
            "valid_percent": self.valid_percent(),
            "spoilt_rows": self.spoilt_rows(),
            "alarms": self.alarms(),
            "faults": self.faults(),
            "events": [[e.source, e.cause] for e in self._events() if e.cause not in _GOOD_NEWS],
            "remarks": [record.cause for record in self._reported() if record.source not in self._sources],
            "sensors": sorted({a.parameter for a in self._raised("sensor")}),
            "sources_lost": len(self._raised("source")),
        }

    def samples(self) -> dict[str, Any]:
        """Return where every sample went; `lost` are those played of which nothing was used."""
        health = self._outcome.health
        balanced = all(
            h.received == h.used + sum(h.rejected.values()) + sum(h.dropped.values()) for h in health
        )
        taken = int(self.truth.ledger["samples"])
        return {
            "played": taken,
            "received": sum(h.received for h in health),
            "used": sum(h.used for h in health),
            "rejected": _added([h.rejected for h in health]),
            "dropped": _added([h.dropped for h in health]),
            "gaps": sum(h.gaps for h in health),
            "absent": {name: ledger["absent"] for name, ledger in self.truth.ledger["sources"].items()},
            "lost": taken - int(np.unique(self.matched.number[self.matched.whole]).size),
            "balanced": balanced,
        }

    def _number_at(self, index: IntArray) -> IntArray:
        """Return device's sample numbers of the agent's indices; −1 where none is known."""
        at = np.searchsorted(self.matched.index, index)
        at = np.minimum(at, max(len(self.matched.index) - 1, 0))
        if not len(self.matched.index):
            return np.full(len(index), -1)
        return np.where(self.matched.index[at] == index, self.matched.number[at], -1)

    def parameters(self) -> dict[str, Any]:
        """Return the error of every parameter's valid estimates, as `_error` takes it."""
        return {} if self.rows is None else {name: self._error(i, name) for i, name in enumerate(self.names)}

    def _error(self, i: int, name: str) -> dict[str, Any]:
        """Return what valid rows miss the truth by.

        A row says what the parameter is on an average over its window; where it runs on a line, what it is
        at the window's end. Which of the two a row is, its numbers do not say: the nearer one counts.
        """
        rows = self.rows
        assert rows is not None  # noqa: S101 (parameters() has looked)
        number = self._number_at(rows.index)
        first = number - rows.window[:, i] + 1
        assessed = rows.valid[:, i] & (first >= 0)
        if not assessed.any():
            return {"rows": 0, "rms_sd": None, "worst_sd": None, "rms_percent": None, "covered_percent": None}
        played = np.asarray(self.truth.parameters[name])
        total = np.concatenate([[0.0], np.cumsum(played)])
        last, first = number[assessed], first[assessed]
        mean = (total[last + 1] - total[first]) / (last + 1 - first)
        end = played[last]
        value = rows.column("value", i)[assessed]
        true = np.where(np.abs(value - end) < np.abs(value - mean), end, mean)
        error = value - true
        sd = rows.column("sd", i)[assessed]
        low, high = rows.column("lower", i)[assessed], rows.column("upper", i)[assessed]
        return {
            "rows": int(assessed.sum()),
            "rms_sd": float(np.sqrt(np.mean((error / sd) ** 2))),
            "worst_sd": float(np.abs(error / sd).max()),
            "rms_percent": float(100.0 * np.sqrt(np.mean((error / true) ** 2))),
            "covered_percent": float(100.0 * np.mean((low <= true) & (true <= high))),
        }

    def valid_percent(self) -> float | None:
        """Return the share of valid estimates from the first full window on."""
        if self.rows is None:
            return None
        begun = self.rows.index >= hop_plan(self._config).window - 1
        return float(100.0 * self.rows.valid[begun].mean()) if begun.any() else None

    def spoilt_rows(self) -> int:
        """Return how many rows with a valid estimate used a reading that is not the sensor's."""
        if self.rows is None or not len(self.matched.index):
            return 0
        size = int(max(self.matched.index[-1], self.rows.index[-1])) + 2
        spoilt = np.zeros(size, dtype=np.int64)
        spoilt[self.matched.index + 1] = self.matched.spoilt
        total = np.cumsum(spoilt)
        first = np.maximum(self.rows.index[:, None] - self.rows.window + 1, 0)
        within = total[self.rows.index + 1][:, None] - total[first]
        return int(((within > 0) & self.rows.valid).any(axis=1).sum())

    @property
    def _sources(self) -> set[str]:
        return {source.name for source in self._config.source}

    def _reported(self) -> list[HealthEvent]:
        return [record for record in self._outcome.records if isinstance(record, HealthEvent)]

    def _events(self) -> list[HealthEvent]:
        return [record for record in self._reported() if record.source in self._sources]

    def _raised(self, kind: str) -> list[AlarmTransition]:
        changes = [record for record in self._outcome.records if isinstance(record, AlarmTransition)]
        return [change for change in changes if change.kind == kind and change.to_state == "UNACK"]

    def alarms(self) -> dict[str, Any]:
        """Return how every excursion of a parameter beyond its limit was met, and which alarms had none."""
        excursions = [found for rule in self._config.limits for found in self._excursions(rule.parameter)]
        raised = self._raised("level")
        numbers = self._raised_at(raised)
        met: set[int] = set()
        for found in excursions:
            own = [
                k
                for k, (alarm, at) in enumerate(zip(raised, numbers, strict=True))
                if _is_of(found, alarm, at)
            ]
            met |= set(own)
            first = min((numbers[k] for k in own), default=None)
            found["delay_s"] = None if first is None else max(0, first - found["first"]) / self._rate
        false = [alarm.parameter for k, alarm in enumerate(raised) if k not in met]
        missed = [found["parameter"] for found in excursions if found["delay_s"] is None]
        shown = [_shown(found, self._rate) for found in excursions]
        return {"excursions": shown, "false": false, "missed": missed}

    def _raised_at(self, raised: Sequence[AlarmTransition]) -> list[int]:
        if self.rows is None or not raised:
            return []
        rows = np.searchsorted(self.rows.t_ns, np.array([alarm.t_ns for alarm in raised]))
        return [int(number) for number in self._number_at(self.rows.index[rows])]

    def _excursions(self, parameter: str) -> list[dict[str, Any]]:
        """Return the stretches in which a parameter's true value is beyond its limit."""
        values = self.truth.parameters[parameter]
        reference = self._config.parameters[parameter].nominal
        (rule,) = [rule for rule in self._config.limits if rule.parameter == parameter]
        limit = rule.limit if rule.limit is not None else abs(reference) * (rule.limit_percent or 0.0) / 100.0
        delta = values - reference
        delta = {"low": -delta, "high": delta}.get(rule.side, np.abs(delta))
        beyond = np.concatenate([[False], delta > limit, [False]])
        edges = np.flatnonzero(np.diff(beyond.astype(np.int8)))
        window = hop_plan(self._config).window
        room = 2 * window + round(((rule.on_delay_s or 0.0) + ALARM_GRACE_S) * self._rate)
        return [
            {"parameter": parameter, "first": int(a), "end": int(b), "room": room}
            for a, b in edges.reshape(-1, 2)
        ]

    def faults(self) -> list[dict[str, Any]]:
        """Return each fault's recovery: s from its end to new samples, and until every estimate was valid."""
        return [self._overcome(*strike) for strike in self._strikes]

    def _overcome(self, source: str, name: str, first: int, end: int) -> dict[str, Any]:
        over = end / self._rate
        arrivals = min(
            (at for who, at, _ in self._outcome.arrivals if who == source and at >= over), default=None
        )
        valid = None
        if self.rows is not None:
            number = self._number_at(self.rows.index)
            later = number[self.rows.valid.all(axis=1) & (number >= end)]
            valid = None if not len(later) else (int(later[0]) - end) / self._rate
        return {
            "source": source, "fault": name, "from_s": first / self._rate, "to_s": over,
            "recovery_s": None if arrivals is None else arrivals - over, "valid_again_s": valid,
        }  # fmt: skip


def _is_of(found: Mapping[str, Any], alarm: AlarmTransition, at: int) -> bool:
    return bool(
        found["parameter"] == alarm.parameter and found["first"] <= at <= found["end"] + found["room"]
    )


def _shown(found: Mapping[str, Any], rate_hz: float) -> dict[str, Any]:
    return {
        "parameter": found["parameter"], "from_s": found["first"] / rate_hz, "to_s": found["end"] / rate_hz,
        "delay_s": found["delay_s"],
    }  # fmt: skip


def _added(counts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    reasons = dict.fromkeys(reason for count in counts for reason in count)
    return {reason: n for reason in reasons if (n := sum(count.get(reason, 0) for count in counts))}
