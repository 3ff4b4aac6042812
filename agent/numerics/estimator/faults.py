"""Channels that read wrongly: suspected, named as long as that explains the rows, and cleared when they hold.

A suspicion is a window that a channel explains better than other parameters do. It becomes a fault once a
window lies all but wholly behind its onset. Until rows agree with what held before nothing is learnt, and no
parameter moves.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from agent.numerics.estimator.reading import Reading
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.tuning import AGREES_SD, DOUBTS, MOST_RESTS, NOISY, RESTS, WHOLE, WITHIN_SHEETS
from agent.numerics.inference import tuning
from agent.numerics.inference.channels import ChannelTest, Contest, Fault
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.posterior import Knowledge, Posterior
from agent.numerics.inference.spectral.columns import Window
from agent.numerics.preprocessing.noise import sensor_noise
from agent.types import BoolArray, FloatArray, IntArray, Reason


@dataclass(frozen=True, slots=True)
class Finding:
    """At a sample a fault of a channel began to stand, or (standing False) ended."""

    sample: int
    fault: Fault
    standing: bool


@dataclass(slots=True)
class Faults:
    """What is known of a rig's channels.

    standing: the fault that stands; tied: a channel or the structure, and nothing tells which; slides: a gain
    changed by no more than its data sheet lets it be off, which is learnt like any constant.
    """

    learner: Learner
    floor: FloatArray
    standing: Fault | None = None
    tied: bool = False
    slides: bool = False
    _channel_test: ChannelTest = field(init=False)
    _since: int | None = None
    _doubts: int = 0
    _findings: list[Finding] = field(default_factory=list)
    _rests: set[tuple[int, float]] = field(default_factory=set)
    _alive: bool = False
    _lasts: bool = False
    _usual: FloatArray = field(default_factory=lambda: np.zeros(0))
    _changes: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self._channel_test = ChannelTest(self.learner)

    @property
    def is_active(self) -> bool:
        """Whether a channel is named or suspected."""
        return self.standing is not None or self._since is not None

    @property
    def reason(self) -> Reason | None:
        """What rows carry because of it; None where nothing is known of any channel."""
        if self.standing is None:
            return Reason.INSEPARABLE if self.tied else None
        return Reason.STUCK if self.standing.kind == "stood" else Reason.SENSOR

    def take(self) -> tuple[Finding, ...]:
        """Return what began or ended since the last call."""
        found, self._findings = self._findings, []
        return tuple(found)

    def over(self, index: int) -> None:
        """Note a row that holds and agrees with what held before."""
        self._since, self.tied, self._doubts = None, False, 0
        self._set(index, None)

    def agrees(self, reading: Reading, known: Knowledge) -> BoolArray:
        """(N,) rows whose estimates are what they were."""
        return np.asarray((np.abs(reading.theta - known.theta) < AGREES_SD * reading.sd_repeat).all(axis=1))

    def learnt(self, window: Window) -> None:
        """Note what channels are like in a window learnt from: whether no output can repeat itself at all.

        And how large inputs are, and at which share of the samples they change.
        """
        grain = [float(np.diff(np.unique(column)).min(initial=np.inf)) for column in window.y.T]
        self._alive = bool(np.all(sensor_noise(window.y) > np.maximum(grain, NOISY * self.floor)))
        self._usual = np.asarray(window.u.std(axis=0))
        self._changes = np.asarray(np.mean(np.diff(window.u, axis=0) != 0, axis=0))

    def rested(self, record: Record, index: IntArray) -> None:
        """Note the values at which inputs rest in windows, ending at samples `index`, that hold."""
        resting = record.resting_in(index, self.learner.window // RESTS, self.learner.rig.driven)
        for row, number in zip(*(places.tolist() for places in resting.nonzero()), strict=True):
            if len(self._rests) < MOST_RESTS:
                self._rests.add((number, record.newest_input(int(index[row]), number)))

    def frozen_in(self, record: Record, index: IntArray, still: BoolArray) -> BoolArray:
        """(N,) windows that end at samples `index` in whose newer half no output changes, though noisy."""
        if not self._alive or not still.any():
            return np.zeros(len(index), dtype=bool)
        return np.asarray(still & (record.changes_in(index, self.learner.window // 2) == 0))

    def freeze(self, record: Record, newest: int) -> None:
        """Note that the outputs repeat themselves: the first of them is named."""
        self._since = newest
        self._name(newest, Fault(0, "stood", float(record.outputs(newest, newest + 1)[0, 0]), 0.0))

    def begun(self, record: Record, window: Window, newest: int, learnt: Knowledge) -> None:
        """Name an input that held one value through a first window whose motion asks for unknown forces."""
        self.over(newest)
        standing = self._standing_inputs(record, newest, self.learner.window)
        if standing and self._channel_test.forces_lead_by(window, learnt) > tuning.FIRST_EVIDENCE:
            self._set(newest, standing[0])

    def reads_wrongly(
        self, record: Record, window: Window, newest: int, fresh: Knowledge, said: Knowledge, found: Posterior
    ) -> bool:
        """Whether one channel, not what a first window is taken to say, explains it; that channel is named.

        Asked where a parameter found is many times its nominal, or unknown forces are as large as those that
        are measured. The contest is between the stated noise and nominal parameters with one channel wrong,
        and anything else. Where forces are larger than the measured ones, one that leads, but not surely,
        leaves the window without an explanation.
        """
        length = self.learner.window
        forces = self.learner.unknown_forces(window, said.noise)
        far = self._is_many_times(found.theta)
        odd = any((self.standing is not None, far, forces >= tuning.AS_LARGE))
        if self._standing_inputs(record, newest, length) or not odd:
            return False
        surely = all((any((far, forces >= tuning.LARGER)), not found.rubs))
        if surely and newest + 1 - record.first < length + length // 4:
            return True  # nothing can be late yet: looked at again a quarter of a window on
        explained = self._from_the_start(record, window, newest, replace(fresh, kept=said.kept), found)
        fault = explained.ahead_by(tuning.FIRST_EVIDENCE)
        if fault is not None:
            self._name(newest, fault)
        named = self.standing is not None
        in_doubt = any((named, far, forces >= 1.0)) and explained.leads is not None
        self.tied = in_doubt and not named
        return in_doubt

    def _from_the_start(
        self, record: Record, window: Window, newest: int, fresh: Knowledge, found: Posterior
    ) -> Contest:
        """Put a first window to a contest with channels that are wrong from the start."""
        nominal = np.abs(self.learner.rig.nominal)
        spread = np.where(nominal > 0, tuning.POINT_SD * nominal, self.learner.rig.scale)
        return self.contest(record, window, newest, fresh, spread, found.theta, first=True)

    def _is_many_times(self, theta: FloatArray) -> bool:
        """Whether a parameter (q,) is many times its nominal, or many times less."""
        nominal = self.learner.rig.nominal
        sized = nominal != 0
        ratio = np.maximum(theta[sized] / nominal[sized], np.exp(-10.0 * tuning.MANY_TIMES))
        return bool(np.any(np.abs(np.log(ratio)) > np.log(tuning.MANY_TIMES)))

    def _standing_inputs(self, record: Record, newest: int, span: int) -> list[Fault]:
        """Inputs that read one value other than 0 in the last `span` samples: a force at rest reads 0."""
        resting = record.resting_in(np.array([newest]), span, self.learner.rig.driven)[0]
        values = [(j, record.newest_input(newest, j)) for j in np.flatnonzero(resting).tolist()]
        return [Fault(self.learner.p + j, "stood", value, 0.0) for j, value in values if value != 0.0]

    def is_frozen(self, record: Record, index: int) -> bool:
        """Whether an input that stood still reads what it stood at."""
        fault, p = self.standing, self.learner.p
        if fault is None or fault.kind != "stood" or fault.channel < p:
            return False
        return record.newest_input(index, fault.channel - p) == fault.size

    def contest(
        self, record: Record, window: Window, newest: int, known: Knowledge, sd: FloatArray,
        solved: FloatArray,
        first: bool = False,
    ) -> Contest:  # fmt: skip
        """Put the window ending with sample `newest` to a contest of explanations; solved: its own best θ."""

        def late(channel: int, lag: int) -> Window | None:
            return record.late(newest, self.learner.window, channel, lag, self.learner.rig) if lag else window

        self._lasts = self.is_frozen(record, newest)
        found = self._channel_test.contest(window, known, sd, solved, late, everything=first)
        for number, value in self._frozen_inputs(record, newest):
            found = found.with_stood(
                self._channel_test.unbelieved(window, known, sd, number, value, self._usual[number])
            )
        return found

    def _frozen_inputs(self, record: Record, newest: int) -> list[tuple[int, float]]:
        """Inputs that stand, and where, as sound ones would not: neither at that value nor for so long.

        A force in its place explains a window as well as one beside it: what stands is a constant, and the
        mean of either is free. Only the standstill tells them apart: what is frozen stands; what is sound and
        changes with a share r of its samples stands for s of them with probability exp(-r s). A command that
        is held, or stepped now and then, may stand beside a load or a friction that nobody measures.
        """
        if not len(self._changes):
            return []
        span = int(WHOLE * self.learner.window)
        driven = self.learner.rig.driven
        changes = self._changes[: len(driven)] * span
        stands = record.resting_in(np.array([newest]), span, driven)[0] & (changes > tuning.CHANNEL_EVIDENCE)
        values = [(j, record.newest_input(newest, j)) for j in np.flatnonzero(stands).tolist()]
        return [place for place in values if place not in self._rests]

    def is_pushed(self, window: Window, known: Knowledge, sd: FloatArray, solved: FloatArray) -> bool:
        """Whether unknown forces explain a window better than other parameters do."""
        return self._channel_test.is_pushed(window, known, sd, solved)

    def follow(self, newest: int, found: Contest, onset: int | None, rests: bool) -> bool:
        """Take what a contest says; return whether a channel may be wrong, so that no parameter moves.

        onset: of broken rows, None where they hold; rests: other parameters fit the window. A gain that leads
        and is within its data sheet is rather learnt: parameters that follow it change in every window.
        """
        if self._lasts:
            return True
        named = found.fault is not None or self.standing is not None
        broken = onset is not None
        self.slides = all((broken, self.standing is None, self._is_within_sheet(found.leads)))
        if found.leads is None or (rests and not named):
            if self.slides:
                return True
            self._withdraw(newest)
            return self.standing is not None
        self._since = min((sample for sample in (self._since, onset) if sample is not None), default=newest)
        if newest - self._since < WHOLE * self.learner.window:
            return True
        self.tied = found.fault is None
        if found.fault is not None:
            self._name(newest, found.fault)
        return True

    def _is_within_sheet(self, fault: Fault | None) -> bool:
        """Whether what is wrong is a gain that changed by no more than its data sheet lets it be off."""
        if fault is None:
            return False
        p = self.learner.p
        place = ("output", fault.channel) if fault.channel < p else ("input", fault.channel - p)
        sheets = [c.sheet for c in self.learner.rig.constants if c.shows and (c.kind, c.number) == place]
        return fault.kind == "gain" and abs(fault.size) < WITHIN_SHEETS * max(sheets, default=0.0)

    def _name(self, newest: int, fault: Fault) -> None:
        self._doubts = 0
        same = self.standing is not None and self.standing.channel == fault.channel
        if not same:
            self._set(newest, fault)

    def _withdraw(self, newest: int) -> None:
        """A try that does not confirm: one may hold the fault's end."""
        self._doubts += 1
        if self._doubts >= DOUBTS or self.standing is None:
            self.over(newest)

    def _set(self, index: int, fault: Fault | None) -> None:
        if self.standing is not None:
            self._findings.append(Finding(index, self.standing, standing=False))
        if fault is not None:
            self._findings.append(Finding(index, fault, standing=True))
        self.standing = fault
