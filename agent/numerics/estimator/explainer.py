"""What is known of a rig and of its channels, and what each window that asks for it is explained by.

    first window    -> learnt from, unless a channel wrong from the start explains it better
    window due      -> noise, constants and the point are learnt
    far from point  -> solved about itself; the bank goes there
    broken          -> other parameters, parameters that run on, a channel, or other noise

Each is paid for out of the budget.
"""

from dataclasses import replace

import numpy as np

from agent.numerics.estimator.bank import Bank
from agent.numerics.estimator.doubts import Doubts
from agent.numerics.estimator.faults import Faults
from agent.numerics.estimator.memory import from_text, to_text
from agent.numerics.estimator.reading import Reading
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.schedule import (
    Budget,
    Disturbance,
    Schedule,
    eager_windows,
    samples_an_evaluation,
)
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.estimator.tuning import (
    AGAIN,
    LASTS,
    LEAST_LEFT,
    LEAST_WINDOWS,
    LONGEST,
    MOVED_LOG_SD,
    MOVED_SD,
    MOVING,
    POORER,
    REFILLS,
    SWITCHES,
    VERDICT_WINDOWS,
    WHOLE,
)
from agent.numerics.inference import tuning
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.linearise import Linearised
from agent.numerics.inference.posterior import Knowledge, Posterior
from agent.numerics.inference.spectral.columns import Window, refilled
from agent.numerics.inference.verdicts import Belief, beliefs
from agent.types import BoolArray, FloatArray


