"""No alarm in days of normal operation, in the configuration and at the noise of the detection tests."""

import resource

import numpy as np
import pytest

from tests.statistical.machine import each, say
from tests.statistical.operation import FULL_SCALE_M
from tests.statistical.rig_day import DAY, Shift, shift

QUARTER, SHORT = DAY // 4, DAY // 64


def quarter(seed: int) -> Shift:
    return shift(seed, QUARTER)


def short(seed: int) -> Shift:
    return shift(seed, SHORT)


def assess(found: list[Shift], request: pytest.FixtureRequest) -> None:
    days = sum(part.samples for part in found) / DAY
    alarms = [alarm for part in found for alarm in part.alarms]
    _, valid, unexcited, invalid = np.mean([part.shares for part in found], axis=0)
    # no event in so many days: three over them is the 95 % bound of a Poisson rate
    say(
        request,
        f"{days:.2f} rig-days of normal operation: {len(alarms)} alarms {alarms[:5]} (with 95 % confidence "
        f"fewer than {3.0 / days:.2g} a day if none), "
        f"largest displacement {1e3 * max(part.peak for part in found):.0f} mm; "
        f"rows {100 * valid:.1f} % valid, {100 * unexcited:.1f} % unexcited, {100 * invalid:.2f} % invalid",
    )
    assert not alarms
    assert max(part.peak for part in found) <= 1.05 * FULL_SCALE_M
    assert valid > 0.8


@pytest.mark.timeout(480)
def test_false_alarms_in_45_minutes_of_normal_operation_are_none(request: pytest.FixtureRequest) -> None:
    assess(each(short, range(2)), request)


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_false_alarms_in_half_a_rig_day_of_normal_operation_are_none(request: pytest.FixtureRequest) -> None:
    assess(each(quarter, range(2)), request)


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_false_alarms_in_30_rig_days_of_normal_operation_are_none(request: pytest.FixtureRequest) -> None:
    assess(each(quarter, range(1000, 1120)), request)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    say(request, f"largest process {spent:.0f} MB")
