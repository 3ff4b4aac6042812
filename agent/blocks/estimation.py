"""State detection: samples in, estimates with status, interval and held values out."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from agent.blocks import calibration_events as calibration_words
from agent.blocks.advice import ModelAdvice
from agent.numerics.estimator.lacking import MOST, Lacking
from agent.numerics.faults.suspects import Accusation
from agent.numerics.fitting.work import Budget
from agent.numerics.window.hops import HopPlan
from agent.numerics.window.rows import Rows
from agent.types import (
    Calibrated,
    CalibrationRecord,
    CodeArray,
    EstimateBatch,
    FloatArray,
    HealthEvent,
    IntArray,
    Reason,
    Samples,
    SensorEvent,
    SensorFault,
    Status,
)

BoolArray = NDArray[np.bool_]
ESTIMATION, FAILURE = "estimation", "failure"
"""What a failure of the numerics is called in events, and the reason of samples that it loses."""
MOST_STUCK = 0.05
"""Share of a window in which dry friction may hold the motion: what holds it then is known no better than the model."""


class Estimator(Protocol):
    """A method: consecutive samples in, rows out.

    budget: of all that is done beside the rows.
    """

    budget: Budget

    def start_segment(self) -> None:
        """Forget the samples before a gap."""
        ...

    def calibrated(self) -> Calibrated | None:
        """Return what is known of the rig's disturbances; None while that is nothing to rely on."""
        ...

    def adopt(self, known: Calibrated) -> None:
        """Begin with what an earlier run knew."""
        ...

    def hurry(self) -> None:
        """Do nothing but rows from now on: no fit, no search."""
        ...

    def take_findings(self) -> list[tuple[int, Accusation]]:
        """Return (sample of a row, what the model was found to lack there) since the last call."""
        ...

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Rows:  # fmt: skip
        """Take samples y (N, p), u (N, m), the first of them number `index`; return the rows that they end.

        missing (N, p+m): readings that were filled in. suspect (N, p+m): inputs that may be spikes.
        """
        ...

    @property
    def spikes(self) -> int:
        """Samples so far of which nothing but an input was taken for a spike."""
        ...


@dataclass(frozen=True, slots=True)
class Labels:
    """What every row of a rig's estimates carries.

    windows: where there are several, their lengths in samples.
    longest: samples of the longest window that a row may be of; 0 for no longer one than `window`.
    frictions: how many of the last inputs are shares of a dry friction, -1 or 1 while it slides.
    pushed: name and unit of what each unknown force acts on.
    least (q,): what is reported of a parameter does not go below; its estimate does, so that noise does not bias it.
    """

    rig: str
    method: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    reference: FloatArray
    baseline_id: int | None
    window_s: float
    window: int
    rate_hz: float
    enough_sd: FloatArray
    hop: int = 1
    channels: tuple[str, ...] = ()
    channel_units: tuple[str, ...] = ()
    pushed: tuple[tuple[str, str], ...] = ()
    least: FloatArray | None = None
    windows: tuple[int, ...] = ()
    longest: int = 0
    frictions: int = 0


def half_width(sd: FloatArray, dof: FloatArray) -> FloatArray:
    """Return half the 95 % interval by Student's t; sd (N, q), dof (N,)."""
    with np.errstate(invalid="ignore"):
        different, which = np.unique(dof, return_inverse=True)
        return np.asarray(stdtrit(different, 0.975)[which, None] * sd)