class Explainer:
    """Learns from windows and explains those that are broken or far.

    Attributes:
        known: what is carried from window to window; None before the first.
        posterior: of the newest window that was learnt from.
        lines: of windows whose parameters run on, by their newest samples, what they say of their ends.
        bank, budget, schedule, disturbance, faults, doubts: see there.
    """

    def __init__(self, settings: EstimatorSettings, budget: Budget) -> None:
        self.settings = settings
        window = settings.plan.window
        self.learner = Learner(settings.rig, window, settings.outputs, settings.floor, settings.wire)
        self.known: Knowledge | None = None
        self.posterior: Posterior | None = None
        self.lines: dict[int, Posterior] = {}
        self.bank = Bank(settings, self.learner.sources)
        self.budget = budget
        self.schedule = Schedule(window, eager_windows(window, settings.rig.period_s))
        self.disturbance = Disturbance()
        self.faults = Faults(self.learner, settings.floor)
        self.doubts = Doubts()
        self.solved = 0
        self._adopted = False
        self._learnt_at = 0
        self._counted = 0
        self._each = samples_an_evaluation(window, settings.rig.period_s)
        self._aside = 0  # evaluations of a try that are bounded by how seldom they are done
        self._owed = False  # a window that was due to be learnt from waits for the budget
        self._moves = False  # the newest window looked at holds parameters that run on
        self._hardens = -np.inf  # log odds of springs that do, against changes, in the window last solved
        self._ran_at = -(1 << 60)
        self._since_anew = VERDICT_WINDOWS  # windows learnt from since noise was looked for anew
        self._beliefs: list[tuple[int, tuple[Belief, ...]]] = []

    def interrupted(self) -> None:
        """Note the end of a segment; what was learnt stays."""
        self.bank.stop()
        self.doubts.forget()
        self.disturbance = Disturbance()
        self.lines = {}
        self._moves = False
        if self.known is not None:
            self.known = replace(self.known, scatter=self.known.scatter.interrupted())

    def knowledge(self) -> str | None:
        """Return what was learnt, as JSON text; None before enough windows have been learnt from."""
        if self.known is None or self.known.noise.windows < LEAST_WINDOWS:
            return None
        return to_text(self.known)

    def adopt(self, content: str) -> None:
        """Begin with what an earlier run learnt, where it is of the same rig and window."""
        fresh = self.learner.prior(np.ones(self.settings.outputs), np.ones(self.settings.outputs))
        self.known = from_text(content, fresh, self.learner.wire, len(self.settings.rig.cubics))
        self._adopted = self.known is not None

    def take_beliefs(self) -> tuple[tuple[int, tuple[Belief, ...]], ...]:
        """Return (sample, beliefs about the rig's constants) of windows learnt from since the last call."""
        beliefs, self._beliefs = self._beliefs, []
        return tuple(beliefs)

    def begin(self, record: Record, newest: int) -> bool:
        """Learn from a segment's first whole window, and start the bank there; False if nothing fits it."""
        if not self._may_begin(newest):
            return False
        begun = self._begun(record, newest)
        self._pay()
        return begun

    def _begun(self, record: Record, newest: int) -> bool:
        window = self.window(record, newest)[0]
        new = self.posterior is None and not self._adopted
        posterior, learnt = self._first(window)
        if not posterior.converged or (record.rests_at(newest, window.length) and self._is_gone(posterior)):
            return False
        fresh = replace(self.learner.prior(*self._sigma(window.y)), stretch=learnt.stretch)
        if new and self.faults.reads_wrongly(record, window, newest, fresh, learnt, posterior):
            return False
        self.faults.begun(record, window, newest, learnt)
        self.posterior = posterior
        self._believe(newest, window, learnt)
        self.schedule.done(newest)
        self._move(record, posterior, newest)
        return True

    def _is_gone(self, posterior: Posterior) -> bool:
        """Whether a window knows a parameter to be a part of what is configured, or nothing.

        So it says of the springs of a mass that friction holds for half of it.
        """
        surely = posterior.theta + tuning.AGREE_SD * posterior.sd
        return bool(np.any(surely < LEAST_LEFT * self.settings.rig.nominal))

    def _first(self, window: Window) -> tuple[Posterior, Knowledge]:
        """Learn from a segment's first window; what was learnt before and does not explain it is learnt anew.

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
        self.known, self._learnt_at = learnt, newest
        self.faults.learnt(window)
        constants = self.settings.rig.constants
        if constants and min(learnt.noise.windows, self._since_anew) >= VERDICT_WINDOWS:
            self._beliefs.append((newest, beliefs(learnt.constants, constants, learnt.stretch)))
        self._since_anew += 1

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
        self.bank.move(record, self.known, posterior, newest)

    def window(self, record: Record, newest: int, *, as_read: bool = False) -> tuple[Window, FloatArray]:
        """Return the window ending with a sample, suspect inputs near what the motion asks, and by how much.

        A blow moves what the window is linearised about, so it must be in before anything is solved. as_read:
        suspect inputs as they were read, where other parameters than are known may have moved.
        """
        window = record.window(newest, self.settings.plan.window)
        known = self.known
        moved = np.zeros(len(window.lost))
        doubted = self.doubts.among(window.lost, newest + 1 - window.length)
        if known is None or not known.kept or not doubted.any():  # no window was learnt from
            return window, moved
        if as_read:
            read = self.doubts.read(window.lost, newest + 1 - window.length)
            return refilled(window, read, self.settings.rig), read
        for _ in range(REFILLS):
            change = np.where(doubted, self.learner.lost_readings(window, known, moved)[0], 0.0)
            window, moved = refilled(window, change, self.settings.rig), moved + change
        return window, moved

    def _later(self, newest: int) -> float:
        """Windows from the newest that was learnt from to the one that ends with a sample."""
        return (newest - self._learnt_at) / self.settings.plan.window

    def _known_at(self, known: Knowledge, newest: int) -> Knowledge:
        """Return what is known when a sample is read: constants walked since the last window learnt from.

        That one went wrong since is not assumed: it is what the windows solved with this are asked.
        """
        return replace(known, constants=known.constants.after(max(self._later(newest), 0.0)))

    def due(self, reading: Reading) -> BoolArray:
        """(N,) rows whose windows are to be learnt from: it is time, or noise is far less than was learnt.

        Where few windows are learnt from, one that tells little is passed over, for as long again at the
        most: constants that may have changed since would be known no better after it.
        """
        index = reading.index
        whole = reading.index >= self.schedule.tried + self.settings.plan.window
        quiet = (reading.excess < -tuning.MISMATCH_SD) & whole
        is_time = index >= np.where(self._is_poor(reading), self.schedule.overdue, self.schedule.due)
        return np.asarray((is_time | quiet) & (not self.budget.closed))

    def _is_poor(self, reading: Reading) -> BoolArray:
        """(N,) rows whose windows know no parameter nearly as well as the sharpest do."""
        point = self.bank.point
        assert point is not None  # noqa: S101 - rows are read at one
        return np.asarray((reading.sd_repeat > POORER * point.unit * point.sharpest).all(axis=1))

    def learn(self, record: Record, reading: Reading, i: int) -> bool:
        """Learn from a row's window; return whether the bank moved."""
        newest = int(reading.index[i])
        known = self.known
        assert known is not None  # noqa: S101 - known since the first window
        self._owed = not self._may_begin(newest)
        if self._owed:
            self.schedule.later(newest)
            return False
        moved = self._learnt(record, reading, i, known)
        self._pay()
        return moved

    def _learnt(self, record: Record, reading: Reading, i: int, known: Knowledge) -> bool:
        newest = int(reading.index[i])
        if self.disturbance.since(self.schedule.tried):  # the windows before a change do not compare
            known = replace(known, scatter=known.scatter.interrupted())
        window = self.window(record, newest)[0]
        posterior, learnt = self.learner.learn(window, known, later=max(self._later(newest), 1.0))
        self.solved += 1
        if posterior.changing or not posterior.converged:
            self.schedule.later(newest, failed=not posterior.converged)
            return False
        if self.settings.longer:
            # longer windows need a sharper point than one short window gives
            agree = np.all(np.abs(learnt.theta - known.theta) < tuning.AGREE_SD * posterior.sd_repeat)
            learnt = replace(learnt, theta=known.theta) if agree else learnt
        self._believe(newest, window, learnt)
        self.posterior = posterior
        self.schedule.done(newest)
        drifts = learnt.constants.drift_probability > tuning.DRIFT_FOLLOWED
        other = learnt.noise.differs_from(known.noise, self.learner.sources)
        if reading.excess[i] < -tuning.MISMATCH_SD or other or drifts:
            self.schedule.follow(newest)
        if not self._is_elsewhere(reading, i, posterior):
            return False
        self._move(record, posterior, newest)
        return True

    def _may_begin(self, newest: int) -> bool:
        """Whether something is left to spend at sample `newest`; what is begun then ends with `_pay`."""
        if not self.budget.allows(newest):
            return False
        lineariser = self.learner.lineariser
        self._counted = lineariser.evaluations
        lineariser.most = lineariser.evaluations + LONGEST
        return True

    def _pay(self, least: int = 0) -> None:
        """Take what was evaluated since it began, and `least` at the least, out of the budget."""
        self.learner.lineariser.most = np.inf
        done = self.learner.lineariser.evaluations
        self.budget.spend(max(done - self._counted, least, 0) * self._each)
        self._counted = done

    def _is_elsewhere(self, reading: Reading, i: int, posterior: Posterior) -> bool:
        """Whether the learner's answer differs from the row's."""
        moved = np.abs(posterior.theta - reading.theta[i]) > MOVED_SD * reading.sd[i]
        own = np.abs(np.log(posterior.sd_repeat / reading.sd_repeat[i])) > MOVED_LOG_SD
        whole = np.abs(np.log(posterior.sd / reading.sd[i])) > MOVED_LOG_SD
        return bool((moved | own | whole).any())

    def centre(self, record: Record, newest: int, theta: FloatArray) -> bool:
        """Move the bank to theta (q,), which a longer window found; return whether there was a token."""
        if self.known is None or self.posterior is None or not self._may_begin(newest):
            return False
        eta = self.known.constants.predicted().standing[0]  # as rows are linearised
        self.known = replace(self.known, theta=np.maximum(theta, self.settings.rig.lower), eta=eta)
        self._pay(MOVING)
        self._move(record, self.posterior, newest)
        return True

    def relinearise(self, record: Record, newest: int) -> bool:
        """Solve a window that is far from the point; the bank goes there if it comes to rest."""
        self.disturbance.tried(newest, self.settings.plan.window)
        if self._owed or not self._may_begin(newest):
            return False
        sound = not self.faults.is_active
        solved = self._solve(record, newest)
        if sound and solved is not None and not self._is_the_same(solved):
            self._take_move(record, newest)
        self._pay()
        return solved is not None

    def _take_move(self, record: Record, newest: int) -> None:
        """Go on where an unbroken window moved to; of the first to, none that holds its move is learnt from.

        What the first windows of all say is too rough to tell a move.
        """
        assert self.known is not None  # noqa: S101 - a window was solved
        if self._changes_again(newest):
            if self._is_pushed(newest):
                self._relearn(record, *self._last, newest, jumps=False)
        elif self.known.noise.windows >= VERDICT_WINDOWS:
            self.schedule.skip(newest)

    def _changes_again(self, newest: int) -> bool:
        """Whether parameters that change at a sample changed shortly before."""
        return self.disturbance.changes_again(newest, self.settings.plan.window)

    def _is_pushed(self, newest: int) -> bool:
        """Whether unknown forces rather than parameters that changed again explain the window solved last."""
        known, learnt = self.known, self.posterior
        assert known is not None and learnt is not None  # noqa: S101, PT018 - a window was solved
        before = self._known_at(replace(known, theta=learnt.theta), newest)
        return self.faults.is_pushed(self._last[0], before, learnt.sd_repeat, known.theta)

    def _solve(self, record: Record, newest: int) -> Posterior | None:
        """Solve a window about itself; move there and return what it says if it holds, else None."""
        known = self.known
        assert known is not None  # noqa: S101 - known since the first window
        self.solved += 1
        now = self._known_at(known, newest)
        window, posterior, at = self._at_rest(record, newest, now)
        self._last = (window, posterior)
        self._hardens = -np.inf
        if not posterior.holds:
            lasting = self._since(newest) >= LASTS * self.settings.plan.window
            self._hardens = self.learner.hardens(at, now, lasting=lasting)
        rests = posterior.holds
        same = rests and self._is_the_same(posterior)
        if (not same and self._is_a_channel(record, window, newest, at.theta, rests)) or not rests:
            return None
        self.known = self.learner.moved_to(at, known, same)
        self._move(record, posterior, newest)
        return posterior

    def _at_rest(self, record: Record, newest: int, now: Knowledge) -> tuple[Window, Posterior, Linearised]:
        """A window, what it says, and where it comes to rest.

        A window after rows broke its parameters may be anywhere, and what the motion asked of suspect inputs
        was asked by parameters that are gone.
        """
        window, filled = self.window(record, newest)
        posterior, at = self.learner.solve(window, now)
        strayed = not posterior.converged or bool(filled.any())
        if posterior.holds or not strayed or self._since(newest) < window.length:
            return window, posterior, at
        whole = self.window(record, newest, as_read=True)[0]
        anew, there = self.learner.solve(whole, now, anew=True)
        return (whole, anew, there) if anew.holds else (window, posterior, at)

    def _is_the_same(self, posterior: Posterior) -> bool:
        """Whether an unbroken window says what the one learnt from last said: only the point was poor."""
        unbroken = self.disturbance.onset is None and not self.faults.is_active
        return unbroken and self._agrees(posterior)

    def _agrees(self, posterior: Posterior) -> bool:
        """Whether a window says what the one learnt from last said."""
        if self.posterior is None:
            return False
        apart = np.abs(posterior.theta - self.posterior.theta)
        return bool(np.all(apart < tuning.AGREE_SD * np.hypot(posterior.sd_repeat, self.posterior.sd_repeat)))

    def _is_a_channel(
        self, record: Record, window: Window, newest: int, theta: FloatArray, rests: bool
    ) -> bool:
        """Whether a channel may be wrong in a window; asked where it is whole, or other parameters fit it."""
        onset, faults, known = self.disturbance.onset, self.faults, self.known
        whole = onset is not None and newest - onset >= WHOLE * self.settings.plan.window
        is_asked = any((rests, whole, faults.is_active))
        if known is None or self.posterior is None or not is_asked:
            return False
        now = self._known_at(known, newest)
        found = faults.contest(record, window, newest, now, self.posterior.sd_repeat, theta)
        return faults.follow(newest, found, onset, rests)

    def explain(self, record: Record, newest: int) -> bool:
        """Try to explain a broken row: other parameters, lines, or a whole window after onset other noise."""
        disturbance, length = self.disturbance, self.settings.plan.window
        disturbance.at(newest)
        disturbance.tried(newest, length)
        if not self._may_begin(newest):
            return False
        before, self._aside = self.budget.left, 0
        runs_on = self._moves and self._runs_on(self.window(record, newest)[0], newest)
        moved = not runs_on and self._explained(record, newest)
        self._pay()
        if not moved and newest not in self.lines:
            took = before - self.budget.left - self._aside * self._each
            share = min(took / before, 1.0)
            disturbance.missed(newest, length, share, converged=self._last[1].converged)
        return moved

    def _explained(self, record: Record, newest: int) -> bool:
        """Explain a broken row by other parameters, else by something else."""
        self.faults.slides = False
        if self._solve(record, newest) is not None:
            self._take_change(record, newest)
            return True
        if self.faults.slides and self._follows(record, newest):
            return True
        return self._explain_otherwise(record, newest)

    def _follows(self, record: Record, newest: int, *, hard: bool = False) -> bool:
        """Learn the constants from a broken window, springs if they harden; return whether it holds then."""
        known = self.known
        assert known is not None  # noqa: S101 - known since the first window
        window = self._last[0]
        later = max(self._later(newest), 1.0)
        learnt = self.learner.learn(window, known, believe=True, later=later, hard=hard or None)[1]
        said = self.learner.solve(window, learnt)[0]
        if not said.holds or (hard and not learnt.constants.believes(self.settings.rig.of_kind("cubic"))):
            return False
        self.faults.over(newest)
        self._take(record, window, said, learnt, newest)
        return True

    def _take(self, record: Record, window: Window, said: Posterior, learnt: Knowledge, newest: int) -> None:
        """Go on with what was learnt from a broken window."""
        self._believe(newest, window, learnt)
        self.posterior = said
        self.schedule.follow(newest)
        self._move(record, said, newest)

    def _take_change(self, record: Record, newest: int) -> None:
        """Go on with other parameters that fit a window; where they change again, maybe with other noise.

        Those that are again what they were have not changed: something came and went.
        """
        assert self.known is not None  # noqa: S101 - known since the first window
        again = not self._agrees(self._last[1]) and self._changes_again(newest)
        if again and self._is_pushed(newest):
            self._relearn(record, *self._last, newest, jumps=False)
            return
        self.known = replace(self.known, scatter=self.known.scatter.interrupted())
        self.schedule.follow(newest)

    def _explain_otherwise(self, record: Record, newest: int) -> bool:
        """Explain a window that no other parameters fit: soon, by springs that harden only."""
        disturbance, length = self.disturbance, self.settings.plan.window
        posterior = self._last[1]
        if self.faults.standing is not None:  # it is looked at again a window later
            disturbance.wait(newest + length)
        if self.faults.is_active:
            return False
        if self._hardens > 0 and self._springs(record, newest):
            return True
        lasts = LASTS if posterior.jumps_once else 1.0
        return self._since(newest) >= lasts * length and self._explain_lasting(record, newest)

    def _explain_lasting(self, record: Record, newest: int) -> bool:
        """Explain a window behind a change by lines, springs that harden, other noise, or constants."""
        window, posterior = self._last
        if not posterior.converged:
            return self._switches(record, newest)
        if self._runs_on(window, newest):
            return False
        if self._springs(record, newest):
            return True
        jumps = self._may_jump(posterior, newest)
        return self._relearn(record, window, posterior, newest, jumps=jumps) or self._switches(record, newest)

    def _switches(self, record: Record, newest: int) -> bool:
        """Explain a broken window behind its onset by constants that changed: a mass that is loaded."""
        known, onset = self.known, self.disturbance.onset
        assert known is not None  # noqa: S101 - known since the first window
        went_on = onset is not None and self._ran_at >= onset
        if went_on or self._last[1].beyond_jump <= tuning.MISMATCH_SD:  # parameters changed
            return False
        if not self.disturbance.may_switch(newest, self.settings.plan.window):
            return False
        window = self.window(record, newest, as_read=True)[0]
        evaluated = self.learner.lineariser.evaluations
        self.learner.lineariser.most = evaluated + SWITCHES
        said, learnt = self.learner.switched(window, known, max(self._later(newest), 1.0))
        if not said.holds:
            self._aside = self.learner.lineariser.evaluations - evaluated
            return False
        self._take(record, window, said, replace(learnt, scatter=learnt.scatter.interrupted()), newest)
        return True

    def _springs(self, record: Record, newest: int) -> bool:
        """Explain a window by springs that harden, a window after onset: what jumped is behind then."""
        lasting = self._since(newest) >= self.settings.plan.window
        return self._hardens > -np.inf and lasting and self._follows(record, newest, hard=True)

    def _since(self, newest: int) -> int:
        """Samples since rows broke; 0 where they are not broken."""
        return newest - (self.disturbance.onset or newest)

    def _may_jump(self, posterior: Posterior, newest: int) -> bool:
        """Whether a jump may break a window: not where rows are broken for long and no line explains them.

        Their windows would each have to hold another one.
        """
        length = self.settings.plan.window
        soon = newest - (self.disturbance.onset or newest) < AGAIN * length
        return posterior.changing and (soon or newest - self._ran_at < length)

    def _relearn(
        self, record: Record, window: Window, posterior: Posterior, newest: int, *, jumps: bool
    ) -> bool:
        """Take a change of the noise for what broke a window, unless one jump explains it better."""
        known = self.known
        assert known is not None  # noqa: S101 - known since the first window
        if jumps and not self.learner.contested(window, self._known_at(known, newest), posterior):
            return False
        later = max(self._later(newest), 1.0)
        said, learnt = self.learner.learn(window, known, shaken=True, believe=True, later=later)
        if not said.converged or (jumps and not learnt.noise.exceeds(known.noise)):
            return False
        self._since_anew = 0
        self._take(record, window, said, learnt, newest)
        return True

    def _runs_on(self, window: Window, newest: int) -> bool:
        """Whether parameters on straight lines explain a window; its row then says where they end."""
        assert self.known is not None  # noqa: S101 - known since the first window
        line = self.learner.line(window, self._known_at(self.known, newest))
        self._moves = line.holds
        if line.holds:
            self._ran_at = newest
            self.lines[newest] = line.end
            self.schedule.skip(newest)
            self.known = replace(self.known, theta=line.middle)
            self._counted = self.learner.lineariser.evaluations  # what explains a row is no loss
        return line.holds
