"""How much the bank is given at once: what is likely to be thrown away waits."""

import numpy as np
import pytest

from agent.numerics.estimator.bank import Bank
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.numerics.window.rows import BankRows
from tests.unit.numerics.estimator.test_sliding import SIGMA, settings
from tests.unit.numerics.rigs import noisy

HOP, SAMPLES = 50, 70_000
MOST_BEHIND = 400
"""Hops: what three calls cost."""


def test_rows_far_behind_a_window_that_is_learnt_from_next_wait_until_it_was(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    calls: list[tuple[int, BankRows]] = []
    ask = Bank.next

    def watched(bank: Bank, record: Record, due: int) -> BankRows | None:
        rows = ask(bank, record, due)
        if rows is not None and len(rows.index):
            calls.append((due, rows))
        return rows

    monkeypatch.setattr(Bank, "next", watched)
    samples = noisy(rng, SAMPLES, SIGMA)
    SlidingEstimator(settings(1000, HOP, SIGMA)).step(0, samples.y, samples.u)
    reaching = [(due, rows) for due, rows in calls if rows.index[0] <= due]
    assert reaching
    assert all(rows.index[-1] <= due + MOST_BEHIND * HOP for due, rows in reaching)
