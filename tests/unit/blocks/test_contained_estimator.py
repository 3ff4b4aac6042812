"""A method that raises is made anew: the window that failed has rows with a reason, all others their
estimates."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from agent.blocks.contained_estimator import ContainedEstimator
from agent.numerics.estimator.outcome import Outcome
from agent.numerics.estimator.schedule import Budget, budget_of
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import BoolArray, FloatArray, Reason, Status

PLAN = HopPlan(window=20, hop=10)


@dataclass
class Fragile:
    """A method that raises whenever it sees sample number `bad`."""

    bad: int
    error: Exception
    adopted: list[str] = field(default_factory=list)
    spikes: int = 0
    budget: Budget = field(default_factory=lambda: budget_of(20, 1e-3))

    def start_segment(self) -> None: ...

    def knowledge(self) -> str | None:
        return None

    def adopt(self, content: str) -> None:
        self.adopted.append(content)

    def hurry(self) -> None:
        self.budget.close()

    def step(
        self, index: int, y: FloatArray, _u: FloatArray, missing: BoolArray | None = None,
        _suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        assert missing is None or len(missing) == len(y)
        if index <= self.bad < index + len(y):
            raise self.error
        self.spikes += 1
        rows = Outcome.warming(PLAN.rows_between(index, index + len(y)), 2)
        rows.status[:], rows.theta[:], rows.sd[:] = Status.VALID, 1.0, 0.1
        return rows


def contained(bad: int, error: Exception) -> ContainedEstimator:
    return ContainedEstimator(
        lambda budget: Fragile(bad, error, budget=budget), budget_of(20, 1e-3), PLAN, q=2
    )


@pytest.mark.parametrize(
    "error", [np.linalg.LinAlgError("no SVD"), ValueError("no gain"), OverflowError("too far")]
)
def test_contained_estimator_numerical_failure_marks_its_window_and_no_other(error: Exception) -> None:
    estimator = contained(47, error)
    missing = np.zeros((100, 2), dtype=bool)
    rows = estimator.step(0, np.zeros((100, 1)), np.zeros((100, 1)), missing)
    assert rows.index.tolist() == list(range(9, 100, 10))
    diverged = rows.reason[:, 0] == Reason.DIVERGED
    assert rows.index[diverged].tolist() == [49, 59]
    assert np.all(rows.status[diverged] == Status.INVALID)
    assert np.all(rows.status[~diverged] == Status.VALID)
    assert rows.failures == ((99, f"{type(error).__name__}: {error}"),)


def test_contained_estimator_what_is_no_number_is_a_failure_of_its_window_and_in_no_row() -> None:
    class Overflowing(Fragile):
        """What numpy alone would warn of: the square of a number near the largest there is."""

        def step(self, index: int, y: FloatArray, *more: FloatArray | None) -> Outcome:
            rows = Fragile.step(self, index, y, *more)  # type: ignore[arg-type]
            rows.theta[:] = (y**2).max()
            return rows

    estimator = ContainedEstimator(
        lambda budget: Overflowing(-1, KeyError(), budget=budget), budget_of(20, 1e-3), PLAN, q=2
    )
    y = np.ones((100, 1))
    y[47] = 1e200
    rows = estimator.step(0, y, y)
    diverged = rows.reason[:, 0] == Reason.DIVERGED
    assert rows.index[diverged].tolist() == [49, 59]
    assert np.isfinite(rows.theta[~diverged]).all()
    assert rows.failures == ((99, "FloatingPointError: overflow encountered in square"),)


def test_contained_estimator_made_anew_begins_with_what_was_adopted_and_keeps_its_counts() -> None:
    estimator = contained(47, ValueError("no gain"))
    known = '{"learnt": "before"}'
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

    def make(budget: Budget) -> Fragile:
        made.append(Fragile(25, ValueError("planted"), budget=budget))
        return made[-1]

    contained = ContainedEstimator(make, budget_of(20, 1e-3), PLAN, 2)
    contained.hurry()
    contained.step(0, np.zeros((60, 1)), np.zeros((60, 1)))
    assert len(made) > 1
    assert all(one.budget is made[0].budget for one in made)
    assert made[-1].budget.closed
