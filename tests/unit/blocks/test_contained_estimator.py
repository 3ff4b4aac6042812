"""A method that raises is made anew: the window that failed has rows with a reason, all others their estimates."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from agent.blocks.contained_estimator import ContainedEstimator
from agent.blocks.estimation import BoolArray
from agent.numerics.faults.suspects import Accusation
from agent.numerics.fitting.work import Budget
from agent.numerics.window.hops import HopPlan
from agent.numerics.window.rows import Rows
from agent.types import Calibrated, FloatArray

PLAN = HopPlan(window=20, hop=10)


@dataclass
class Fragile:
    """A method that raises whenever it sees sample number `bad`."""

    bad: int
    error: Exception
    adopted: list[Calibrated] = field(default_factory=list)
    spikes: int = 0
    budget: Budget = field(default_factory=lambda: Budget(1.0, 0.0))

    def start_segment(self) -> None: ...

    def calibrated(self) -> Calibrated | None:
        return None

    def adopt(self, known: Calibrated) -> None:
        self.adopted.append(known)

    def hurry(self) -> None: ...

    def take_findings(self) -> list[tuple[int, Accusation]]:
        return []

    def step(
        self, index: int, y: FloatArray, _u: FloatArray, missing: BoolArray | None = None,
        _suspect: BoolArray | None = None,
    ) -> Rows:  # fmt: skip
        assert missing is None or len(missing) == len(y)
        if index <= self.bad < index + len(y):
            raise self.error
        self.spikes += 1
        rows = Rows.warming(PLAN.rows_between(index, index + len(y)), 2)
        rows.full[:], rows.theta[:], rows.sd[:] = True, 1.0, 0.1
        return rows


def contained(bad: int, error: Exception) -> ContainedEstimator:
    return ContainedEstimator(lambda: Fragile(bad, error), PLAN, q=2)


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("no SVD"), ValueError("no gain"), OverflowError("too far")])
def test_contained_estimator_numerical_failure_marks_its_window_and_no_other(error: Exception) -> None:
    estimator = contained(47, error)
    missing = np.zeros((100, 2), dtype=bool)
    rows = estimator.step(0, np.zeros((100, 1)), np.zeros((100, 1)), missing)
    assert rows.index.tolist() == list(range(9, 100, 10))
    assert rows.index[rows.diverged].tolist() == [49, 59]
    assert np.all(rows.full == ~rows.diverged)
    assert estimator.take_failures() == [(99, f"{type(error).__name__}: {error}")]
    assert estimator.take_failures() == []


def test_contained_estimator_made_anew_begins_with_what_was_adopted_and_keeps_its_counts() -> None:
    estimator = contained(47, ValueError("no gain"))
    known = Calibrated((1e-6,), (0.0,), (1.0,), searched=True)
    estimator.adopt(known)
    estimator.step(0, np.zeros((20, 1)), np.zeros((20, 1)))
    estimator.step(40, np.zeros((20, 1)), np.zeros((20, 1)))
    assert isinstance(estimator.estimator, Fragile)
    assert estimator.estimator.adopted == [known]
    assert estimator.spikes == 1


def test_contained_estimator_fault_of_the_program_passes_on() -> None:
    with pytest.raises(KeyError):
        contained(3, KeyError("a fault")).step(0, np.zeros((20, 1)), np.zeros((20, 1)))


def test_contained_estimator_made_anew_has_no_more_to_spend_than_was_left() -> None:
    made: list[Fragile] = []

    def make() -> Fragile:
        made.append(Fragile(25, ValueError("planted")))
        return made[-1]

    contained = ContainedEstimator(make, PLAN, 2)
    contained.hurry()
    contained.step(0, np.zeros((60, 1)), np.zeros((60, 1)))
    assert len(made) > 1
    assert all(one.budget is contained.budget for one in made)
    assert not made[-1].budget.allows(60)
