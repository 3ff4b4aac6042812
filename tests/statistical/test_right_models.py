"""Right models: errors at the Cramer-Rao bound, intervals that hold from the first window on, no wider than
due."""

import numpy as np
import pytest

from tests.statistical.machine import each, say
from tests.statistical.right_models import WINDOWS, Errors, errors

QUICK, FULL = (1, 2, 3, 10), 30
FIRST_SEED = 6000
SETTLED = 10
"""Windows after which intervals are compared with the bound."""


def hold(found: list[Errors], share: tuple[float, float], request: pytest.FixtureRequest) -> None:
    error, held, valid = (
        np.concatenate([getattr(e, part).ravel() for e in found]) for part in ("error", "held", "valid")
    )
    rmse = float(np.sqrt(np.mean(error**2)))
    first = np.concatenate([e.held[0] for e in found])
    late = np.concatenate([e.sd[SETTLED:].ravel() for e in found])
    text = (
        f"{len(found)} random rigs of {WINDOWS} windows: RMSE / bound {rmse:.3f}, "
        f"{100 * held.mean():.1f} % of"
    )
    text += f" {held.size} intervals hold ({100 * first.mean():.0f} % of {first.size} of first windows)"
    say(request, f"{text}, sd / bound after {SETTLED} windows {np.median(late):.3f} (mean {late.mean():.3f})")
    assert valid.mean() >= 0.99
    assert 0.9 <= rmse <= 1.1
    assert share[0] <= held.mean() <= share[1]
    # the parameters of one window err together: what counts is windows, not intervals
    assert first.mean() >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(found))
    assert np.median(late) <= 1.05


def test_random_rigs_reach_the_bound_and_say_so(request: pytest.FixtureRequest) -> None:
    hold([errors(seed) for seed in QUICK], (0.93, 0.99), request)


@pytest.mark.soak
def test_thirty_random_rigs_reach_the_bound_and_say_so(request: pytest.FixtureRequest) -> None:
    hold(each(errors, range(FIRST_SEED, FIRST_SEED + FULL)), (0.93, 0.97), request)
