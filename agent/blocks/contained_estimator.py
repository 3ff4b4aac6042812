"""A numerical failure inside a method costs the rows of a window, with a reason, and never the run.

An estimator that raised is in no state to go on with: a new one takes its place, and the samples of the call
go through it again a window at a time, so that only the window that fails has no estimates. What fails for
another reason than its numbers is a fault of the program and passes on.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from agent.blocks.estimation import Method
from agent.numerics.estimator.outcome import Outcome
from agent.numerics.estimator.schedule import Budget
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import BoolArray, FloatArray, Reason, Status

NUMERICAL = (ArithmeticError, ValueError)
"""What linear algebra and arithmetic raise; numpy's LinAlgError is a ValueError."""

log = logging.getLogger(__name__)


@dataclass(slots=True)
class ContainedEstimator:
    """An estimator whose numerical failures become rows marked as diverged.

    make: builds it anew, to spend what is left of `budget`. plan: its hops and windows. q: its parameters.
    """

    make: Callable[[Budget], Method]
    budget: Budget
    plan: HopPlan
    q: int
    estimator: Method = field(init=False)
    _known: str | None = None
    _spikes: int = 0

    def __post_init__(self) -> None:
        self.estimator = self.make(self.budget)

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

    def adopt(self, content: str) -> None:
        """Begin with what an earlier run learnt; so does every estimator that takes this one's place."""
        self._known = content
        self.estimator.adopt(content)

    def knowledge(self) -> str | None:
        """Return what was learnt; None while that is nothing to rely on."""
        return self.estimator.knowledge()

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        """Take consecutive samples as every estimator does; return the rows they end, failed ones marked."""
        before = self.estimator.spikes
        try:
            return self._stepped(index, y, u, missing, suspect)
        except NUMERICAL as error:
            failure = (index + len(y) - 1, f"{type(error).__name__}: {error}")
            self._renew(index, before, error)
        pieces = []
        for start in range(0, len(y), self.plan.window):
            piece = slice(start, start + self.plan.window)
            doubts = (
                None if missing is None else missing[piece],
                None if suspect is None else suspect[piece],
            )
            pieces.append(self._piece(index + start, y[piece], u[piece], *doubts))
        return replace(Outcome.joined(pieces, self.q), failures=(failure,))

    def _stepped(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None, suspect: BoolArray | None
    ) -> Outcome:
        """Let the estimator work; what is no number or beyond all numbers is raised where it arises."""
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            return self.estimator.step(index, y, u, missing, suspect)

    def _piece(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None, suspect: BoolArray | None
    ) -> Outcome:
        before = self.estimator.spikes
        try:
            return self._stepped(index, y, u, missing, suspect)
        except NUMERICAL as error:
            self._renew(index, before, error)
        rows = Outcome.warming(self.plan.rows_between(index, index + len(y)), self.q)
        rows.status[:], rows.reason[:] = Status.INVALID, Reason.DIVERGED
        return rows

    def _renew(self, index: int, spikes: int, error: Exception) -> None:
        """Put a new estimator in the place of one that raised; `spikes` it had counted before."""
        log.debug("the estimator failed at sample %d and is made anew", index, exc_info=error)
        self._spikes += spikes
        self.estimator = self.make(self.budget)
        if self._known is not None:
            self.estimator.adopt(self._known)
