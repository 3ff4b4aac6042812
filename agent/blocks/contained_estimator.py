"""A numerical failure inside a method costs the rows of a window, with a reason, and never the run.

An estimator that raised is in no state to go on with: a new one takes its place, and the samples of the call go through
it again a window at a time, so that only the window that fails has no estimates. What fails for another reason than its
numbers is a fault of the program and passes on.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field

from agent.blocks.estimation import BoolArray, Estimator
from agent.numerics.faults.suspects import Accusation
from agent.numerics.fitting.work import Budget
from agent.numerics.window.hops import HopPlan
from agent.numerics.window.rows import Rows
from agent.types import Calibrated, FloatArray

NUMERICAL = (ArithmeticError, ValueError)
"""What linear algebra and arithmetic raise; numpy's LinAlgError is a ValueError."""

log = logging.getLogger(__name__)


@dataclass(slots=True)
class ContainedEstimator:
    """An estimator whose numerical failures become rows marked as diverged.

    make: builds it anew. q: its parameters. windows: how many lengths of window each row tells of, 0 for one.
    """

    make: Callable[[], Estimator]
    plan: HopPlan
    q: int
    windows: int = 0
    estimator: Estimator = field(init=False)
    budget: Budget = field(init=False)
    _known: Calibrated | None = None
    _spikes: int = 0
    _failures: list[tuple[int, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.estimator = self.make()
        self.budget = self.estimator.budget

    @property
    def spikes(self) -> int:
        """Samples so far of which nothing but an input was taken for a spike."""
        return self._spikes + self.estimator.spikes

    def start_segment(self) -> None:
        """Forget the samples before a gap."""
        self.estimator.start_segment()

    def hurry(self) -> None:
        """Do nothing but rows from now on; nor does any estimator that takes this one's place."""
        self.budget.close()

    def adopt(self, known: Calibrated) -> None:
        """Begin with what an earlier run knew; so does every estimator that takes this one's place."""
        self._known = known
        self.estimator.adopt(known)

    def calibrated(self) -> Calibrated | None:
        """Return what is known of the rig's disturbances; None while that is nothing to rely on."""
        return self.estimator.calibrated()

    def take_findings(self) -> list[tuple[int, Accusation]]:
        """Return (sample, accusation) of what the model was found to lack since the last call."""
        return self.estimator.take_findings()

    def take_failures(self) -> list[tuple[int, str]]:
        """Return (last sample, what was raised first) of each call that failed since the last one."""
        failures, self._failures = self._failures, []
        return failures

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Rows:  # fmt: skip
        """Take consecutive samples as every estimator does; return the rows they end, failed ones marked."""
        before = self.estimator.spikes
        try:
            return self.estimator.step(index, y, u, missing, suspect)
        except NUMERICAL as error:
            self._failures.append((index + len(y) - 1, f"{type(error).__name__}: {error}"))
            self._renew(index, before, error)
        pieces = []
        for start in range(0, len(y), self.plan.window):
            piece = slice(start, start + self.plan.window)
            doubts = (None if missing is None else missing[piece], None if suspect is None else suspect[piece])
            pieces.append(self._piece(index + start, y[piece], u[piece], *doubts))
        return Rows.joined(pieces, self.q)

    def _piece(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None, suspect: BoolArray | None
    ) -> Rows:
        before = self.estimator.spikes
        try:
            return self.estimator.step(index, y, u, missing, suspect)
        except NUMERICAL as error:
            self._renew(index, before, error)
        rows = Rows.warming(self.plan.rows_between(index, index + len(y)), self.q, self.windows)
        rows.diverged[:] = True
        return rows

    def _renew(self, index: int, spikes: int, error: Exception) -> None:
        """Put a new estimator in the place of one that raised; `spikes` it had counted before."""
        log.debug("the estimator failed at sample %d and is made anew", index, exc_info=error)
        self._spikes += spikes
        self.estimator = self.make()
        self.estimator.budget = self.budget  # what is made anew has not been given more to spend
        if self._known is not None:
            self.estimator.adopt(self._known)
