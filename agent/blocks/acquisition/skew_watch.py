"""How much later one source of a rig is read than another: measured while the rig runs, and followed."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from agent.blocks import tuning
from agent.blocks.acquisition.interface import SourceEvent
from agent.numerics.estimator.schedule import Budget
from agent.numerics.fitting.fit import WORK
from agent.numerics.fitting.skew import Delays, Skew, SkewMeter, combined
from agent.numerics.fitting.tuning import EVALUATION
from agent.types import FloatArray, IntArray

Reader = Callable[[IntArray, FloatArray], FloatArray]
"""Rows (n,) and a delay of each channel (c,) -> readings (n, c), inputs first; NaN where one is missing."""


@dataclass(frozen=True, slots=True)
class SkewGroup:
    """A source whose skew is measured, and its channels (numbers among the rig's, inputs first)."""

    source: str
    channels: tuple[int, ...]


@dataclass(slots=True)
class SkewWatch:
    """The skews of a rig's sources against the reference source.

    Attributes:
        meter: measures them on a stretch.
        groups: of what.
        against: the reference source's name.
        channels, inputs: number of the rig's channels, and of those that are inputs.
        stretch, longest: samples of a stretch, at first and at most.
        rate_hz: of rows.
        complete: outputs and inputs -> all of the model's inputs.
        skew_s, sd_s: (g,) what is compensated now and how well it is known; sd inf while it is not.
        holding: rows are to wait.
        since: rows before this one are not to be measured.
        needed: numbers say nothing of which samples go together, so rows are no good before the skew is
            known.
        unknown: the skew has not been found yet.
    """

    meter: SkewMeter
    groups: tuple[SkewGroup, ...]
    against: str
    channels: int
    inputs: int
    stretch: int
    longest: int
    rate_hz: float
    complete: Callable[[FloatArray, FloatArray], FloatArray]
    skew_s: FloatArray = field(init=False)
    sd_s: FloatArray = field(init=False)
    holding: bool = True
    since: int = 0
    needed: bool = False
    unknown: bool = True
    budget: Budget | None = None
    _patience_s: float = tuning.SKEW_PATIENCE_S
    _found: deque[Delays] = field(default_factory=lambda: deque(maxlen=tuning.REMEMBERED))
    _theta: FloatArray = field(init=False)
    _measured: FloatArray = field(init=False)
    _first: int | None = None
    _next: int = 0
    _tried: int = 0
    _events: list[SourceEvent] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.skew_s = np.zeros(len(self.groups))
        self.sd_s = np.full(len(self.groups), np.inf)
        self.budget = self.budget or Budget(tuning.EVALUATIONS * (EVALUATION + self.stretch), tuning.RATE)
        self._theta = self.meter.rig.model.nominal
        self._measured = np.zeros(len(self.groups))

    @property
    def margin(self) -> int:
        """Samples before and after a stretch that must be there as well."""
        return round(tuning.MOST_S * self.rate_hz) + 4

    @property
    def history(self) -> int:
        """Samples that must be kept behind the newest row."""
        return self.longest + 2 * self.margin + 8

    @property
    def realigning(self) -> bool:
        """Whether rows that no longer wait are read with a skew that is not known."""
        return self.needed and self.unknown and not self.holding

    def anew(self, since: int, *, needed: bool) -> "SkewWatch":
        """Return a watch that measures from row `since` on, and expects what this one found."""
        watch = SkewWatch(
            self.meter, self.groups, self.against, self.channels, self.inputs, self.stretch, self.longest,
            self.rate_hz, self.complete, since=since, needed=needed, budget=self.budget,
            _patience_s=tuning.SKEW_PATIENCE_ANEW_S,
        )  # fmt: skip
        watch.skew_s, watch._theta = self.skew_s, self._theta
        if not needed:
            watch.sd_s, watch._measured = self.sd_s, self._measured
        return watch

    def delays(self) -> FloatArray:
        """Return the skew of each channel (c,), s."""
        return self._spread(self.skew_s)

    def known(self) -> dict[str, tuple[float | None, float | None]]:
        """Return the skew measured of each source and its sd, s; None while it is not known."""
        found: dict[str, tuple[float | None, float | None]] = {}
        for group, skew, sd in zip(self.groups, self._measured.tolist(), self.sd_s.tolist(), strict=True):
            found[group.source] = (skew, sd) if np.isfinite(sd) else (None, None)
        return found

    def look(self, first: int, ready: int, newest: int, read: Reader) -> list[SourceEvent]:
        """Measure the stretches that are complete; return what was found.

        Args:
            first: the first row of which every source has a reading at hand.
            ready: rows up to this one can be read with any skew.
            newest: the reference's newest sample.
            read: reads rows.
        """
        first = max(first, self.since)
        if self._first is None:
            self._first = first
            self._next = first + self.margin
        self._next = max(self._next, first + self.margin)
        while ready >= self._next + self.stretch:
            rows = np.arange(self._next, self._next + self.stretch, dtype=np.int64)
            wanting = self.holding or self.realigning
            self._next += self.stretch if wanting else round(tuning.SKEW_EVERY_S * self.rate_hz)
            self._measure(rows, read)
            self._decide()
        if self.holding and newest > self._first + self._patience_s * self.rate_hz:
            self._let_go()
        return self._news()

    def let_go(self) -> list[SourceEvent]:
        """Hold rows no longer, whatever is known; return what is."""
        self._let_go()
        return self._news()

    def _let_go(self) -> None:
        if self.holding:
            self.holding = False
            self._adopt()

    def _news(self) -> list[SourceEvent]:
        events, self._events = self._events, []
        return events

    def end(self) -> None:
        """Measure no more: what is not known of these rows will not be."""
        self.holding = False

    def _measure(self, rows: IntArray, read: Reader) -> None:
        self._tried += 1
        if not np.all(np.isfinite(read(rows, self.delays()))):
            return

        def resampled(skew: FloatArray) -> FloatArray:
            readings = read(rows, self._spread(np.clip(skew, -tuning.MOST_S, tuning.MOST_S)))
            u, y = readings[:, : self.inputs], readings[:, self.inputs :]
            return np.hstack([y, self.complete(y, u)])

        elsewhere = [np.full(len(self.groups), start) for start in tuning.STARTS_S]
        starts = [self._found[-1].delay_s] if self._found else [self.skew_s, *elsewhere]
        tried = [self._try(resampled, start, int(rows[-1])) for start in starts]
        sure = [found for found in tried if found is not None]
        if sure:
            best = min(sure, key=lambda found: found.misfit)
            self._found.append(best)
            self._theta = best.theta

    def _try(
        self, resampled: Callable[[FloatArray], FloatArray], start_s: FloatArray, index: int
    ) -> Delays | None:
        """Measure a stretch that ends with sample `index` from one start; None where it tells nothing."""
        if self.budget is None or not self.budget.allows(index):
            return None
        done = WORK.done
        try:
            found = self.meter.measure(resampled, start_s, self._theta)
        except (ValueError, np.linalg.LinAlgError):
            return None  # no gain, or readings that are no motion at all
        finally:
            self.budget.spend(WORK.done - done)
        return found if found.sure and bool(np.all(np.abs(found.delay_s) < tuning.MOST_S)) else None

    def _spread(self, skew: FloatArray) -> FloatArray:
        delays = np.zeros(self.channels)
        for group, delay in zip(self.groups, skew.tolist(), strict=True):
            delays[list(group.channels)] = delay
        return delays

    def _decide(self) -> None:
        """Let rows go when enough is known; afterwards follow what changes."""
        known = self._together()
        if (
            known is not None
            and known.stretches >= tuning.ENOUGH
            and np.all(known.sd_s * self.rate_hz < tuning.PRECISE)
        ):
            self.unknown = False
        if not self.holding:
            self._adopt()
        elif not self.unknown:
            self._let_go()
        if self._tried % tuning.LONGER_AFTER == 0:
            self.stretch = min(2 * self.stretch, self.longest)

    def _together(self) -> Skew | None:
        return combined(self._found, tuning.FLOOR / self.rate_hz)

    def _adopt(self) -> None:
        """Compensate by what is known where that differs surely from what is compensated."""
        known = self._together()
        if known is None:
            if np.all(np.isinf(self.sd_s)) and not self._events:
                self._say_unknown()
            return
        first = np.isinf(self.sd_s)
        off = np.abs(known.delay_s - self.skew_s)
        moved = (off > 3 * known.sd_s) & (off * self.rate_hz > tuning.SMALL)
        self.skew_s = np.where(moved, known.delay_s, self.skew_s)
        self.sd_s, self._measured = known.sd_s, known.delay_s
        self._say(np.flatnonzero(moved | first), known)

    def _say(self, which: Sequence[int] | IntArray, known: Skew) -> None:
        for number in which:
            delay, sd = 1e3 * float(known.delay_s[number]), 1e3 * float(known.sd_s[number])
            source = self.groups[number].source
            words = (
                f"{source}: read {abs(delay):.3f} ± {sd:.3f} ms {'later' if delay > 0 else 'earlier'} than "
            )
            words += self.against + ("; compensated" if self.skew_s[number] else "; nothing to compensate")
            self._events.append(SourceEvent(source, "skew", words))

    def _say_unknown(self) -> None:
        for group in self.groups:
            words = f"{group.source}: how much later it is read than {self.against} does not show; "
            words += "its rows are no estimates until it does" if self.needed else "taken as nothing"
            self._events.append(SourceEvent(group.source, "skew", words))
