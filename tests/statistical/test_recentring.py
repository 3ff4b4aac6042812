"""Every parameter jumps to half, 1.5 times or twice its value: the estimator follows, whatever the gain."""

from functools import partial

import numpy as np
import pytest

from agent.types import EstimateBatch, Status
from tests.statistical.chains import TWO
from tests.statistical.machine import each, say
from tests.statistical.nearly_right import KALMAN, POLES, Case, records
from tests.statistical.steps import SETTLE, readings

FACTORS = (0.5, 1.0, 1.5, 2.0)
GAINS = {"auto": "", "kalman": KALMAN, "poles": POLES}
QUICK, FULL = 2, 49
BEFORE, AFTER = 5, 8
"""Windows before and after the jump."""
FOLLOWED = 4
"""Windows after the jump from which on rows have to be right."""


def followed(kind: str, seed: int) -> float:
    """Share of the rows, from FOLLOWED windows after the jump on, that are valid and within 10 % of every
    parameter."""
    rng = np.random.default_rng([seed, 5])
    theta = TWO.theta * rng.choice(FACTORS, 4)
    W = TWO.window
    at = BEFORE * W + int(rng.integers(W))
    v = readings(TWO, rng, at + AFTER * W, [(0, TWO.theta), (at + SETTLE * W, theta)])
    config: dict[str, object] = {"observer": GAINS[kind], "limit_percent": 100.0}
    batches = [r for r in records(Case(config=config), v) if isinstance(r, EstimateBatch)]
    parts = ("index", "value", "status")
    index, value, status = (np.concatenate([getattr(b, part) for b in batches]) for part in parts)
    late = index >= at + FOLLOWED * W
    right = (status[late] == Status.VALID) & (np.abs(value[late] / theta - 1) < 0.1)
    return float(right.all(axis=1).mean())


def hold(kind: str, found: list[float], request: pytest.FixtureRequest) -> None:
    say(
        request,
        f"gain {kind}, {len(found)} jumps of all parameters: {100 * min(found):.0f} % right at the least",
    )
    assert min(found) >= 0.9


@pytest.mark.parametrize("kind", GAINS)
def test_jump_of_all_parameters_is_followed(kind: str, request: pytest.FixtureRequest) -> None:
    hold(kind, [followed(kind, seed) for seed in range(QUICK)], request)


@pytest.mark.soak
@pytest.mark.parametrize("kind", GAINS)
def test_jumps_of_all_parameters_are_followed_in_49_runs(kind: str, request: pytest.FixtureRequest) -> None:
    hold(kind, each(partial(followed, kind), range(1000, 1000 + FULL)), request)