@dataclass(slots=True)
class Estimation:
    """Runs a method over a rig's samples and says what each of its rows is worth.

    failures gives (sample, what was raised) of each numerical failure of the method since its last call.
    used counts the samples that entered the method whole.
    """

    estimator: Estimator
    labels: Labels
    failures: Callable[[], list[tuple[int, str]]] = list
    used: int = 0
    _segment: int | None = None
    _held: FloatArray = field(default_factory=lambda: np.zeros(0))
    _held_ns: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _first: int = 0
    _blamed: SensorFault | None = None
    _blamed_at: int = 0
    _said: SensorFault | None = None
    _events: list[SensorEvent] = field(default_factory=list)
    _advice: list[HealthEvent] = field(default_factory=list)
    _known: Calibrated | None = None
    _learnt: list[CalibrationRecord] = field(default_factory=list)
    _told: bool = True
    _news: list[HealthEvent] = field(default_factory=list)
    _lacking: Lacking = field(default_factory=lambda: Lacking(0))
    _sticking: Lacking = field(default_factory=lambda: Lacking(0))
    _model: ModelAdvice = field(default_factory=lambda: ModelAdvice("", 1.0))

    def __post_init__(self) -> None:
        q = len(self.labels.parameters)
        self._held, self._held_ns = np.full(q, np.nan), np.zeros(q, dtype=np.int64)
        labels = self.labels
        named = tuple(zip(labels.channels, labels.channel_units, strict=True))
        self._model = ModelAdvice(labels.rig, labels.rate_hz, named)

    def step(self, samples: Samples) -> EstimateBatch | None:
        """Take samples of one segment; return the estimates that they end, None when there are none."""
        if not samples.usable:
            return self._unusable(samples)
        if self._segment != samples.segment:
            if self._segment is not None:
                self.estimator.start_segment()
            self._segment, self._first = samples.segment, int(samples.index[0])
            self._lacking.forget()
            self._sticking.forget()
        self.used += len(samples.index)
        if samples.missing is not None:
            self.used -= int(samples.missing.any(axis=1).sum())
            self._lacking.append(int(samples.index[0]), samples.missing)
        if self.labels.frictions:
            share = np.abs(samples.u[:, -self.labels.frictions :])
            self._sticking.append(int(samples.index[0]), share < 1.0)
        doubtful = () if samples.missing is None and samples.suspect is None else (samples.missing, samples.suspect)
        rows = self.estimator.step(int(samples.index[0]), samples.y, samples.u, *doubtful)
        if not len(rows.index):
            return None
        batch = self._batch(rows, samples)
        oldest = int(rows.index[-1]) - max(self.labels.window, self.labels.longest)
        self._lacking.trim(oldest)
        self._sticking.trim(oldest)
        self._advice += self._model.step(self.estimator.take_findings(), batch)
        self._note_calibration(int(batch.t_ns[-1]))
        self._note_failures(samples)
        return batch

    def _unusable(self, samples: Samples) -> EstimateBatch | None:
        """Return rows without estimates for samples that nothing can be made of."""
        plan = HopPlan(self.labels.window, self.labels.hop)
        first = int(samples.index[0])
        due, windows = plan.rows_between(first, first + len(samples.index)), self.labels.windows
        rows = Rows.warming(due, len(self.labels.parameters), len(windows) if len(windows) > 1 else 0)
        return self._batch(rows, samples) if len(rows.index) else None

    def _batch(self, rows: Rows, samples: Samples) -> EstimateBatch:
        t_ns = samples.t_ns[rows.index - samples.index[0]]
        known = np.isfinite(rows.theta) & np.isfinite(rows.sd)
        value, sd = np.where(known, rows.theta, np.nan), np.where(known, rows.sd, np.nan)
        longest = np.maximum(rows.window.max(axis=1), self.labels.window)
        missing = self._lacking.count(rows.index, longest)
        status, reason = self._verdicts(rows, known)
        if self.labels.frictions:
            stuck = self._sticking.count(rows.index, longest) > MOST_STUCK * longest
            held_fast = stuck[:, None] & (status == Status.VALID)
            status[held_fast], reason[held_fast] = Status.UNEXCITED, Reason.STANDSTILL
        self._mark(status, reason, samples, rows.full & (missing > MOST * longest))
        self._note_blame(rows, status, t_ns)
        held, age = self._hold(value, status, t_ns)
        labels, half = self.labels, half_width(sd, rows.dof)
        # the truth is not beyond the bound, so a cut interval covers it as often as the whole one
        least = -np.inf if labels.least is None else labels.least
        lower, upper = np.maximum(value - half, least), np.maximum(value + half, least)
        value, held = np.maximum(value, least), np.maximum(held, least)
        begun = np.minimum(rows.index - self._first + 1, labels.window) if samples.usable else np.zeros_like(longest)
        used = np.where(rows.full, longest, begun)
        window_s = np.where(rows.window > 0, rows.window / labels.rate_hz, labels.window_s)
        batch = EstimateBatch(
            rig=labels.rig, method=labels.method, parameters=labels.parameters, units=labels.units,
            reference=labels.reference, baseline_id=labels.baseline_id, index=rows.index, t_ns=t_ns,
            value=value, sd=sd, lower=lower, upper=upper, status=status, reason=reason,
            held=held, held_age_s=age, window_s=window_s,
            n_used=np.maximum(used.astype(np.int64) - missing, 0), n_missing=missing, dof=rows.dof,
        )  # fmt: skip
        return replace(batch, others=tuple(self._other(batch, rows, n) for n in range(rows.each_dof.shape[1])))

    def _other(self, batch: EstimateBatch, rows: Rows, number: int) -> EstimateBatch:
        """Return what one of several windows says where it is not the one chosen."""
        labels, window = self.labels, self.labels.windows[number]
        sd, dof, least = rows.each_sd[:, number], rows.each_dof[:, number], labels.least
        told = np.isfinite(sd) & (rows.window != window)
        value, sd = np.where(told, rows.each_theta[:, number], np.nan), np.where(told, sd, np.nan)
        half, bound = half_width(sd, dof), -np.inf if least is None else least
        status = np.where(sd > labels.enough_sd, int(Status.UNEXCITED), int(Status.VALID)).astype(np.uint8)
        reason = np.zeros_like(batch.reason)
        wrong = ~rows.each_fits[:, number]
        status[wrong], reason[wrong] = Status.INVALID, Reason.CHANGING
        known = batch.status == Status.INVALID
        status, reason = np.where(known, batch.status, status), np.where(known, batch.reason, reason)
        missing, none = self._lacking.count(rows.index, np.full(len(rows.index), window)), np.full_like(value, np.nan)
        return replace(
            batch, value=np.maximum(value, bound), sd=sd, lower=np.maximum(value - half, bound),
            upper=np.maximum(value + half, bound), status=status, reason=reason, held=none, held_age_s=none,
            window_s=np.full_like(value, window / labels.rate_hz), n_used=window - missing, n_missing=missing, dof=dof,
        )  # fmt: skip

    def take_events(self) -> list[SensorEvent]:
        """Return which sensors were blamed or acquitted since the last call."""
        events, self._events = self._events, []
        return events

    def adopt(self, known: Calibrated) -> None:
        """Begin with what an earlier run knew of the rig's disturbances."""
        self.estimator.adopt(known)
        self._known, self._told = known, False

    def take_calibration(self) -> list[CalibrationRecord]:
        """Return what was learnt of the rig's disturbances since the last call, the newest."""
        learnt, self._learnt = self._learnt, []
        return learnt

    def _note_calibration(self, t_ns: int) -> None:
        known, labels = self.estimator.calibrated(), self.labels
        named = (tuple(zip(labels.channels, labels.channel_units, strict=True)), labels.pushed)
        if not self._told and self._known is not None:
            self._told = True
            self._news.append(calibration_words.adopted(labels.rig, t_ns, self._known, *named))
        if known is not None and known != self._known:
            news = calibration_words.learnt(labels.rig, t_ns, self._known, known, *named)
            self._news += [] if news is None else [news]
            self._known = known
            self._learnt = [CalibrationRecord(self.labels.rig, t_ns, known)]

    def _note_failures(self, samples: Samples) -> None:
        for index, words in self.failures():
            message = f"the estimation failed and starts anew: {words}"
            t_ns = int(samples.t_ns[np.clip(index - int(samples.index[0]), 0, len(samples.t_ns) - 1)])
            self._news.append(HealthEvent(self.labels.rig, ESTIMATION, t_ns, FAILURE, message))

    def take_news(self) -> list[HealthEvent]:
        """Return failures, and which levels of the disturbances were taken over, found or replaced."""
        news, self._news = self._news, []
        return news

    def take_advice(self) -> list[HealthEvent]:
        """Return what the model was found to lack since the last call."""
        advice, self._advice = self._advice, []
        return advice

    def _note_blame(self, rows: Rows, status: CodeArray, t_ns: IntArray) -> None:
        """Say once which sensor changed, at once where that is sure, after a window where it may be the structure."""
        blamed = (rows.channel >= 0) & ~rows.changing
        valid = (status == Status.VALID).any(axis=1)
        if not blamed.any() and self._blamed is None and self._said is None:
            return
        for row in np.flatnonzero(blamed | valid).tolist():
            index = int(rows.index[row])
            if valid[row] and not blamed[row]:
                if self._said is not None:
                    self._events.append(SensorEvent(self._said, False, index, int(t_ns[row])))
                self._blamed = self._said = None
                continue
            fault = SensorFault(self.labels.channels[int(rows.channel[row])], Reason(int(rows.suspect[row])))
            if self._blamed is None:
                self._blamed_at = index
            self._blamed = fault
            sure = fault.reason in (Reason.SENSOR, Reason.STUCK) or index - self._blamed_at >= self.labels.window
            if sure and self._said is None:
                self._said = fault
                self._events.append(SensorEvent(fault, True, index, int(t_ns[row])))

    def _mark(self, status: CodeArray, reason: CodeArray, samples: Samples, hollow: BoolArray) -> None:
        """Mark rows whose windows hold readings of a faulty channel, or lack too many, where hollow (N,)."""
        status[hollow], reason[hollow] = Status.INVALID, Reason.GAP
        if samples.fault is not None:
            status[:], reason[:] = Status.INVALID, samples.fault.reason

    def _verdicts(self, rows: Rows, known: NDArray[np.bool_]) -> tuple[CodeArray, CodeArray]:
        status = np.full(rows.theta.shape, int(Status.VALID), dtype=np.uint8)
        reason = np.zeros(rows.theta.shape, dtype=np.uint8)
        with np.errstate(invalid="ignore"):
            status[~known | (rows.sd > self.labels.enough_sd)] = Status.UNEXCITED
        accused = rows.full & (rows.suspect > 0) & ~rows.changing
        disturbed = rows.changing | rows.mismatch | accused
        status[disturbed] = Status.INVALID
        reason[rows.changing] = Reason.CHANGING
        reason[rows.mismatch] = Reason.MISMATCH
        reason[accused] = rows.suspect[accused, None]
        reason[rows.still[:, None] & (status == Status.UNEXCITED)] = Reason.STANDSTILL
        status[~rows.full] = Status.WARMING
        status[rows.diverged], reason[rows.diverged] = Status.INVALID, Reason.DIVERGED
        return status, reason

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
