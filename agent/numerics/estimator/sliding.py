"""The product's estimator: samples in, one row of estimates a hop.

    hop -> row          from the streaming bank, at the operating point
    window -> learn     noise, constants and the point itself, on disjoint windows, ever more seldom
    broken row -> solve about the window itself: the parameters changed, the noise did, or the model fails
    budget              what all of this may cost beside the rows

The bank (`agent.numerics.window`) and the learner (`agent.numerics.inference`) are two forms of one
likelihood.
"""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.estimator.doubts import Found
from agent.numerics.estimator.explainer import Explainer
from agent.numerics.estimator.look_ahead import LookAhead, Ready
from agent.numerics.estimator.operating_point import OperatingPoint, taps_of
from agent.numerics.estimator.outcome import Outcome, chosen, clean
from agent.numerics.estimator.reading import Reading, read
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.schedule import Budget, budget_of
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.estimator.tuning import FAR_SD, FARTHEST_SD, MOST_LOST, RETRY, TRIES
from agent.numerics.inference import tuning
from agent.numerics.window.rows import BankRows, Windowed
from agent.types import BoolArray, FloatArray, IntArray, Reason


@dataclass(slots=True)
class _Batch:
    """N rows on their way.

    Attributes:
        reading: what their windows say.
        longer: what the longer windows say; None of one that is not whole yet.
        rows: as they will be given.
        broken: (N,) a change, or nothing known explains it.
        sound: (N,) neither broken nor still.
        hollow: (N,) too many readings lost.
        still: (N,) nothing moved.
        frozen: (N,) the outputs repeat themselves.
        agrees: (N,) the estimates are what they were.
        ended: (N,) sample at which the last stretch of broken rows before each of them ended.
        marked: how many of them carry what broke them.
    """

    reading: Reading
    longer: list[Reading | None]
    rows: Outcome
    broken: BoolArray
    sound: BoolArray
    hollow: BoolArray
    still: BoolArray
    frozen: BoolArray
    agrees: BoolArray
    ended: IntArray
    marked: int = 0


