"""The product's estimator: sliding-window maximum likelihood in observer form, with its policy of change.

Samples go in, one row of estimates comes out a hop. A row is one exact projected Gauss-Newton step about theta_r from
block summaries (`hops`, `window`, `solved`); the policy here decides when a window straddles a change (`change`), when
theta_r is moved by an iterated fit (`placing`), and when colour, suspects and unknown forces are looked for (`upkeep`).
"""

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.change import Change, hear
from agent.numerics.estimator.farther import LONG, NONE, Farther
from agent.numerics.estimator.lacking import MOST, Lacking
from agent.numerics.estimator.memory import FAR, Memory, disjoint, far, quieter
from agent.numerics.estimator.moving import Moving
from agent.numerics.estimator.placing import place
from agent.numerics.estimator.relearning import Relearning
from agent.numerics.estimator.solved import Solved, mend, solved
from agent.numerics.estimator.stillness import still
from agent.numerics.estimator.straddle import Window, is_clean
from agent.numerics.estimator.upkeep import NEVER, Upkeep
from agent.numerics.estimator.window_settings import WindowSettings
from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.faults.frozen import standing
from agent.numerics.faults.suspects import Accusation
from agent.numerics.fitting.fit import Fit
from agent.numerics.fitting.work import EVALUATION, WORK, Budget
from agent.numerics.model.observer import Noise
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Model
from agent.numerics.window.choice import choose, keep_each
from agent.numerics.window.hops import Segment
from agent.numerics.window.rows import Rows
from agent.numerics.window.solution import solve_windows
from agent.types import Calibrated

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
UNITS_MIN, UNITS_MAX = 32, 1024
"""Hops computed at once: few after a re-centring (which throws the rest of them away), more while nothing happens."""
CALIBRATION = 32_768
"""The same for a fit that learns the noise: what the newest samples leave says little of a whole long window."""
MOST_FAILED = 6
"""First fits that fail are tried again after a quarter of a window, then after twice as long each time, this often."""
EVALUATIONS, RATE = 700, 3.0
"""Evaluations of the longest record that a rig may begin with, and what each sample adds (in samples of work)."""
CALM = 4
"""Windows without a fit or a change after which a residual has its usual colour."""


