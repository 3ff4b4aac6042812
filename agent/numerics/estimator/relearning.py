"""What disturbs a rig, learnt anew: unknown forces begin, grow and cease long after the first fit.

Two occasions. A steady record is searched for forces too small to show in one window: after a start, then seldom; and
while forces are assumed, once a window would be likelier with far weaker or stronger ones. And trouble that lasts as
long as such a record, windows that no parameters explain or each other ones, without a sensor to blame, is calibrated
as at a first start: forces under which it leaves the parameters what they were, and nothing that any suspect explains,
are assumed from then on. A rig on which parameters go to and fro meanwhile does not wear: its windows are no estimates.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.lacking import MOST, Lacking
from agent.numerics.estimator.window_settings import WindowSettings
from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.model.observer import Noise
from agent.numerics.window.hops import Segment
from agent.numerics.window.reference import Reference
from agent.numerics.window.rows import Rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
RECORD_WINDOWS, RECORD_SAMPLES = 10, 20_000
"""The record on which unknown forces are searched: ten windows, but no more than this."""
LOOK, NEWEST = 262_144, 4096
"""Samples between two looks at forces that are assumed, and the newest ones of a window that a look takes."""
SEARCH = 4_194_304
"""Samples between two searches where none are assumed: a search costs as much as half a million samples."""
AGAIN, MOST_CALIBRATIONS = 1.5, 20
"""How much longer trouble must have lasted at the next calibration, and how often that grows."""
PATIENCE = 2
"""Windows without trouble after which it is over: one that is moved by forces may pass by chance."""
TURNS, BACK = 3, 0.5
"""Times that some parameter goes back before a rig is restless, by how much of the way that it came at least."""
NEVER = -(10**18)


@dataclass(slots=True)
class Trouble:
    """Windows that no parameters explain, or each other ones.

    Attributes:
        since, newest: newest samples of the first of them and of the last.
        past: what the windows before said.
        steps: (q,) how far each parameter went last; what is small beside that only refines it.
        turns: how often some went back.
        restless_since: newest sample of the window at which that was too often.
        calibrations: how often this was calibrated.
        forces: disturbances that explain it; None where none are known.
    """

    since: int
    newest: int
    past: Reference
    steps: FloatArray
    turns: int = 0
    restless_since: int = -NEVER
    calibrations: int = 0
    forces: Noise | None = None


class Relearning:
    """When a rig's disturbances are learnt anew, and the record that takes.

    Attributes:
        record: samples on which unknown forces are searched at most.
        searched: a steady record has been searched, or there is nothing to search for.
        calibrated_at: newest sample of the trouble that was calibrated last.
    """

    def __init__(self, settings: WindowSettings) -> None:
        self._possible = settings.gains.disturbance is not None
        self.record = min(RECORD_WINDOWS * settings.plan.window, RECORD_SAMPLES)
        self._patience = PATIENCE * settings.plan.window
        self._doubted = self._looked = self.calibrated_at = NEVER
        self._trouble = Trouble(NEVER, NEVER, Reference.empty(0), np.zeros(0))
        self.searched = not self._possible
        self._in_doubt = self._possible

    def begin(self, *, searched: bool) -> None:
        """Begin with disturbances that an earlier run knew, or that nobody knows: search the first steady record."""
        self.searched = searched or not self._possible
        self._doubted, self._in_doubt = NEVER, not self.searched

    def due(self, index: IntArray | int, steady_since: int) -> BoolArray:
        """(N,) samples number `index` at which a rig that is steady since another one has the record for a search."""
        return np.asarray(self._in_doubt & (index - max(steady_since, self._doubted) >= self.record))

    def wants(self, index: int) -> int:
        """Samples before number `index` that a search may yet need."""
        if self._in_doubt:
            return self.record
        return min(index - self._trouble.since, self.record) if self._possible and self._lasts(index) else 0

    def look(self, point: WorkingPoint, segment: Segment, lacking: Lacking, rows: Rows, row: int) -> None:
        """Doubt the forces that are assumed where the window of a healthy row would be likelier with others."""
        index = int(rows.index[row])
        if not self._possible or self._in_doubt or index - self._looked < (LOOK if point.noise.forced else SEARCH):
            return
        self._looked, self._doubted = index, index
        v = segment.samples(index + 1 - min(point.settings.plan.window, NEWEST), index + 1)
        theta = np.where(np.isfinite(rows.theta[row]), rows.theta[row], point.theta)
        problem = point.problem(v, lacking.bridge(v, index + 1))
        try:
            self._in_doubt = not point.noise.forced or point.calibrator.doubts(problem, theta, point.noise)
        except ValueError:
            self._in_doubt = True  # a fit left the numbers: the longer record may tell

    def search(self, point: WorkingPoint, segment: Segment, lacking: Lacking, stop: int) -> Noise | None:
        """Search the record that ends before sample `stop`; return the disturbances that explain it better, or None."""
        self.searched, self._in_doubt, self._looked = True, False, stop - 1
        v = self._samples(segment, stop)
        try:
            return point.calibrator.forces_in(point.problem(v, lacking.bridge(v, stop)), point.theta, point.noise)
        except ValueError:
            return None  # a record that leads a fit out of the numbers says nothing of forces

    def suffer(self, index: int, past: Reference) -> None:
        """Take the newest sample of a window in trouble; past is what the windows before it said."""
        if not self._lasts(index):
            self._trouble = Trouble(index, index, past, np.zeros(len(past.b)))
        self._trouble.newest = index

    def move(self, index: int, step: FloatArray, least: FloatArray, past: Reference) -> None:
        """Take a step (q,) of the parameters at sample `index`: trouble where some went by more than `least` (q,)."""
        far = np.abs(step) > least
        if not far.any():
            return
        self.suffer(index, past)
        trouble = self._trouble
        went = far & (np.abs(step) >= BACK * np.abs(trouble.steps))
        trouble.turns += bool(np.any(went & (step * trouble.steps < 0)))
        trouble.steps = np.where(went, step, trouble.steps)
        if trouble.turns == TURNS:
            trouble.restless_since = min(trouble.restless_since, trouble.newest)

    def restless(self, index: IntArray) -> BoolArray:
        """(N,) samples number `index` at which parameters go to and fro."""
        trouble = self._trouble
        return np.asarray((index >= trouble.restless_since) & (index <= trouble.newest + self._patience))

    def _lasts(self, index: int) -> bool:
        return index - self._trouble.newest <= self._patience

    def due_in_trouble(self, index: int) -> bool:
        """Tell whether trouble has lasted for a record, then for half as long again, and so on."""
        lasting = index - self._trouble.since if self._lasts(index) else 0
        return self._possible and lasting >= self.record * AGAIN**self._trouble.calibrations

    @property
    def forces(self) -> Noise | None:
        """Disturbances that explain the trouble there is; None where none are known."""
        return self._trouble.forces

    def calibrate(self, point: WorkingPoint, segment: Segment, lacking: Lacking, stop: int) -> None:
        """Calibrate the trouble up to sample `stop` as at a first start.

        What explains it with the parameters that the rig had before stands in forces then, what else was found in
        point.wrong and point.mistake.
        """
        trouble, self.calibrated_at = self._trouble, stop - 1
        trouble.calibrations = min(trouble.calibrations + 1, MOST_CALIBRATIONS)
        v = self._samples(segment, stop)
        if lacking.count(np.array([stop - 1]), len(v))[0] > MOST * len(v) or not np.isfinite(v).all():
            return
        try:
            trouble.forces = point.recalibrated(point.problem(v, lacking.bridge(v, stop)), trouble.past)
        except ValueError:
            trouble.forces = None

    def end_trouble(self) -> None:
        """Begin anew with disturbances that explain it."""
        self._trouble = Trouble(NEVER, NEVER, self._trouble.past, self._trouble.steps)

    def _samples(self, segment: Segment, stop: int) -> FloatArray:
        return segment.samples(max(segment.first, stop - self.record), stop)
