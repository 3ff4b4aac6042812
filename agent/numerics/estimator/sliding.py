"""The product's estimator: samples in, one row of estimates a hop.

    hop -> row          from the streaming bank, at the operating point
    window -> learn     noise, constants and the point itself, on disjoint windows, ever more seldom
    broken row -> solve about the window itself: the parameters changed, or the noise did, or the model does not hold
    budget              what all of this may cost beside the rows

The bank (`agent.numerics.window`) and the learner (`agent.numerics.inference`) are two forms of one likelihood.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.budget import Budget
from agent.numerics.estimator.doubts import Doubts, Found
from agent.numerics.estimator.faults import WHOLE, Faults, Finding
from agent.numerics.estimator.look_ahead import LookAhead, Ready
from agent.numerics.estimator.memory import LEAST_WINDOWS, from_text, to_text
from agent.numerics.estimator.operating_point import OperatingPoint, operating_point, taps_of
from agent.numerics.estimator.outcome import Outcome
from agent.numerics.estimator.reading import FAR_SD, FARTHEST_SD, Reading, read
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.inference import tuning
from agent.numerics.inference.columns import Window, refilled
from agent.numerics.inference.learner import Knowledge, Learner, Posterior
from agent.numerics.inference.verdicts import Belief, beliefs
from agent.numerics.model.riccati import NoSteadyStateError
from agent.numerics.window.lost import Lost
from agent.numerics.window.rows import BankRows
from agent.numerics.window.stream import Stream
from agent.types import Reason

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
UNITS_LEAST = 32
UNITS_MOST = 1024
"""Hops that the bank is given at once: few after the operating point moved, which throws the rest of them away."""
EAGER = 32
"""Windows learnt from one after another before learning becomes seldom."""
SELDOM = 32
"""Windows between two that are learnt from, at the most."""
RETRY = 4
"""Tries a window length to find a first window that fits."""
TRIES = 8
"""Tries a window length to solve windows that are broken."""
DULLED = 1.05
"""Growth of the sharpest sd seen each time that the operating point moves: it follows what the machine does."""
AGAIN = 3
"""Windows within which parameters that change twice are rather pushed by forces that nobody measures."""
LASTS = 1.5
"""Windows that one change is in the way at the most; what lasts longer may be forces that began."""
MOST_LOST = 0.1
"""Share of a window's samples that may have lost readings; beyond it a window says too little for what it costs."""
REFILLS = 2
"""Times that suspect inputs are put where the motion asks for them before a window is solved."""
MOVED_SD = 0.2
"""Difference between learner and bank, in sds, from which on the bank takes the learner's point."""
MOVED_LOG_SD = 0.1
"""The same for the logarithm of a sd."""


