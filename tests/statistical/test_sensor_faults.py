"""A sensor that goes wrong is named, or nobody is; no sound spring is blamed for it (200 runs under soak)."""

import numpy as np
import pytest

from tests.statistical.machine import each, say
from tests.statistical.sensor_faults import FAULTS, Blame, one

QUICK, FULL = 3, 200


def assess(kind: str, found: list[Blame], request: pytest.FixtureRequest) -> None:
    named = [run for run in found if run.right and run.sensors]
    wrong = [
        f"run {run.seed}: {run.channel} {run.sensors} {run.parameters}" for run in found if not run.right
    ]
    blamed = [run for run in found if run.parameters]
    delays = [run.delay for run in named if run.delay is not None]
    say(
        request,
        f"{kind}, {len(found)} runs: the right sensor named in {len(named)}, "
        f"after {np.median(delays) / 1000:.2f} s in the median, "
        f"nobody in {sum(not run.sensors and run.right for run in found)}, a sound spring or damper "
        f"alarmed in {len(blamed)}; wrong: {'; '.join(wrong) or 'none'}",
    )
    assert len(wrong) <= 0.05 * len(found)
    assert len(blamed) <= 0.01 * len(found)


@pytest.mark.parametrize("kind", FAULTS)
def test_verdict_on_a_faulty_sensor_is_right(kind: str, request: pytest.FixtureRequest) -> None:
    assess(kind, each(one, [(kind, seed) for seed in range(QUICK)]), request)


@pytest.mark.soak
@pytest.mark.parametrize("kind", FAULTS)
def test_verdict_on_a_faulty_sensor_is_right_in_200_runs(kind: str, request: pytest.FixtureRequest) -> None:
    assess(kind, each(one, [(kind, 10_000 + seed) for seed in range(FULL)]), request)
