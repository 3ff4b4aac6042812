"""A spring that steps by 15 %: alarmed in time, and nothing else blamed (500 runs under soak)."""

import numpy as np
import pytest

from tests.statistical.detection import WITHIN, Verdict, verdict
from tests.statistical.machine import each, say

QUICK, FULL = 12, 500


def summary(found: list[Verdict]) -> tuple[float, float, str]:
    """Shares of runs detected in time and of runs in which something else was blamed, and both in words."""
    delays = [run.delay for run in found if run.delay is not None]
    missed = [f"run {run.seed}: {run.spring} x {run.factor:g}" for run in found if run.delay is None]
    blamed = [f"run {run.seed}: {', '.join(run.blamed)}" for run in found if run.blamed]
    detected = len(delays) / len(found)
    text = (
        f"{len(found)} steps of 15 %: {100 * detected:.1f} % alarmed within {WITHIN / 1000:g} s, "
        f"median {np.median(delays) / 1000:.2f} s, 99 % {np.quantile(delays, 0.99) / 1000:.2f} s; "
        f"missed: {'; '.join(missed) or 'none'}; blamed: {'; '.join(blamed) or 'none'}"
    )
    return detected, len(blamed) / len(found), text


def test_detection_of_a_15_percent_step_is_timely_and_blames_nothing_else(
    request: pytest.FixtureRequest,
) -> None:
    detected, blamed, text = summary(each(verdict, range(QUICK)))
    say(request, text)
    assert detected >= 0.98
    assert blamed <= 0.01


@pytest.mark.soak
def test_detection_in_500_runs_is_timely_and_blames_nothing_else(request: pytest.FixtureRequest) -> None:
    detected, blamed, text = summary(each(verdict, range(10_000, 10_000 + FULL)))
    say(request, text)
    assert detected >= 0.98
    assert blamed <= 0.01