@dataclass(slots=True)
class Schedule:
    """When to learn: from every window at first, then ever more seldom."""

    window: int
    learnt: int = 0
    due: int = 0
    tried: int = 0

    def done(self, index: int) -> None:
        """Note that the window ending at sample `index` was learnt from."""
        self.learnt, self.tried = self.learnt + 1, index
        doublings = max(0, self.learnt - EAGER) // 8
        self.due = index + self.window * min(2**doublings, SELDOM)

    def later(self, index: int) -> None:
        """Try again a quarter of a window on."""
        self.tried = index
        self.due = index + max(1, self.window // 4)

    def follow(self, index: int) -> None:
        """Learn soon: something changed."""
        self.learnt = min(self.learnt, EAGER)
        self.due = index + self.window


@dataclass(slots=True)
class Disturbance:
    """A stretch of broken rows: since which sample, and when it was last tried to explain; None outside of one."""

    onset: int | None = None
    tried: int = -(1 << 60)
    ended: int = -(1 << 60)
    changed: int = -(1 << 60)

    def at(self, index: int) -> None:
        """Note a broken row."""
        if self.onset is None:
            self.onset = index

    def is_more_than_a_change(self, index: int, window: int) -> bool:
        """Note that other parameters fit; return whether it took longer than one change, or came too soon after one."""
        before, self.changed = self.changed, index
        return index - before < AGAIN * window or index - (self.onset or index) > LASTS * window

    def over(self, index: int) -> None:
        """Note a row that holds."""
        if self.onset is not None:
            self.onset, self.ended = None, index


class SlidingEstimator:
    """Sliding-window maximum a-posteriori estimation over a stream; the same however the stream is cut."""

    def __init__(self, settings: EstimatorSettings, budget: Budget | None = None) -> None:
        self.settings = settings
        self.learner = Learner(settings.rig, settings.plan.window, settings.outputs, settings.floor)
        self.known: Knowledge | None = None
        self.posterior: Posterior | None = None
        self.budget = budget or Budget(settings.plan.window)
        self.schedule = Schedule(settings.plan.window)
        self.disturbance = Disturbance()
        self.faults = Faults(self.learner, settings.floor)
        self.point: OperatingPoint | None = None
        self.solved = 0
        self._stream: Stream | None = None
        self._record: Record | None = None
        self._ahead = LookAhead(settings.rig)
        self._doubts = Doubts()
        self._units = UNITS_LEAST
        self._fed = 0
        self._lost_fed = 0
        self._jump = 0.0
        self._spikes = 0
        self._adopted = False
        self._centred_at = -(1 << 60)
        self._sharpest = np.full(settings.rig.q, np.inf)
        self._lines: dict[int, Posterior] = {}
        self._moves = False
        self._beliefs: list[tuple[int, tuple[Belief, ...]]] = []

    @property
    def spikes(self) -> int:
        """Samples so far of which nothing but an input was taken for a spike."""
        return self._spikes

    def knowledge(self) -> str | None:
        """Return what was learnt, as JSON text; None before enough windows have been learnt from."""
        if self.known is None or self.known.noise.windows < LEAST_WINDOWS:
            return None
        return to_text(self.known)

    def adopt(self, content: str) -> None:
        """Begin with what an earlier run learnt, where it is of the same rig and window."""
        fresh = self.learner.prior(np.ones(self.settings.outputs), np.ones(self.settings.outputs))
        self.known = from_text(content, self.learner.hypotheses, fresh.noise)
        self._adopted = self.known is not None

    def hurry(self) -> None:
        """Do nothing but rows from now on: no fit, no search."""
        self.budget.close()

    def take_beliefs(self) -> list[tuple[int, tuple[Belief, ...]]]:
        """Return (sample, beliefs about the rig's constants) of the windows learnt from since the last call."""
        beliefs, self._beliefs = self._beliefs, []
        return beliefs

    def take_findings(self) -> list[Finding]:
        """Return which faults of channels began or ended since the last call."""
        return self.faults.take()

    def start_segment(self) -> None:
        """Forget the samples before a gap; what was learnt stays."""
        self._record = None
        self._stream = None
        self._ahead.forget()
        self._doubts.forget()
        self.disturbance = Disturbance()
        self._lines, self._moves = {}, False
        if self.known is not None:
            self.known = replace(self.known, scatter=self.known.scatter.interrupted())

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        """Take consecutive samples y (N, p), u (N, m), the first of them number `index`; return the rows they end.

        missing (N, p+m): readings (outputs, then inputs) that were filled in. suspect (N, p+m): inputs that may be
        spikes: they count as lost, and the motion says which of them were.
        """
        u = self._doubts.replaced(index, u, suspect, y.shape[1])
        ready = self._ahead.step(index, y, u, missing, suspect)
        return self._rows(ready) if len(ready.y) else Outcome.joined([], self.settings.rig.q)

    def _rows(self, ready: Ready) -> Outcome:
        """Take complete samples; return the rows they end."""
        index, y, u = ready.index, ready.y, ready.u
        missing = _lost(ready.missing, ready.suspect, u.shape[1] + y.shape[1])
        plan, q = self.settings.plan, self.settings.rig.q
        if self._record is None:
            self._record = Record(index, y.shape[1], u.shape[1], self._doubts)
            self._whole = -(-index // plan.hop) * plan.hop + plan.window - 1
        record = self._record
        record.append(y, u, missing)
        due = plan.rows_between(index, index + len(y))
        pieces = [Outcome.warming(due[due < self._whole], q)]
        while self._stream is None and record.stop > self._whole:
            first, begun = self._whole, self._begin(record)
            if not begun:
                self._whole += -(-plan.window // (RETRY * plan.hop)) * plan.hop
                passed = due[(due >= first) & (due < self._whole)]
                unexplained = Outcome.unexplained(passed, q, self.faults.reason or Reason.MISMATCH)
                newest = np.minimum(passed, record.stop - 1)
                unexplained.lack(self._hollow(record, newest))
                unexplained.stand_still(self._still(record, newest))
                pieces.append(unexplained)
        while self._stream is not None and (rows := self._next(record)) is not None:
            pieces.append(rows)
        record.trim(max(self.settings.windows) + plan.window + plan.hop + 1)
        return Outcome.joined([piece for piece in pieces if len(piece.index)], q)

    # ------------------------------------------------------------------ the bank
    def _begin(self, record: Record) -> bool:
        """Learn from a segment's first whole window, and start the bank there; False where nothing fits it."""
        newest = self._whole
        at = np.array([newest])
        if self._hollow(record, at)[0] or self._still(record, at)[0] or not self.budget.take(newest):
            return False
        window = self._window(record, newest)[0]
        new = self.posterior is None and not self._adopted
        posterior, learnt = self._first(window)
        if not posterior.converged:
            return False
        fresh = self.learner.prior(*self._sigma(window.y))
        if new and self.faults.reads_wrongly(record, window, newest, fresh, learnt, posterior.theta):
            return False
        self.faults.begun(record, newest, learnt.noise)
        self.posterior = posterior
        self._believe(newest, window, learnt)
        self.schedule.done(newest)
        self._place(self.posterior)
        self._start_stream(record, newest)
        return True

    def _first(self, window: Window) -> tuple[Posterior, Knowledge]:
        """Learn from a segment's first window; what an earlier run learnt and does not explain it is learnt anew.

        A sensor that was replaced by a worse one would else have its noise taken for that of single bins.
        """
        fresh = self.learner.prior(*self._sigma(window.y))
        self.known = self.known or fresh
        posterior, learnt = self.learner.learn(window, self.known)
        refuted = self._adopted and (posterior.mismatch or not posterior.converged)
        self._adopted = False
        if refuted:
            self.known = fresh
            posterior, learnt = self.learner.learn(window, fresh)
        return posterior, learnt

    def _believe(self, newest: int, window: Window, learnt: Knowledge) -> None:
        """Take what was learnt from a window."""
        self.known = learnt
        self.faults.learnt(window)
        kinds = tuple(c.kind for c in self.settings.rig.constants)
        if kinds:
            self._beliefs.append((newest, beliefs(learnt.constants, kinds)))

    def _sigma(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sensor sds (p,) to begin with, and the spread of their logarithms."""
        stated = self.settings.sigma
        guess = np.maximum(1e-3 * y.std(axis=0), np.maximum(self.settings.floor, 1e-300))
        known = np.isfinite(stated)
        spread = np.where(known, self.settings.sigma_spread, tuning.SIGMA_SPREAD_UNSTATED)
        return np.where(known, stated, guess), spread

    def _place(self, posterior: Posterior) -> None:
        """Set the operating point to what is known."""
        self._sharpest = np.minimum(DULLED * self._sharpest, posterior.sd_repeat)
        assert self.known is not None  # noqa: S101 - set by whoever calls
        self.point = operating_point(
            self.settings.rig, self.known, posterior, self.learner.sources, self.settings.plan.window, self._sharpest,
        )  # fmt: skip

    def _start_stream(self, record: Record, newest: int) -> None:
        """Run the bank, at the operating point, over the windows that end with sample `newest` and after it."""
        point, plan = self.point, self.settings.plan
        assert point is not None  # noqa: S101 - placed before
        longer = [(samples - plan.head) // plan.hop for samples in self.settings.longer]
        rig = self.settings.rig
        taps = taps_of(rig, self.settings.outputs, point.slopes)
        self._stream = Stream(point.model, point.push, point.noise, plan, longer, rig.q, taps)
        self._run_again(record, newest)

    def _run_again(self, record: Record, newest: int) -> None:
        """Run the bank over the record as it is now; rows from `newest` on are computed again."""
        stream, hop = self._stream, self.settings.plan.hop
        assert stream is not None  # noqa: S101 - only called with a bank
        oldest = -(-record.first // hop) * hop
        first = max(oldest, newest + 1 - max(self.settings.windows))
        stream.start_segment(first, given=newest - 1)
        self._fed = self._lost_fed = first
        self._units = UNITS_LEAST

    def _next(self, record: Record) -> Outcome | None:
        """Feed the bank some hops and return the rows settled; None when no whole row waits."""
        stream, plan = self._stream, self.settings.plan
        assert stream is not None  # noqa: S101 - only called with a bank
        assert self.point is not None  # noqa: S101 - placed before the bank began
        batch = stream.rows()
        if not len(batch.index):
            stop = min(record.stop, self._fed + self._units * plan.hop + plan.window)
            if stop <= self._fed:
                return None
            u = record.inputs_with_slopes if self.point.slopes else record.inputs
            lost = self._lost_until(record, stop)
            stream.append(self._fed, record.outputs(self._fed, stop), u(self._fed, stop), lost)
            self._fed = stop
            batch = stream.rows()
        self._units = min(2 * self._units, UNITS_MOST)
        return self._settled(record, batch)

    def _lost_until(self, record: Record, stop: int) -> Lost:
        """Return the lost readings of the heads and the rests of hops that are whole by sample `stop`."""
        plan, lost = self.settings.plan, Lost.none()
        loses = record.loses(self._lost_fed, stop)
        while True:
            into = self._lost_fed % plan.hop
            end = self._lost_fed - into + (plan.head if into < plan.head else plan.hop)
            if end > stop:
                return lost
            if loses:
                lost = lost.followed(record.lost_between(self._lost_fed, end, plan.window))
            self._lost_fed = end

    def _move(self, record: Record, posterior: Posterior, newest: int) -> None:
        """Work from now on at what is known; rows from `newest` on are computed again."""
        before = self.point
        self._place(posterior)
        self._units = UNITS_LEAST
        try:
            self._start_stream(record, newest)
        except NoSteadyStateError:
            self.point = before
            self._start_stream(record, newest)

    # ------------------------------------------------------------------ the rows
    def _settled(self, record: Record, batch: BankRows) -> Outcome:
        """Read a batch of rows and act at the first that asks for it; later rows of the batch are then void."""
        windowed, point, plan = batch.windows[0], self.point, self.settings.plan
        if windowed is None or point is None:
            return Outcome.warming(batch.index, self.settings.rig.q)
        far_sd = FARTHEST_SD if self.settings.longer else FAR_SD
        reading = read(windowed, point, plan.window, self._jump, far_sd)
        hollow = self._hollow(record, reading.index) | reading.unsolved
        still = self._still(record, reading.index)
        frozen = self.faults.frozen_in(record, reading.index, still)
        broken = (reading.broken(self.learner.threshold) | hollow) & ~still | frozen
        sound = ~broken & ~still
        assert self.known is not None  # noqa: S101 - known since the first window
        agrees = self.faults.agrees(reading, self.known)
        rows = Outcome.of(reading, self.settings.enough_sd)
        ended = np.empty(len(rows.index), dtype=np.int64)
        stop, position, marked = len(reading.index), 0, 0
        while position < stop:
            if self.faults.is_active:
                broken[position] |= sound[position] and not agrees[position]  # biased by a channel, though it fits
            else:
                position = self._first_event(reading, broken & ~hollow, hollow | still, position)
            # what is done at a row depends on the rows before it, however many of them came at once
            self._mark(record, rows, range(marked, position), broken, hollow, still, ended)
            marked = position
            if position < stop and frozen[position]:
                self.faults.freeze(record, int(reading.index[position]))
            elif position < stop and self._meet(record, reading, position, broken, hollow | still):
                stop = position
            position += 1
        self._mark(record, rows, range(marked, stop), broken, hollow, still, ended)
        if self.settings.longer:
            longer = [
                None if windowed is None else read(windowed, point, samples)
                for samples, windowed in zip(self.settings.longer, batch.windows[1:], strict=True)
            ]
            stop = self._centred(record, rows, longer, broken, ended, stop)
            rows = self._choose(rows.part(0, stop), longer, broken[:stop], ended[:stop])
        else:
            rows = rows.part(0, stop)
        rows.stand_still((still & ~frozen)[:stop])
        self.faults.rested(record, reading.index[:stop][sound[:stop]])
        self._jump = float(reading.jump[stop - 1]) if stop else self._jump
        return rows

    def _still(self, record: Record, index: IntArray) -> BoolArray:
        """(N,) windows that end at samples `index` which teach nothing: codes rest, or show nothing but noise."""
        window, known = self.settings.plan.window, self.known
        rests = np.asarray(record.changes_in(index, window) < min(tuning.LEAST_CHANGES, window // 8))
        if known is None or not known.noise.is_started or not len(index):
            return rests
        chance = 1 + tuning.STANDSTILL_SD * np.sqrt(0.5 / window)  # of a standard deviation from so many samples
        quiet = record.spread_in(index, window) < chance * self.learner.spread(known.noise)
        return np.asarray(rests | quiet.all(axis=1))

    def _hollow(self, record: Record, index: IntArray) -> BoolArray:
        """(N,) windows that end at samples `index` and lost too many readings to say anything."""
        window = self.settings.plan.window
        return np.asarray(record.lost_in(index, window) > MOST_LOST * window)

    def _window(self, record: Record, newest: int) -> tuple[Window, FloatArray]:
        """Return the window that ends with a sample, suspect inputs near what the motion asks of them, and by how much.

        A blow moves what the window is linearised about, so it must be in before anything is solved.
        """
        window, known = record.window(newest, self.settings.plan.window), self.known
        moved = np.zeros(len(window.lost))
        doubted = self._doubts.among(window.lost, newest + 1 - window.length)
        if known is None or not doubted.any():
            return window, moved
        for _ in range(REFILLS):
            change = np.where(doubted, self.learner.lost_readings(window, known, moved)[0], 0.0)
            window, moved = refilled(window, change, self.settings.rig), moved + change
        return window, moved

    def _decide(self, record: Record, reading: Reading, i: int, broken: bool) -> bool:
        """Tell spikes from blows among the suspect inputs due at a row; return whether the bank runs again."""
        newest = int(reading.index[i])
        self._doubts.lapse(newest - self.settings.plan.window)
        due = self._doubts.due(newest, self.settings.plan.window)
        if not due:
            return False
        found = self._found(record, newest) if broken else reading.found.get(newest, Found.nothing())
        refused, confirmed = self._doubts.decide(due, found)
        self._spikes += refused
        for (sample, channel), change in confirmed.items():
            entries = taps_of(self.settings.rig, self.settings.outputs, slopes=False)[channel]
            record.restore(sample, entries, channel, change)
        if confirmed:
            self._run_again(record, newest)
        return bool(confirmed)

    def _found(self, record: Record, newest: int) -> Found:
        """Return what the window that ends with a sample says of its suspect inputs, about itself."""
        known = self.known
        assert known is not None  # noqa: S101 - known since the first window
        whole, moved = self._window(record, newest)
        values, covariance = self.learner.lost_readings(whole, known, moved)
        start = newest + 1 - whole.length
        places = tuple((start + row, channel) for row, channel in whole.lost.tolist())
        return Found(places, values + moved, covariance, whole.lost_sd)

    def _clean(self, found: Reading, index: IntArray, broken: BoolArray, ended: IntArray) -> tuple[IntArray, BoolArray]:
        """Rows (k,) of a longer window's readings, and which of these hold no change that a shorter one saw.

        ended (N,): where the last stretch of broken rows before each row ended.
        """
        at = np.searchsorted(index, found.index)
        use = at < len(index)
        use[use] &= ~broken[at[use]]
        use &= (found.excess < tuning.MISMATCH_SD) & ~found.unsolved
        use[use] &= found.index[use] - found.samples >= ended[at[use]]
        return at, use

    def _centred(
        self, record: Record, rows: Outcome, longer: list[Reading | None], broken: BoolArray, ended: IntArray, stop: int
    ) -> int:
        """Move the point to what the longest window says that is too sharp for it; return how many rows stand."""
        for found in reversed(longer):
            if found is None:
                continue
            at, use = self._clean(found, rows.index[:stop], broken[:stop], ended[:stop])
            far = np.flatnonzero(use & found.far & (found.index >= self._centred_at + found.samples // TRIES))
            if len(far) and self.known is not None and self.posterior is not None:
                newest = int(found.index[far[0]])
                self._centred_at = newest
                if self.budget.take(newest):
                    self.known = replace(self.known, theta=np.maximum(found.theta[far[0]], self.settings.rig.lower))
                    self._move(record, self.posterior, newest)
                    return int(at[far[0]])
        return stop

    def _choose(self, rows: Outcome, longer: list[Reading | None], broken: BoolArray, ended: IntArray) -> Outcome:
        """Take each estimate from the shortest window that is sharp enough, among those that hold no change.

        What each window says by itself stands in `others`.
        """
        each = [rows.copy()]
        for found in longer:
            each.append(Outcome.warming(rows.index, self.settings.rig.q))
            if found is None:
                continue
            at, use = self._clean(found, rows.index, broken, ended)
            use &= ~found.far
            wanting = ~(rows.sd[at[use]] <= self.settings.wanted_sd) & (found.sd[use] < rows.sd[at[use]])
            rows.take(at[use], wanting, found, use, self.settings.enough_sd)
            whole = at < len(rows.index)
            each[-1].take(at[whole], np.ones_like(found.sd[whole], dtype=bool), found, whole, self.settings.enough_sd)
            for unusable in at[whole & ~use].tolist():
                each[-1].invalidate(unusable, Reason.CHANGING)
        return replace(rows, others=tuple(each))

    def _first_event(self, reading: Reading, broken: BoolArray, hollow: BoolArray, start: int) -> int:
        """Return the first row from `start` on at which something is to be done; the number of rows if none."""
        events = self._calls(reading, broken, hollow)
        decision = self._doubts.first_due(self.settings.plan.window)
        if decision is not None:
            events |= (reading.index >= decision) & ~hollow
        events = events[start:]
        return start + int(np.argmax(events)) if events.any() else len(reading.index)

    def _calls(self, reading: Reading, broken: BoolArray, hollow: BoolArray) -> BoolArray:
        """(N,) rows that ask for their window to be learnt from or solved."""
        index = reading.index
        retry = max(1, self.settings.plan.window // TRIES)
        sound = ~broken & ~hollow
        due = self._due(reading) & sound
        far = reading.far & sound & (index >= self.disturbance.tried + retry)
        torn = broken & (index >= self.disturbance.tried + retry)
        return np.asarray(due | far | torn)

    def _due(self, reading: Reading) -> BoolArray:
        """(N,) rows whose windows are to be learnt from: it is time, or there is far less noise than was learnt."""
        index, whole = reading.index, reading.index >= self.schedule.tried + self.settings.plan.window
        quiet = (reading.excess < -tuning.MISMATCH_SD) & whole
        return np.asarray(((index >= self.schedule.due) | quiet) & (not self.budget.closed))

    def _meet(self, record: Record, reading: Reading, i: int, broken: BoolArray, hollow: BoolArray) -> bool:
        """Do what a row asks for; return whether the bank moved or runs again."""
        if self._decide(record, reading, i, bool(broken[i])):
            return True
        calls = self._calls(reading, broken & ~hollow, hollow)
        return bool(calls[i]) and self._act(record, reading, i, broken)

    def _mark(
        self,
        record: Record,
        rows: Outcome,
        which: range,
        broken: BoolArray,
        hollow: BoolArray,
        still: BoolArray,
        ended: IntArray,
    ) -> None:
        """Write on rows what broke them: a change for a window's length after its onset, then a mismatch.

        ended (N,) is filled with the sample at which the last stretch of broken rows before each of them ended.
        """
        for i in which:
            index = int(rows.index[i])
            if broken[i]:
                self.disturbance.at(index)
                if index in self._lines:
                    rows.write(i, self._lines.pop(index), self.settings.enough_sd)
                    ended[i] = self.disturbance.ended
                    continue
                lasting = index - (self.disturbance.onset or 0) > self.settings.plan.window
                reason = self.faults.reason or (Reason.MISMATCH if lasting else Reason.CHANGING)
                rows.invalidate(i, Reason.GAP if hollow[i] else reason)
            else:
                self.disturbance.over(index)
                if not still[i] and not self.faults.is_frozen(record, index):
                    self.faults.over(index)
                if self.posterior is not None and self.posterior.rubs:
                    rows.invalidate(i, Reason.DRY_FRICTION)
            ended[i] = self.disturbance.ended

    def _act(self, record: Record, reading: Reading, i: int, broken: BoolArray) -> bool:
        """Learn from a row's window, or solve it; return whether the bank moved."""
        newest = int(reading.index[i])
        due = newest >= self.disturbance.tried + max(1, self.settings.plan.window // TRIES)
        if broken[i]:
            return due and self._explain(record, newest)
        if self._due(reading)[i]:
            return self._learn(record, reading, i)
        return bool(reading.far[i]) and due and self._relinearise(record, newest)

    def _learn(self, record: Record, reading: Reading, i: int) -> bool:
        newest, known = int(reading.index[i]), self.known
        assert known is not None  # noqa: S101 - known since the first window
        window = self._window(record, newest)[0]
        posterior, learnt = self.learner.learn(window, known)
        self.solved += 1
        if posterior.changing or not posterior.converged:
            self.schedule.later(newest)
            return False
        if self.settings.longer:
            # longer windows need a sharper point than one short window gives
            agree = np.all(np.abs(learnt.theta - known.theta) < tuning.AGREE_SD * posterior.sd_repeat)
            learnt = replace(learnt, theta=known.theta) if agree else learnt
        self._believe(newest, window, learnt)
        self.posterior = posterior
        self.schedule.done(newest)
        if reading.excess[i] < -tuning.MISMATCH_SD or learnt.noise.differs_from(known.noise):
            self.schedule.follow(newest)
        if not self._is_elsewhere(reading, i, posterior):
            return False
        self._move(record, posterior, newest)
        return True

    def _is_elsewhere(self, reading: Reading, i: int, posterior: Posterior) -> bool:
        """Whether the learner's answer differs from the row's."""
        moved = np.abs(posterior.theta - reading.theta[i]) > MOVED_SD * reading.sd[i]
        own = np.abs(np.log(posterior.sd_repeat / reading.sd_repeat[i])) > MOVED_LOG_SD
        whole = np.abs(np.log(posterior.sd / reading.sd[i])) > MOVED_LOG_SD
        return bool((moved | own | whole).any())

    def _relinearise(self, record: Record, newest: int) -> bool:
        """Solve a window that is far from the point; the bank goes there if it comes to rest."""
        self.disturbance.tried = newest
        if not self.budget.take(newest):
            return False
        return self._solve(record, newest) is not None

    def _solve(self, record: Record, newest: int) -> Posterior | None:
        """Solve a window about itself; move there and return what it says if it holds, else None."""
        known = self.known
        assert known is not None  # noqa: S101 - known since the first window
        self.solved += 1
        window = self._window(record, newest)[0]
        posterior, theta = self.learner.solve(window, known)
        self._last = (window, posterior)
        rests = posterior.converged and not posterior.changing and not posterior.mismatch
        if self._is_a_channel(record, window, newest, theta, rests) or not rests:
            return None
        self.known = replace(known, theta=theta)
        self._move(record, posterior, newest)
        return posterior

    def _is_a_channel(self, record: Record, window: Window, newest: int, theta: FloatArray, rests: bool) -> bool:
        """Whether a channel may be what is wrong with a window; asked where it is whole, or other parameters fit it."""
        onset, faults, known = self.disturbance.onset, self.faults, self.known
        whole = onset is not None and newest - onset >= WHOLE * self.settings.plan.window
        if known is None or self.posterior is None or not (rests or whole or faults.is_active):
            return False
        found = faults.contest(record, window, newest, known, self.posterior.sd_repeat, theta)
        return faults.follow(newest, found, onset, rests)

    def _explain(self, record: Record, newest: int) -> bool:
        """Try to explain a broken row: other parameters, lines, or a whole window after its onset other noise."""
        disturbance = self.disturbance
        disturbance.at(newest)
        disturbance.tried = newest
        if not self.budget.take(newest):
            return False
        if self._moves and self._runs_on(self._window(record, newest)[0], newest):
            return False
        if self._solve(record, newest) is not None:
            if disturbance.is_more_than_a_change(newest, self.settings.plan.window):
                return self._relearn(record, *self._last, newest, jumps=False) or True
            self.known = replace(self.known, scatter=self.known.scatter.interrupted())  # type: ignore[union-attr,type-var]
            self.schedule.follow(newest)
            return True
        window, posterior = self._last
        early = newest - (disturbance.onset or newest) < self.settings.plan.window
        if self.faults.standing is not None:  # it is looked at again a window later
            disturbance.tried = newest + self.settings.plan.window - max(1, self.settings.plan.window // TRIES)
        if early or self.faults.is_active or not posterior.converged or self._runs_on(window, newest):
            return False
        return self._relearn(record, window, posterior, newest, jumps=posterior.changing)

    def _relearn(self, record: Record, window: Window, posterior: Posterior, newest: int, *, jumps: bool) -> bool:
        """Take a change of the noise for what broke a window, unless one jump explains it better."""
        known = self.known
        assert known is not None  # noqa: S101 - known since the first window
        if jumps and not self.learner.contested(window, known, posterior):
            return False
        said, learnt = self.learner.learn(window, known, shaken=True, believe=True)
        if not said.converged or (jumps and not learnt.noise.exceeds(known.noise)):
            return False
        self._believe(newest, window, learnt)
        self.posterior = said
        self.schedule.follow(newest)
        self._move(record, said, newest)
        return True

    def _runs_on(self, window: Window, newest: int) -> bool:
        """Whether parameters that run straight lines explain a window; its row then says where they are at its end."""
        assert self.known is not None  # noqa: S101 - known since the first window
        line = self.learner.line(window, self.known)
        self._moves = line.holds
        if line.holds:
            self._lines[newest] = line.end
            self.known = replace(self.known, theta=line.middle)
            self.budget.give_back()
        return line.holds


def _lost(missing: BoolArray | None, suspect: BoolArray | None, width: int) -> BoolArray | None:
    """Return (N, width) what counts as lost; the constant input never does."""
    marks = [mask for mask in (missing, suspect) if mask is not None]
    if not marks:
        return None
    lost = np.logical_or.reduce(marks)
    return np.asarray(np.pad(lost, ((0, 0), (0, width - lost.shape[1]))))
