"""The product's estimator: samples in, one row of estimates a hop.

    hop -> row          from the streaming bank, at the operating point
    window -> learn     noise, constants and the point itself, on disjoint windows, ever more seldom
    broken row -> solve about the window itself: the parameters changed, or the noise did, or the model does not hold
    budget              what all of this may cost beside the rows

The bank (`agent.numerics.window`) and the learner (`agent.numerics.inference`) are two forms of one likelihood.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.bank import Bank
from agent.numerics.estimator.budget import Budget
from agent.numerics.estimator.doubts import Doubts, Found
from agent.numerics.estimator.faults import WHOLE, Faults, Finding
from agent.numerics.estimator.look_ahead import LookAhead, Ready
from agent.numerics.estimator.memory import LEAST_WINDOWS, from_text, to_text
from agent.numerics.estimator.operating_point import taps_of
from agent.numerics.estimator.outcome import Outcome
from agent.numerics.estimator.reading import FAR_SD, FARTHEST_SD, Reading, read
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.schedule import TRIES, Disturbance, Schedule
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.estimator.windows import chosen, clean
from agent.numerics.inference import tuning
from agent.numerics.inference.columns import Window, refilled
from agent.numerics.inference.learner import Knowledge, Learner, Posterior
from agent.numerics.inference.verdicts import Belief, beliefs
from agent.numerics.window.rows import BankRows
from agent.types import Reason

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
RETRY = 4
"""Tries a window length to find a first window that fits."""
MOST_LOST = 0.1
"""Share of a window's samples that may have lost readings; beyond it a window says too little for what it costs."""
REFILLS = 2
"""Times that suspect inputs are put where the motion asks for them before a window is solved."""
MOVED_SD = 0.2
"""Difference between learner and bank, in sds, from which on the bank takes the learner's point."""
MOVED_LOG_SD = 0.1
"""The same for the logarithm of a sd."""


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
        self.solved = 0
        self._bank = Bank(settings, self.learner.sources)
        self._record: Record | None = None
        self._ahead = LookAhead(settings.rig)
        self._doubts = Doubts()
        self._jump = 0.0
        self._spikes = 0
        self._adopted = False
        self._centred_at = -(1 << 60)
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
        self._bank.stop()
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
        while not self._bank.is_running and record.stop > self._whole:
            first, begun = self._whole, self._begin(record)
            if not begun:
                self._whole += -(-plan.window // (RETRY * plan.hop)) * plan.hop
                passed = due[(due >= first) & (due < self._whole)]
                unexplained = Outcome.unexplained(passed, q, self.faults.reason or Reason.MISMATCH)
                newest = np.minimum(passed, record.stop - 1)
                unexplained.lack(self._hollow(record, newest))
                unexplained.stand_still(self._still(record, newest))
                pieces.append(unexplained)
        while (batch := self._bank.next(record)) is not None:
            pieces.append(self._settled(record, batch))
        record.trim(max(self.settings.windows) + plan.window + plan.hop + 1)
        return Outcome.joined([piece for piece in pieces if len(piece.index)], q)

    # ------------------------------------------------------------------ the first window
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
        self._move(record, posterior, newest)
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

    def _move(self, record: Record, posterior: Posterior, newest: int) -> None:
        """Work from now on at what is known; rows from `newest` on are computed again."""
        assert self.known is not None  # noqa: S101 - set by whoever calls
        self._bank.move(record, self.known, posterior, newest)

    # ------------------------------------------------------------------ the rows
    def _settled(self, record: Record, batch: BankRows) -> Outcome:
        """Read a batch of rows and act at the first that asks for it; later rows of the batch are then void."""
        windowed, point, plan = batch.windows[0], self._bank.point, self.settings.plan
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
            rows = chosen(rows.part(0, stop), longer, broken[:stop], ended[:stop], self.settings)
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
            self._bank.run_again(record, newest)
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

    def _centred(
        self, record: Record, rows: Outcome, longer: list[Reading | None], broken: BoolArray, ended: IntArray, stop: int
    ) -> int:
        """Move the point to what the longest window says that is too sharp for it; return how many rows stand."""
        for found in reversed(longer):
            if found is None:
                continue
            at, use = clean(found, rows.index[:stop], broken[:stop], ended[:stop])
            far = np.flatnonzero(use & found.far & (found.index >= self._centred_at + found.samples // TRIES))
            if len(far) and self.known is not None and self.posterior is not None:
                newest = int(found.index[far[0]])
                self._centred_at = newest
                if self.budget.take(newest):
                    self.known = replace(self.known, theta=np.maximum(found.theta[far[0]], self.settings.rig.lower))
                    self._move(record, self.posterior, newest)
                    return int(at[far[0]])
        return stop

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
