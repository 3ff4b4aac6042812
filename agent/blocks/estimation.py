"""State detection: samples in, estimates with status, interval and held values out."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from agent.blocks.tuning import MOST_STUCK
from agent.numerics.estimator.faults import Finding
from agent.numerics.estimator.outcome import Outcome
from agent.numerics.inference.verdicts import Belief
from agent.numerics.preprocessing.marks import Marks
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import (
    BoolArray,
    CodeArray,
    EstimateBatch,
    FloatArray,
    IntArray,
    Reason,
    Samples,
    Status,
    WindowConditions,
)

KEPT = 4
"""Fixed by holds: samples before the current ones that rows may still come of; a quintic looks three ahead:
samples before the current ones that rows may still come of: a quintic hold looks three ahead."""


@dataclass(slots=True)
class Recent:
    """The current samples and the last few before them."""

    _index: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _t_ns: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _reason: CodeArray = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    _spoilt: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def append(self, samples: Samples) -> None:
        """Take the current samples."""
        count = len(samples.index)
        fault = samples.fault
        reason = 0 if fault is None else int(fault.reason)
        self._index = np.concatenate([self._index[-KEPT:], samples.index])
        self._t_ns = np.concatenate([self._t_ns[-KEPT:], samples.t_ns])
        self._reason = np.concatenate([self._reason[-KEPT:], np.full(count, reason, dtype=np.uint8)])
        self._spoilt = np.concatenate([self._spoilt[-KEPT:], np.full(count, fault is not None)])

    def stamps(self, index: IntArray) -> IntArray:
        """Return the stamps (N,), ns, of samples."""
        return self._t_ns[np.searchsorted(self._index, index)]

    def faults(self, index: IntArray) -> tuple[BoolArray, CodeArray]:
        """Return at which samples (N,) a channel was at fault, and the reason to give for it."""
        at = np.searchsorted(self._index, index)
        return self._spoilt[at], self._reason[at]


ESTIMATION, FAILURE = "estimation", "failure"
"""What a failure of the numerics is called in events, and the reason of samples that it loses."""


class Method(Protocol):
    """A method of estimation: consecutive samples in, rows out."""

    def start_segment(self) -> None:
        """Forget the samples before a gap."""

    def knowledge(self) -> str | None:
        """Return what was learnt, as JSON text; None while that is nothing to rely on."""

    def adopt(self, content: str) -> None:
        """Begin with what an earlier run learnt."""

    def hurry(self) -> None:
        """Do nothing but rows from now on: no fit, no search."""

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        """Take samples y (N, p), u (N, m), the first of them number `index`; return the rows that they end.

        missing (N, p+m): readings that were filled in. suspect (N, p+m): inputs that may be spikes.
        """

    @property
    def spikes(self) -> int:
        """Samples so far of which nothing but an input was taken for a spike."""


@dataclass(frozen=True, slots=True)
class Labels:
    """What every row of a rig's estimates carries.

    Attributes:
        rig, method, parameters, units, reference, baseline_id: see `EstimateBatch`.
        window: samples of the shortest window; longest: of the longest; hop: between rows.
        rate_hz: samples a second.
        frictions: how many of the last inputs are shares of a dry friction, -1 or 1 while it slides.
        least: (q,) what is reported of a parameter does not go below; its estimate does, lest noise bias it.
        reference_sd: see `EstimateBatch`.
        enough: (q,) sd from which on a window tells nothing of a change; a learnt reference asks it of
            sd_repeat.
    """

    rig: str
    method: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    reference: FloatArray
    baseline_id: tuple[int | None, ...] | None
    window: int
    longest: int
    hop: int
    rate_hz: float
    frictions: int
    least: FloatArray
    reference_sd: tuple[float, ...] | None = None
    enough: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Estimated:
    """Result of a step of the estimation: rows, and what the method found beside them.

    Attributes:
        batch: the rows; None where no hop ended.
        newest_ns: time of the newest row, or of the newest sample where no hop ended.
        beliefs, findings, failures, conditions: as `Outcome` has them.
    """

    batch: EstimateBatch | None
    newest_ns: int
    beliefs: tuple[tuple[int, tuple[Belief, ...]], ...] = ()
    findings: tuple[Finding, ...] = ()
    failures: tuple[tuple[int, str], ...] = ()
    conditions: tuple[tuple[int, WindowConditions], ...] = ()

    def times(self, samples: Iterable[int]) -> dict[int, int]:
        """Return when samples were taken, ns, where they end a row; the newest time of the others."""
        known: dict[int, int] = {}
        if self.batch is not None:
            known = dict(zip(self.batch.index.tolist(), self.batch.t_ns.tolist(), strict=True))
        return {sample: known.get(sample, self.newest_ns) for sample in samples}


@dataclass(slots=True)
class Estimation:
    """Runs a method over a rig's samples and says what each of its rows is worth.

    used counts the samples that entered the method whole.
    """

    estimator: Method
    labels: Labels
    used: int = 0
    _segment: int | None = None
    _held: FloatArray = field(default_factory=lambda: np.zeros(0))
    _held_ns: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _first: int = 0
    _lost: Marks = field(default_factory=Marks)
    _sticking: Marks = field(default_factory=Marks)
    _recent: Recent = field(default_factory=Recent)

    def __post_init__(self) -> None:
        q = len(self.labels.parameters)
        self._held = np.full(q, np.nan)
        self._held_ns = np.zeros(q, dtype=np.int64)

    def step(self, samples: Samples) -> Estimated:
        """Take samples of one segment; return the estimates that they end, and what was found meanwhile."""
        self._recent.append(samples)
        if not samples.usable:
            return self._unusable(samples)
        self._enter(samples)
        first = int(samples.index[0])
        rows = self.estimator.step(first, samples.y, samples.u, samples.missing, samples.suspect)
        batch = self._rows(rows, samples) if len(rows.index) else None
        newest = samples.t_ns if batch is None else batch.t_ns
        return Estimated(batch, int(newest[-1]), rows.beliefs, rows.findings, rows.failures, rows.conditions)

    def _rows(self, rows: Outcome, samples: Samples) -> EstimateBatch:
        batch = self._batch(rows, samples)
        oldest = int(rows.index[-1]) - self.labels.longest
        self._lost.trim(oldest)
        self._sticking.trim(oldest)
        return batch

    def _enter(self, samples: Samples) -> None:
        """Count the samples and note what is lost and what sticks."""
        first = int(samples.index[0])
        if self._segment != samples.segment:
            if self._segment is not None:
                self.estimator.start_segment()
            self._segment, self._first = samples.segment, first
            self._lost.forget()
            self._sticking.forget()
        self.used += len(samples.index)
        if samples.missing is not None:
            lost = np.asarray(samples.missing.any(axis=1))
            self.used -= int(lost.sum())
            self._lost.append(first, lost)
        if self.labels.frictions:
            share = np.abs(samples.u[:, -self.labels.frictions :])
            self._sticking.append(first, np.asarray((share < 1.0).any(axis=1)))

    def _unusable(self, samples: Samples) -> Estimated:
        """Return rows without estimates for samples that nothing can be made of."""
        plan = HopPlan(self.labels.window, self.labels.hop)
        first = int(samples.index[0])
        due = plan.rows_between(first, first + len(samples.index))
        rows = Outcome.warming(due, len(self.labels.parameters))
        if not len(rows.index):
            return Estimated(None, int(samples.t_ns[-1]))
        batch = self._batch(rows, samples)
        return Estimated(batch, int(batch.t_ns[-1]))

    def _batch(self, rows: Outcome, samples: Samples) -> EstimateBatch:
        labels = self.labels
        t_ns = self._recent.stamps(rows.index)
        full = rows.window.max(axis=1) > 0
        window = np.where(full, rows.window.max(axis=1), labels.window)
        lost = self._lost.count(rows.index, window)
        status, reason = rows.status.copy(), rows.reason.copy()
        self._mark(rows, status, reason, window)
        held, age = self._hold(rows.theta, status, t_ns)
        least = labels.least
        begun = (
            np.minimum(rows.index - self._first + 1, labels.window)
            if samples.usable
            else np.zeros_like(window)
        )
        used = np.where(full, window, begun)
        return EstimateBatch(
            rig=labels.rig, method=labels.method, parameters=labels.parameters, units=labels.units,
            reference=labels.reference, baseline_id=labels.baseline_id, index=rows.index, t_ns=t_ns,
            # the truth is not beyond the bound, so a cut interval covers it as often as the whole one
            value=np.maximum(rows.theta, least), sd=rows.sd, lower=np.maximum(rows.lower, least),
            upper=np.maximum(rows.upper, least), sd_repeat=rows.sd_repeat, status=status, reason=reason,
            held=np.maximum(held, least), held_age_s=age,
            window_s=np.where(rows.window > 0, rows.window, labels.window) / labels.rate_hz,
            n_used=np.maximum(used.astype(np.int64) - lost, 0), n_missing=lost, dof=rows.dof,
            others=tuple(self._other(rows, other, samples, t_ns, lost) for other in rows.others),
            reference_sd=labels.reference_sd,
        )  # fmt: skip

    def _other(
        self, rows: Outcome, other: Outcome, samples: Samples, t_ns: IntArray, lost: IntArray
    ) -> EstimateBatch:
        """Return what one of several windows says where it is not the one chosen."""
        alone = replace(self, _held=self._held.copy(), _held_ns=self._held_ns.copy())
        batch = alone._batch(other, samples)  # noqa: SLF001 - of a copy of this block
        chosen = rows.window == other.window
        nothing = np.full_like(batch.value, np.nan)
        shown = np.where(chosen, np.nan, 1.0)
        return replace(
            batch, value=batch.value * shown, sd=batch.sd * shown, lower=batch.lower * shown,
            upper=batch.upper * shown, sd_repeat=batch.sd_repeat * shown, held=nothing, held_age_s=nothing,
        )  # fmt: skip

    def _mark(self, rows: Outcome, status: CodeArray, reason: CodeArray, window: IntArray) -> None:
        """Mark rows that resolve a change from a learnt reference, that stick, and of a faulty channel."""
        if self.labels.reference_sd is not None and self.labels.enough is not None:
            known = np.isfinite(self.labels.reference_sd) & (rows.sd_repeat <= self.labels.enough)
            vague = (status == Status.UNEXCITED) & (reason == Reason.NONE)
            status[known & vague] = Status.VALID
        if self.labels.frictions:
            stuck = self._sticking.count(rows.index, window) > MOST_STUCK * window
            held_fast = stuck[:, None] & (status == Status.VALID)
            status[held_fast], reason[held_fast] = Status.UNEXCITED, Reason.STANDSTILL
        spoilt, why = self._recent.faults(rows.index)
        status[spoilt], reason[spoilt] = Status.INVALID, why[spoilt, None]

    def _hold(self, value: FloatArray, status: CodeArray, t_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the newest valid value before each row that is not valid, and its age in seconds."""
        valid = status == Status.VALID
        values = np.vstack([self._held, value])
        times = np.vstack([self._held_ns, np.broadcast_to(t_ns[:, None], value.shape)])
        usable = np.vstack([np.ones((1, value.shape[1]), dtype=bool), valid])
        places = np.where(usable, np.arange(len(values))[:, None], 0)
        newest = np.maximum.accumulate(places, axis=0)
        held = np.take_along_axis(values, newest, axis=0)
        since = np.take_along_axis(times, newest, axis=0)
        self._held, self._held_ns = held[-1], since[-1]
        age = (t_ns[:, None] - since[1:]) / 1e9
        wanted = ~valid & np.isfinite(held[1:])
        return np.where(wanted, held[1:], np.nan), np.where(wanted, age, np.nan)