class WindowML:
    """Sliding-window maximum likelihood over a stream of samples; deterministic however the stream is cut.

    Attributes:
        point: where it is linearised, with noise and colour.
        recentred: how often theta_r was moved.
    """

    def __init__(self, model: Model, settings: WindowSettings) -> None:
        self.settings = settings
        self.point = WorkingPoint(model, settings)
        self.recentred = 0
        self._upkeep = Upkeep(None if settings.mistakes is None else settings.mistakes.frozen())
        self._memory = Memory.empty(len(self.point.theta))
        self._lacking = Lacking(self.point.outputs)
        self._moving = None if settings.drift is None else Moving(settings.drift)
        self._segment: Segment | None = None
        self._units = UNITS_MIN
        self._anchored = self._adopted = False
        self._relearning = Relearning(settings)
        self._failed = 0
        self._last_fit = self._steady_since = NEVER
        self._change = Change()
        self._farther = Farther(settings)
        self.budget = Budget(EVALUATIONS * (EVALUATION + self._relearning.record), RATE)

    @property
    def spikes(self) -> int:
        """Samples so far of which nothing but an input was taken for a spike."""
        return self._lacking.spikes

    def calibrated(self) -> Calibrated | None:
        """Return what is known of the rig's disturbances; None while that is nothing to rely on."""
        sound = self.point.settled and self.point.wrong is None and not self._upkeep.accused
        return self.point.calibrated(searched=self._relearning.searched) if sound else None

    def adopt(self, known: Calibrated) -> None:
        """Begin with what an earlier run knew; a first window that it does not explain ends that."""
        self._adopted = self.point.adopt(known)
        if self._adopted:
            self._relearning.begin(searched=known.searched)

    def hurry(self) -> None:
        """Begin no fit and no search any more."""
        self.budget.close()

    def take_findings(self) -> list[tuple[int, Accusation]]:
        """Return (sample, accusation) of what the model was found to lack since the last call."""
        found, self._upkeep.findings = self._upkeep.findings, []
        return found

    def start_segment(self) -> None:
        """Forget the samples before a gap; what was learnt of the parameters stays."""
        self._segment = None
        self._change.forget()
        self._anchored = False
        self._lacking.forget()
        if self._moving is not None:
            self._moving.forget()

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Rows:  # fmt: skip
        """Take consecutive samples y (N, p), u (N, m), the first of them number `index`; return the rows they end.

        missing (N, p+m): readings that were filled in and are to be treated as unknown.
        suspect (N, p+m): inputs that may be spikes; they are taken for such where nothing else explains a window.
        """
        if missing is not None:
            self._lacking.append(index, missing)
        if suspect is not None:
            self._lacking.doubt(index, suspect)
        v = np.hstack([y, with_constant(u, self.point.discrete.model.m)])
        q, plan = len(self.point.theta), self.settings.plan
        if self._segment is None:
            more = [(window - plan.head) // plan.hop for window in self.settings.longer]
            self._segment = Segment(plan, index, v.shape[1], more)
        first_row = self._segment.first if self._segment.head is None else index
        due = plan.rows_between(index, min(first_row, index + len(v)))
        pieces = [Rows.warming(due, q, self.settings.windows)] if len(due) else []
        self._segment.append(index, v)
        while self._segment.ready():
            pieces.append(self._advance(self._segment))
        longest = max(plan.window, *self.settings.longer, self.settings.drift or 0)
        self._segment.trim(max(longest, self._relearning.wants(self._segment.done - 1)) + plan.hop)
        self._lacking.trim(self._segment.first)
        return Rows.joined(pieces, q)

    def _advance(self, segment: Segment) -> Rows:
        """Summarise what is ready, judge each row, act at the first that asks for it, return the rows settled."""
        point = self.point
        index, windows = segment.advance(point.operators, min(segment.ready(), self._units))
        found = solved(point, segment, index, None if windows is None else solve_windows(windows, point.n))
        rows = found.rows
        rows.suspect[rows.full], rows.channel[rows.full] = self._upkeep.accused, self._upkeep.channel
        mend(found, point, segment, self._lacking)
        white_sd = rows.sd / point.widening
        moved_at = self._judge(segment, found)
        if self.settings.longer and self.settings.wanted_sd is not None:
            with np.errstate(invalid="ignore"):
                widening = np.where(white_sd > 0, rows.sd / white_sd, 1.0)
            share, longer = rows.dof / point.dof, self.settings.longer
            keep_each(rows, widening, share, found.candidates, longer, point.doubt)
            choose(rows, widening, found.candidates, longer, self.settings.wanted_sd)
        rows.still[:] = still(point, segment, rows)
        if moved_at is None:
            self._units = min(2 * self._units, max(UNITS_MAX, 2 * self.settings.plan.fulls))
        else:
            # rows after the one that moved theta_r belong to the old operators and are computed again
            self._units, rows = UNITS_MIN, rows.part(moved_at + 1)
            self._lacking.take_back(int(rows.index[-1]))
        rows.mismatch[rows.full & self._relearning.restless(rows.index)] = True
        if self._moving is not None:
            self._moving.follow(point, segment, self._lacking, rows, moved=moved_at is not None)
        return rows

    def _judge(self, segment: Segment, found: Solved) -> int | None:
        """Give the verdicts in order; return the row at which theta_r was moved (those after it are void), or None."""
        rows = found.rows
        trusted = self._anchored  # rows about a theta_r that was never fitted say nothing to remember
        healthy, wanting = self._first_looks(found)
        asking = self._farther.asks(self.point, found)
        position, count = 0, len(rows.index)
        while position < count:
            events = (~healthy | wanting | (asking != NONE) | self._chores(rows))[position:] & rows.full[position:]
            events = events if self._anchored else rows.full[position:]
            ahead = int(np.argmax(events)) if events.any() else count - position
            if ahead:
                self._change.forget()
            position += ahead
            if position == count:
                break
            able, done = self.budget.allows(int(rows.index[position])), WORK.done
            if able and healthy[position] and self._anchored and self._keep_house(segment, rows, position):
                healthy, wanting = self._first_looks(found)
            before = self._memory
            # what came before this row is remembered first: a fit that contradicts it must forget it too
            self._remember(segment, found, healthy & trusted, position)
            ways = bool(healthy[position]), bool(wanting[position])
            moved = (self._act if able else self._wait)(segment, rows, position, *ways)
            number = int(asking[position])
            if able and not moved and healthy[position] and number != NONE:
                moved = self._go_farther(segment, int(rows.index[position]), number)
                asking = asking if moved else self._farther.asks(self.point, found)
            self.budget.spend(done)
            if moved:
                return position
            self._memory = before
            position += 1
        self._remember(segment, found, healthy & trusted, count)
        return None

    def _remember(self, segment: Segment, found: Solved, healthy: BoolArray, stop: int) -> None:
        """Add the disjoint healthy windows among the first `stop` rows to the memory."""
        chosen = disjoint(self.settings.plan, found.rows, healthy & (np.arange(len(healthy)) < stop))
        if len(chosen):
            self._memory = self._memory.with_rows(self.point, found.rows, found.information, chosen)
            self._upkeep.note(segment, self.settings.plan.window, found.rows.index[chosen])

    def _first_looks(self, found: Solved) -> tuple[BoolArray, BoolArray]:
        """Return which rows pass the gate (N,), and which of them want theta_r moved (N,)."""
        point, rows, information = self.point, found.rows, found.information
        passes = rows.ratio <= point.gate
        passes &= ~self._memory.contradicted(point, rows, information, passes)
        moves = far(point, rows) | quieter(point, rows) | self._memory.drifted(point, rows, information, passes)
        return passes, np.asarray(moves & passes)

    def _chores(self, rows: Rows) -> BoolArray:
        """(N,) rows at which colour, commissioning or the search for unknown forces is due."""
        commission = np.zeros(len(rows.index), dtype=bool)
        if not self.point.commission.known:
            commission[disjoint(self.settings.plan, rows, rows.ratio <= self.point.gate)] = True
        search = self._relearning.due(rows.index, self._steady_since)
        return np.asarray(self._upkeep.due(self.point, rows) | search | commission)

    def _keep_house(self, segment: Segment, rows: Rows, row: int) -> bool:
        """See to colour and commissioning at a healthy row; return whether later rows must be looked at anew."""
        point = self.point
        recoloured = bool(self._upkeep.due(point, rows)[row])
        if recoloured:
            self._upkeep.recolour(point, segment, self._lacking, rows, row)
            self._note_usual(int(rows.index[row]))
            self._relearning.look(point, segment, self._lacking, rows, row)
        if point.commission.known or row not in disjoint(self.settings.plan, rows, rows.ratio <= point.gate):
            return recoloured
        if not point.commission.add(rows.theta[row : row + 1], rows.sd[row : row + 1]):
            return recoloured
        rows.sd[row + 1 :] *= point.commission.factor
        return True

    def _note_usual(self, index: int) -> None:
        """Take the colour of a window that nothing disturbed for a while for the usual one, by and by."""
        point = self.point
        if index - max(self._last_fit, self._steady_since) >= CALM * self.settings.plan.window:
            point.usual_share = float(np.sqrt(point.usual_share * point.colour.share))

    def _wait(self, segment: Segment, rows: Rows, row: int, healthy: bool, _wants: bool) -> bool:
        """Mark one eventful row for whose fit there is no budget; theta_r stays."""
        index = int(rows.index[row])
        if self._anchored and healthy:
            self._change.forget()
            return False
        self._relearning.suffer(index, self._memory.past.reference)
        self._change.begin(index)
        self._steady_since = index
        self.point.commission.restart()
        self._mark(segment, rows, row, healthy=healthy, look=False)
        return False

    def _act(self, segment: Segment, rows: Rows, row: int, healthy: bool, wants: bool) -> bool:
        """Mark one eventful row and try a fit where the policy calls for one; return whether theta_r was moved."""
        index, window = int(rows.index[row]), self.settings.plan.window
        hollow = self._lacking.count(rows.index[row : row + 1], window)[0] > MOST * window
        if hollow or (not self.point.settled and self._upkeep.finds_standing(self.point, segment, rows, row)):
            return False
        due = index - self._last_fit >= max((window // 4) << self._failed, self._change.pause(index, window))
        if self._anchored and healthy:
            self._change.forget()
            if self._relearning.due(index, self._steady_since):
                found = self._relearning.search(self.point, segment, self._lacking, index + 1)
                return found is not None and self._go_on_with(found, segment, rows, row)
            return wants and due and (self._relearn(segment, rows, row) or self._fit(segment, rows, row))
        self._relearning.suffer(index, self._memory.past.reference)
        starting = not self._anchored and (due or self._change.onset is None)
        self._change.begin(index)
        self._steady_since = index
        self.point.commission.restart()
        if self._anchored and self._upkeep.finds_frozen(segment, window, rows, row):
            return False
        fitted = (starting or self._is_free(segment, rows, row, due=due)) and self._fit(segment, rows, row)
        if fitted or self._relearn(segment, rows, row):
            self._change.onset = None
            return True
        if self._relearning.calibrated_at == index:
            self._upkeep.believe_in_distress(self.point, rows, row)
        self._mark(segment, rows, row, healthy=healthy)
        return False

    def _go_farther(self, segment: Segment, index: int, number: int) -> bool:
        """Move theta_r to what a longer window of nothing but what is now says, if it can; return whether it was."""
        first = self._steady_since - self.settings.plan.window + self.settings.plan.hop
        known = self._anchored and index - self.settings.longer[number] >= first
        reference = self._farther.move(self.point, segment, self._lacking, index, number) if known else None
        if reference is not None:
            self._memory, self.recentred = self._memory.with_reference(reference), self.recentred + 1
        return reference is not None

    def _is_free(self, segment: Segment, rows: Rows, row: int, *, due: bool) -> bool:
        """Tell whether a window after the onset of a change may be fitted: it holds none of what was before."""
        plan, since = self.settings.plan, int(rows.index[row]) - (self._change.onset or 0)
        if self._change.blamed is not None and not due:
            return False  # the next hearing is of a window apart
        # the window that begins after the onset is free of it for certain, one before that may be
        if self._anchored and since >= plan.window - plan.hop and (due or since < plan.window):
            return True
        return 2 * since >= plan.window and since < plan.window and self._is_clean(segment, rows, row)

    def _mark(self, segment: Segment, rows: Rows, row: int, *, healthy: bool, look: bool = True) -> None:
        """Say what a row is that no fit explained, and look for what the model lacks when that has lasted."""
        index, window = int(rows.index[row]), self.settings.plan.window
        since = self._change.lasting(index)
        excited = bool(np.any(rows.sd[row] < self.settings.enough_sd))
        if not healthy or excited:
            # a rig that was never understood is not changing where what it lacks is known
            lasting = since >= window or (not self.point.settled and bool(self._upkeep.accused))
            rows.changing[row], rows.mismatch[row] = not lasting, lasting
        if self._change.mark(rows, row, self._last_fit, window):
            return
        looked = self._change.blamed is not None or self._upkeep.proven or index - self._upkeep.accused_at < window
        if look and since >= window and not looked and self._unsuspected():
            self._upkeep.accuse_in_distress(self.point, segment, self._lacking, rows, row)

    def _unsuspected(self) -> bool:
        """Tell whether nothing better is known than what a look at theta_r would say."""
        return self.point.settled or (self.point.wrong is None and self.point.mistake is None)

    def _is_clean(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Tell whether a window that its residual does not accuse is free of what contradicts the past."""
        point, window = self.point, self.settings.plan.window
        past, known = self._memory.past.mean(), rows.ratio[row : row + 1] <= point.gate
        if past is None or not known[0] or self._lacking.count(rows.index[row : row + 1], window)[0]:
            return False
        stop = int(rows.index[row]) + 1
        v = segment.samples(stop - min(window, LONG), stop)
        told = Window(point.sampled, point.gain, v, point.scale, self.settings.lower)
        return is_clean(told, past * point.scale, rows.theta[row])

    def _relearn(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Look for forces in what has long been without an explanation; where there are some, go on with their gain."""
        index = int(rows.index[row])
        if self._change.named or not self._anchored:
            return False
        due = index - self._last_fit >= self.settings.plan.window // 4
        if self._relearning.due_in_trouble(index):
            self._relearning.calibrate(self.point, segment, self._lacking, index + 1)
            due = True
        found = self._relearning.forces
        if due and found is not None and self._go_on_with(found, segment, rows, row):
            self._relearning.end_trouble()
            return True
        return False

    def _go_on_with(self, found: Noise, segment: Segment, rows: Rows, row: int) -> bool:
        """Assume other disturbances from a row on, where its window fits under them; return whether it does."""
        before, self.point.noise = self.point.noise, found
        moved = self._fit(segment, rows, row)
        self.point.noise = self.point.noise if moved else before
        return moved

    def _fit(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Fit the window of a row; if the fit passes the gate move theta_r and redo the summaries."""
        point, stop = self.point, int(rows.index[row]) + 1
        self._last_fit = stop - 1
        v = segment.samples(stop - self.settings.plan.window, stop)
        if not point.settled:
            point.take_sizes(v)
        restore, was_settled = point.kept(), point.settled
        # what stands still shows no noise to learn anew
        quiet = bool(quieter(point, rows)[row]) and not standing(v[:, : point.outputs]).any()
        afresh = not (was_settled or self._adopted) or quiet
        most = CALIBRATION if afresh else LONG
        whole = len(v) <= most or self._lacking.count(rows.index[row : row + 1], len(v))[0] > 0
        v = v if whole else v[-LONG:]
        problem = point.problem(v, self._lacking.bridge(v, stop))
        near = self._anchored and self._change.onset is None
        beginning = np.where(np.isfinite(rows.theta[row]) & near, rows.theta[row], point.theta)
        fit = point.maximise(problem, beginning, afresh=afresh, near=near)
        if self._adopted and not was_settled and point.refutes_adopted(problem, fit):
            self._disown()
            afresh, fit = True, point.maximise(problem, point.theta, afresh=True, near=False)
        verdict = None if near or not was_settled else hear(point, self._memory, problem, fit)
        self._change.note(verdict, self._last_fit)
        dof = point.dof_of(self.settings.plan.window, 0 if problem.bridge is None else problem.bridge.free)
        sound = verdict is None and point.mistake is None and fit.converged
        if sound and self._move(segment, rows, row, fit, dof, whole=whole):
            if afresh:
                point.usual_share = point.colour.share
            return True
        restore()
        if self._adopted and not point.settled:
            self._disown()
        self._upkeep.believe(point, v, rows, row)
        # a first fit searches for unknown forces: where it keeps failing it must not eat the time there is
        self._failed = 0 if point.settled else min(self._failed + 1, MOST_FAILED)
        return False

    def _disown(self) -> None:
        """Drop what an earlier run knew: the rig is not as it was."""
        self._adopted = False
        self._relearning.begin(searched=False)
        self.point.forget_adopted()

    def _move(self, segment: Segment, rows: Rows, row: int, fit: Fit, dof: float, *, whole: bool) -> bool:
        """Move theta_r to a fit and give its row what the fit says; return False where the fit does not stand."""
        point, index = self.point, int(rows.index[row])
        start, before, least = index + 1 - self.settings.plan.window, point.theta, point.negligible
        placed = place(point, segment, self._memory.reference, fit, start, dof if whole else None)
        if placed is None:
            return False
        if self._anchored:
            least = np.maximum(FAR * placed.sd, least)
            self._relearning.move(index, placed.theta - before, least, self._memory.past.reference)
        self._memory = self._memory.with_reference(placed.reference)
        self._upkeep.coloured_at, self._failed = index, 0
        if not self._anchored or self._change.onset is not None:
            self._steady_since, self._memory = index, self._memory.without_past()
        self._anchored = True
        self.recentred += 1
        rows.theta[row], rows.sd[row], rows.ratio[row] = placed.theta, placed.sd, placed.ratio
        rows.dof[row] = dof * point.colour.share
        rows.changing[row] = rows.mismatch[row] = False
        self._upkeep.review(point, segment, self._lacking, rows, row)
        return True
