"""What is begun beside the rows is bounded by construction, in work that is counted and not timed."""

from agent.numerics.estimator.schedule import Budget
from agent.numerics.fitting.fit import WORK
from agent.numerics.fitting.tuning import EVALUATION


def test_budget_allows_until_it_is_spent_and_again_when_samples_have_paid() -> None:
    budget = Budget(1000.0, 2.0)
    assert budget.allows(0)
    before = WORK.done
    WORK.evaluate(500)
    budget.spend(WORK.done - before)
    assert EVALUATION + 500 > 1000
    assert not budget.allows(10)
    assert not budget.allows((EVALUATION + 500 - 1000) // 2)
    assert budget.allows((EVALUATION + 500 - 1000) // 2 + 1)
    budget.close()
    assert not budget.allows(10**9)
