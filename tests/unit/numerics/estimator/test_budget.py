"""What is begun beside the rows is bounded by construction, in work that is counted and not timed."""

from pathlib import Path

import numpy as np
import pytest

from agent.blocks.contained_estimator import ContainedEstimator
from agent.config import load
from agent.numerics.estimator.window_ml import EVALUATIONS, RATE, WindowML
from agent.numerics.fitting.work import EVALUATION, WORK, Budget
from agent.runtime.methods import make_estimation
from tests.scenario.live import example
from tests.unit.numerics.rigs import Record, noisy

RIGHT = ("nominal = 25.0", "nominal = 100.0")


def test_budget_allows_until_it_is_spent_and_again_when_samples_have_paid() -> None:
    budget = Budget(1000.0, 2.0)
    assert budget.allows(0)
    before = WORK.done
    WORK.evaluate(500)
    budget.spend(before)
    assert EVALUATION + 500 > 1000
    assert not budget.allows(10)
    assert not budget.allows((EVALUATION + 500 - 1000) // 2)
    assert budget.allows((EVALUATION + 500 - 1000) // 2 + 1)
    budget.close()
    assert not budget.allows(10**9)


def worked(folder: Path, samples: Record, *, wrong: bool) -> tuple[list[int], WindowML]:
    """Work done in each third of a record, by a rig as it is, or with all springs taken for 1 N/m."""
    path = example("modbus", folder)
    text = path.read_text(encoding="utf-8")
    for right in RIGHT:
        assert right in text
        text = text.replace(right, "nominal = 1.0") if wrong else text
    path.write_text(text, encoding="utf-8")
    contained, done = make_estimation(load(path), np.full(2, 2e-6)).estimator, []
    assert isinstance(contained, ContainedEstimator)
    ml = contained.estimator
    assert isinstance(ml, WindowML)
    third = len(samples.y) // 3
    for start in range(0, len(samples.y), third):
        before = WORK.done
        for first in range(start, start + third, 1000):
            ml.step(first, samples.y[first : first + 1000], samples.u[first : first + 1000])
        done.append(WORK.done - before)
    return done, ml


@pytest.fixture(scope="module")
def samples() -> Record:
    return noisy(np.random.default_rng(1), 30_000, 1e-6)


def test_hopeless_rig_costs_a_bounded_work_a_sample_for_ever(samples: Record, tmp_path: Path) -> None:
    """Without the budget it was 467 a sample, by 20 s of samples."""
    done, ml = worked(tmp_path, samples, wrong=True)
    capital = EVALUATIONS * (EVALUATION + 2500)
    last = 1_500_000  # what was begun is finished: a calibration of ten windows
    assert sum(done) <= capital + 30_000 * RATE + last
    assert done[-1] <= 10_000 * RATE + last
    assert not ml.point.settled
    ml.hurry()
    before = WORK.done
    ml.step(30_000, samples.y[:5000], samples.u[:5000])
    assert WORK.done == before


def test_right_rig_is_given_all_that_it_asks_for(samples: Record, tmp_path: Path) -> None:
    _, ml = worked(tmp_path, samples, wrong=False)
    assert ml.budget.allows(30_000)
    assert ml.point.settled
