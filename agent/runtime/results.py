"""What a run, replay or demo found, gathered from its records: the JSON document of CONTRACT section 8."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agent.alarms.life_cycle import cause_of
from agent.blocks.constants_watch import SOURCE
from agent.config import RigConfig
from agent.records import Health, HealthEvent, Record
from agent.runtime.tuning import MOST_REPORTED
from agent.text import iso_time
from agent.types import AlarmTransition, EstimateBatch, Reason, Status

_COLUMNS = ("value", "sd", "lower", "upper")


@dataclass(slots=True)
class RunSummary:
    """The summary of one rig's run; feed it every record."""

    config: RigConfig
    run_id: int | None = None
    db: str | None = None
    windows: int = 0
    _last: EstimateBatch | None = None
    _valid: np.ndarray[tuple[int], np.dtype[np.int64]] | None = None
    _first_ns: int | None = None
    _alarms: list[dict[str, Any]] = field(default_factory=list)
    _health: dict[str, Health] = field(default_factory=dict)
    _advice: list[str] = field(default_factory=list)

    def take(self, records: Sequence[Record]) -> None:
        """Note records in order of time."""
        for record in records:
            if isinstance(record, EstimateBatch):
                self._estimates(record)
            elif isinstance(record, AlarmTransition):
                self._alarm(record)
            elif isinstance(record, HealthEvent) and record.source == SOURCE:
                self.advise(record.message)
            elif isinstance(record, Health):
                self._health[record.source] = record

    def ledgers(self) -> dict[str, Health]:
        """Return the newest ledger of each source."""
        return dict(self._health)

    def advise(self, words: str) -> None:
        """Add words to the document's advice."""
        self._advice.append(words)
        del self._advice[:-MOST_REPORTED]

    def _estimates(self, batch: EstimateBatch) -> None:
        valid = (batch.status == Status.VALID).sum(axis=0)
        self._valid = valid if self._valid is None else self._valid + valid
        self.windows += len(batch)
        self._last = batch
        self._first_ns = int(batch.t_ns[0]) if self._first_ns is None else self._first_ns

    def _alarm(self, change: AlarmTransition) -> None:
        if change.to_state == "UNACK" and cause_of(change.from_state, change.to_state) == "raise":
            self._alarms.append(self._activation(change))
            del self._alarms[:-MOST_REPORTED]
            return
        alarm = self._newest(change)
        if alarm is None:
            return
        alarm["state"] = change.to_state
        if change.cause == "acknowledge":
            alarm["acked_at"] = iso_time(change.t_ns)
            alarm["acked_by"] = change.by
        if change.cause == "clear":
            alarm["cleared_at"] = iso_time(change.t_ns)

    def _newest(self, change: AlarmTransition) -> dict[str, Any] | None:
        """Return the newest activation of the alarm that a step is of; None where the run has seen none."""
        key = (change.kind, change.parameter)
        return next(
            (alarm for alarm in reversed(self._alarms) if (alarm["kind"], alarm["parameter"]) == key), None
        )

    def _activation(self, change: AlarmTransition) -> dict[str, Any]:
        return {
            "rig": change.rig, "run_id": self.run_id, "kind": change.kind, "parameter": change.parameter,
            "priority": change.priority, "state": change.to_state, "raised_at": iso_time(change.t_ns),
            "raised_ns": change.t_ns, "cleared_at": None, "acked_at": None, "acked_by": None,
            "shelved_until": None, "delta": change.delta, "sd": change.sd, "limit_value": change.limit_value,
            "probability": change.probability, "message": change.message, "advice": change.advice,
            "percent": change.percent, "site": self.config.rig.site,
            "labels": dict(self.config.rig.labels) or None,
        }  # fmt: skip

    @property
    def alarms(self) -> list[dict[str, Any]]:
        """One entry an activation."""
        return self._alarms

    def document(self, seconds: float) -> dict[str, Any]:
        """Return the document; seconds is how long the run took."""
        samples = self.samples()
        span = samples["used"] / self.config.rig.sample_rate_hz
        return {
            "rig": self.config.rig.name, "db": self.db, "run_id": self.run_id, "samples": samples,
            "faults": self.faults(), "span_s": span, "windows": self.windows, "estimates": self.estimates(),
            "alarms": self._alarms, "advice": self._advice, "seconds": seconds,
            "samples_per_s": samples["received"] / seconds if seconds > 0 else None,
        }  # fmt: skip

    def faults(self) -> dict[str, int]:
        """Return what went wrong on lines and in files without being a sample, by name, over all sources."""
        total: Counter[str] = Counter()
        for health in self._health.values():
            total.update(health.faults)
        return {reason: n for reason, n in total.items() if n}

    def samples(self) -> dict[str, Any]:
        """Return the ledger over all sources, as the newest health records have it."""
        rejected: Counter[str] = Counter()
        dropped: Counter[str] = Counter()
        for health in self._health.values():
            rejected.update(health.rejected)
            dropped.update(health.dropped)
        ledgers = self._health.values()
        return {
            "received": sum(h.received for h in ledgers),
            "used": sum(h.used for h in ledgers),
            "rejected": {reason: n for reason, n in rejected.items() if n},
            "dropped": {reason: n for reason, n in dropped.items() if n},
            "gaps": sum(h.gaps for h in ledgers),
        }

    def estimates(self) -> dict[str, dict[str, Any]]:
        """Return the newest row of each parameter."""
        batch, valid = self._last, self._valid
        if batch is None or valid is None:
            return {}
        return {name: self._estimate(batch, i, int(valid[i])) for i, name in enumerate(batch.parameters)}

    def _estimate(self, batch: EstimateBatch, i: int, valid: int) -> dict[str, Any]:
        reason = Reason(int(batch.reason[-1, i]))
        row: dict[str, Any] = {column: float(getattr(batch, column)[-1, i]) for column in _COLUMNS}
        row |= {
            "delta": row["value"] - float(batch.reference[i]),
            "status": Status(int(batch.status[-1, i])).name.lower(),
            "reason": None if reason is Reason.NONE else reason.name.lower().replace("_", " "),
            "held": _known(batch.held[-1, i]), "held_age_s": _known(batch.held_age_s[-1, i]),
            "t_ns": int(batch.t_ns[-1]), "unit": batch.units[i], "n_valid": valid, "n_rows": self.windows,
        }  # fmt: skip
        return row


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