class SlidingEstimator:
    """Sliding-window maximum a-posteriori estimation over a stream; the same however the stream is cut."""

    def __init__(self, settings: EstimatorSettings, budget: Budget | None = None) -> None:
        self.settings = settings
        self.explainer = Explainer(settings, budget or budget_of(settings.plan.window, settings.rig.period_s))
        self._ahead = LookAhead(settings.rig)
        self._record: Record | None = None
        self._jump = 0.0
        self._spikes = 0
        self._centred_at = -(1 << 60)

    @property
    def spikes(self) -> int:
        """Samples so far of which nothing but an input was taken for a spike."""
        return self._spikes

    def knowledge(self) -> str | None:
        """Return what was learnt, as JSON text; None before enough windows have been learnt from."""
        return self.explainer.knowledge()

    def adopt(self, content: str) -> None:
        """Begin with what an earlier run learnt, where it is of the same rig and window."""
        self.explainer.adopt(content)

    def hurry(self) -> None:
        """Do nothing but rows from now on: no fit, no search."""
        self.explainer.budget.close()

    def start_segment(self) -> None:
        """Forget the samples before a gap; what was learnt stays."""
        self._record = None
        self._ahead.forget()
        self.explainer.interrupted()

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        """Take consecutive samples y (N, p), u (N, m), from number `index` on; return the rows they end.

        missing (N, p+m): readings (outputs, then inputs) that were filled in. suspect (N, p+m): inputs that
        may be spikes: they count as lost, and the motion says which of them were.
        """
        u = self.explainer.doubts.replaced(index, u, suspect, y.shape[1])
        ready = self._ahead.step(index, y, u, missing, suspect)
        rows = self._rows(ready) if len(ready.y) else Outcome.joined([], self.settings.rig.q)
        beliefs = self.explainer.take_beliefs()
        findings = self.explainer.faults.take()
        return replace(rows, beliefs=beliefs, findings=findings) if beliefs or findings else rows

    def _rows(self, ready: Ready) -> Outcome:
        """Take complete samples; return the rows they end."""
        index, y, u = ready.index, ready.y, ready.u
        missing = _lost(ready.missing, ready.suspect, u.shape[1] + y.shape[1])
        plan, q = self.settings.plan, self.settings.rig.q
        if self._record is None:
            self._record = Record(index, y.shape[1], u.shape[1], self.explainer.doubts)
            self._whole = -(-index // plan.hop) * plan.hop + plan.window - 1
        record = self._record
        record.append(y, u, missing)
        due = plan.rows_between(index, index + len(y))
        warming = due[due < self._whole]
        pieces = [Outcome.warming(warming, q)] if len(warming) else []
        while not self.explainer.bank.is_running and record.stop > self._whole:
            first = self._whole
            begun = self._begin(record)
            if not begun:
                self._whole += -(-plan.window // (RETRY * plan.hop)) * plan.hop
                passed = due[(due >= first) & (due < self._whole)]
                unexplained = Outcome.unexplained(passed, q, self.explainer.faults.reason or Reason.MISMATCH)
                newest = np.minimum(passed, record.stop - 1)
                unexplained.lack(self._hollow(record, newest))
                unexplained.stand_still(self._still(record, newest) | record.rests_in(newest, plan.window))
                pieces.append(unexplained)
        while (batch := self.explainer.bank.next(record, self.explainer.schedule.due)) is not None:
            pieces.append(self._settled(record, batch))
        record.trim(max(self.settings.windows) + plan.window + plan.hop + 1)
        return Outcome.joined([piece for piece in pieces if len(piece.index)], q)

    def _begin(self, record: Record) -> bool:
        """Start rows at a segment's first whole window; False where it says nothing, or nothing fits it."""
        at = np.array([self._whole])
        if self._hollow(record, at)[0] or self._still(record, at)[0]:
            return False
        return self.explainer.begin(record, self._whole)

    # ------------------------------------------------------------------ the rows
    def _settled(self, record: Record, arrived: BankRows) -> Outcome:
        """Read a batch of rows and act at the first that asks for it; later rows of it are then void."""
        windowed, point = arrived.windows[0], self.explainer.bank.point
        if windowed is None or point is None:
            return Outcome.warming(arrived.index, self.settings.rig.q)
        batch = self._batch(record, windowed, self._longer(record, arrived, point), point)
        stop, moved = self._acted(record, batch)
        rows = batch.rows.part(0, stop)
        if batch.longer:
            rows = chosen(rows, batch.longer, batch.broken[:stop], batch.ended[:stop], self.settings)
        rows.stand_still((batch.still & ~batch.frozen)[:stop])
        self.explainer.faults.rested(record, rows.index[batch.sound[:stop]])
        if moved:
            self._jump = 0.0  # what jumped did so about another point
        elif stop:
            self._jump = float(batch.reading.jump[stop - 1])
        return rows

    def _batch(
        self, record: Record, windowed: Windowed, longer: list[Reading | None], point: OperatingPoint
    ) -> _Batch:
        """Read the windows that end at a batch of rows, and see what of them can be told at once."""
        faults, known = self.explainer.faults, self.explainer.known
        assert known is not None  # noqa: S101 - known since the first window
        far_sd = FARTHEST_SD if self.settings.longer else FAR_SD
        window = self.settings.plan.window
        repeats = record.repeats_in(windowed.index, window)
        uneven = record.rounding_errors_in(windowed.index, window, point.rounding)
        reading = read(windowed, point, window, repeats, uneven, self._jump, far_sd)
        hollow = self._hollow(record, reading.index) | reading.unsolved
        still = self._still(record, reading.index)
        frozen = faults.frozen_in(record, reading.index, still)
        broken = reading.broken(self.explainer.learner.threshold)
        still |= self._held_fast(record, reading.index, broken | reading.far)
        broken = (broken | hollow) & ~still | frozen
        rows = Outcome.of(reading, self.settings.enough_sd)
        ended = np.empty(len(rows.index), dtype=np.int64)
        agrees = faults.agrees(reading, known)
        return _Batch(reading, longer, rows, broken, ~broken & ~still, hollow, still, frozen, agrees, ended)

    def _acted(self, record: Record, batch: _Batch) -> tuple[int, bool]:
        """Do what rows ask for, one after another; return how many rows stand, and whether the bank moved."""
        stop = len(batch.reading.index)
        position = 0
        while position < stop:
            position = self._next_event(batch, position)
            # what is done at a row depends on the rows before it, however many of them came at once
            self._mark(record, batch, position)
            centred = self._centred(record, batch, position)
            if centred < position:
                return centred, False
            if position < stop and self._moves_at(record, batch, position):
                return position, True
            position += 1
        waits = batch.marked < stop
        self._mark(record, batch, stop)
        return self._centred(record, batch, stop) if waits else stop, False

    def _next_event(self, batch: _Batch, start: int) -> int:
        """Return the first row from `start` on where something is to be done; the number of rows if none."""
        if not self.explainer.faults.is_active:
            return self._first_event(batch, start)
        if batch.sound[start] and not batch.agrees[start]:
            batch.broken[start] = True  # biased by a channel, though it fits
        return start

    def _moves_at(self, record: Record, batch: _Batch, i: int) -> bool:
        """Do what row i asks for; return whether the bank moved or runs again."""
        if batch.frozen[i]:
            self.explainer.faults.freeze(record, int(batch.reading.index[i]))
            return False
        return self._meet(record, batch, i)

    def _longer(self, record: Record, batch: BankRows, point: OperatingPoint) -> list[Reading | None]:
        """Return what the longer windows say; None of one that is not whole yet."""
        each = zip(self.settings.longer, batch.windows[1:], strict=True)
        return [
            None if windowed is None
            else read(
                windowed, point, samples, record.repeats_in(windowed.index, samples),
                record.rounding_errors_in(windowed.index, samples, point.rounding),
            )
            for samples, windowed in each
        ]  # fmt: skip

    def _still(self, record: Record, index: IntArray) -> BoolArray:
        """(N,) windows that end at samples `index` which teach nothing: codes rest, or show only noise."""
        window, known = self.settings.plan.window, self.explainer.known
        rests = np.asarray(record.changes_in(index, window) < min(tuning.LEAST_CHANGES, window // 8))
        if known is None or not known.noise.is_started or not len(index):
            return rests
        chance = 1 + tuning.STANDSTILL_SD * np.sqrt(
            0.5 / window
        )  # of a standard deviation from so many samples
        return rests | record.quiet_in(index, window, chance * self.explainer.learner.spread(known.noise))

    def _held_fast(self, record: Record, index: IntArray, other: BoolArray) -> BoolArray:
        """(N,) windows, of those that are other than what is known, in which something holds the machine.

        A mass that dry friction holds rests where its springs would move it: as if they were gone. Of how it
        moves for the rest of the window no other parameters are to be believed.
        """
        held = np.zeros(len(index), dtype=bool)
        if other.any():
            held[other] = record.rests_in(index[other], self.settings.plan.window)
        return held

    def _hollow(self, record: Record, index: IntArray) -> BoolArray:
        """(N,) windows that end at samples `index` and lost too many readings to say anything."""
        window = self.settings.plan.window
        return np.asarray(record.lost_in(index, window) > MOST_LOST * window)

    def _decide(self, record: Record, reading: Reading, i: int, broken: bool) -> bool:
        """Tell spikes from blows among suspect inputs due at a row; return whether the bank runs again."""
        newest = int(reading.index[i])
        self.explainer.doubts.lapse(newest - self.settings.plan.window)
        due = self.explainer.doubts.due(newest, self.settings.plan.window)
        if not due:
            return False
        found = self._found(record, newest) if broken else reading.found.get(newest, Found.nothing())
        refused, confirmed = self.explainer.doubts.decide(due, found)
        self._spikes += refused
        for (sample, channel), change in confirmed.items():
            rig = self.settings.rig
            entries = taps_of(rig, self.settings.outputs, len(rig.measured), slopes=False)[channel]
            record.restore(sample, entries, channel, change)
        if confirmed:
            self.explainer.bank.run_again(record, newest)
        return bool(confirmed)

    def _found(self, record: Record, newest: int) -> Found:
        """Return what the window that ends with a sample says of its suspect inputs, about itself."""
        known = self.explainer.known
        assert known is not None  # noqa: S101 - known since the first window
        whole, moved = self.explainer.window(record, newest)
        values, covariance = self.explainer.learner.lost_readings(whole, known, moved)
        start = newest + 1 - whole.length
        places = tuple((start + row, channel) for row, channel in whole.lost.tolist())
        return Found(places, values + moved, covariance, whole.lost_sd)

    def _centred(self, record: Record, batch: _Batch, stop: int) -> int:
        """Move the point to what the longest window, too sharp for it, says; return how many rows stand."""
        for found in reversed(batch.longer):
            if found is None:
                continue
            at, use = clean(found, batch.rows.index[:stop], batch.broken[:stop], batch.ended[:stop])
            far = np.flatnonzero(use & found.far & (found.index >= self._centred_at + found.samples // TRIES))
            if len(far):
                newest = int(found.index[far[0]])
                self._centred_at = newest
                if self.explainer.centre(record, newest, found.theta[far[0]]):
                    return int(at[far[0]])
        return stop

    def _first_event(self, batch: _Batch, start: int) -> int:
        """Return the first row from `start` on that asks for something; the number of rows if none."""
        index = batch.reading.index
        mute = batch.hollow | batch.still
        events = self._calls(batch.reading, batch.broken & ~batch.hollow, mute)
        decision = self.explainer.doubts.first_due(self.settings.plan.window)
        if decision is not None:
            events |= (index >= decision) & ~mute
        events = events[start:]
        return start + int(np.argmax(events)) if events.any() else len(index)

    def _calls(self, reading: Reading, broken: BoolArray, mute: BoolArray) -> BoolArray:
        """(N,) rows that ask for their window to be learnt from or solved."""
        index = reading.index
        sound = ~broken & ~mute
        due = self.explainer.due(reading) & sound
        return np.asarray(
            due | ((broken | (reading.far & sound)) & (index >= self.explainer.disturbance.again))
        )

    def _meet(self, record: Record, batch: _Batch, i: int) -> bool:
        """Decide on spikes and solve, learn or explain at row i; return whether the bank moved or reruns."""
        if self._decide(record, batch.reading, i, bool(batch.broken[i])):
            return True
        mute = batch.hollow | batch.still
        calls = self._calls(batch.reading, batch.broken & ~mute, mute)
        return bool(calls[i]) and self._act(record, batch.reading, i, batch.broken)

    def _mark(self, record: Record, batch: _Batch, stop: int) -> None:
        """Write on rows up to `stop` what broke them: a change for a window's length after onset, a mismatch.

        Filled beside them: the sample at which the last stretch of broken rows before each of them ended.
        """
        i = batch.marked
        while i < stop:
            sound = slice(i, i + _leading(~batch.broken[i:stop]))
            if sound.stop > i:
                self._hold(record, batch.rows, sound, batch.still)
                batch.ended[sound] = self.explainer.disturbance.ended
            i = sound.stop
            if i < stop:
                self._break(batch.rows, i, bool(batch.hollow[i]))
                batch.ended[i] = self.explainer.disturbance.ended
            i += 1
        batch.marked = max(batch.marked, stop)

    def _break(self, rows: Outcome, i: int, hollow: bool) -> None:
        """Note a broken row and write why it is, or what its window says if its parameters run on."""
        index = int(rows.index[i])
        window = self.settings.plan.window
        self.explainer.disturbance.at(index)
        if index in self.explainer.lines:
            rows.write(i, self.explainer.lines.pop(index), self.settings.enough_sd)
            return
        lasting = index - (self.explainer.disturbance.onset or 0) > window
        reason = self.explainer.faults.reason or (Reason.MISMATCH if lasting else Reason.CHANGING)
        rows.invalidate(i, Reason.GAP if hollow else reason)

    def _hold(self, record: Record, rows: Outcome, which: slice, still: BoolArray) -> None:
        """Note rows that hold, one after another."""
        faults, index = self.explainer.faults, rows.index[which]
        self.explainer.disturbance.over(int(index[0]))
        moving = index[~still[which]].tolist()
        if faults.standing is not None:
            moving = [one for one in moving if not faults.is_frozen(record, one)]
        if moving:
            faults.over(moving[0])
        if self.explainer.posterior is not None and self.explainer.posterior.rubs:
            rows.invalidate(which, Reason.DRY_FRICTION)

    def _act(self, record: Record, reading: Reading, i: int, broken: BoolArray) -> bool:
        """Learn from a row's window, or solve it; return whether the bank moved."""
        newest = int(reading.index[i])
        due = newest >= self.explainer.disturbance.again
        if broken[i]:
            return due and self.explainer.explain(record, newest)
        if self.explainer.due(reading)[i]:
            return self.explainer.learn(record, reading, i)
        return bool(reading.far[i]) and due and self.explainer.relinearise(record, newest)


def _lost(missing: BoolArray | None, suspect: BoolArray | None, width: int) -> BoolArray | None:
    """Return (N, width) what counts as lost; the constant input never does."""
    marks = [mask for mask in (missing, suspect) if mask is not None]
    if not marks:
        return None
    lost = np.logical_or.reduce(marks)
    return np.asarray(np.pad(lost, ((0, 0), (0, width - lost.shape[1]))))


def _leading(marks: BoolArray) -> int:
    """Return how many of the first marks are set."""
    return len(marks) if marks.all() else int(np.argmin(marks))
