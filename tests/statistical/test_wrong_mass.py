"""A mass that the configuration has wrong by 20 % is named; nothing else is blamed, and a right one is not
accused."""

import numpy as np
import pytest

from tests.statistical.machine import MASSES, each, say
from tests.statistical.wrong_mass import NOISES, Job, Said, one

SHARES = (0.8, 1.2)
QUICK, FULL = 1, 25


def wrong(seeds: range, noises: range = range(len(NOISES))) -> list[Job]:
    return [
        Job(mass, share, noise, s) for mass in MASSES for share in SHARES for noise in noises for s in seeds
    ]


def assess(found: list[Said], request: pytest.FixtureRequest) -> None:
    named, alarmed = sum(run.named for run in found), [run.job for run in found if run.alarms]
    valid = 100 * np.mean([run.valid for run in found])
    odd = [(run.job, run.advice) for run in found if not run.named]
    say(
        request,
        f"a mass wrong by 20 %, {len(found)} runs: named with its size in {named}, "
        f"{valid:.1f} % of rows valid, an alarm in {len(alarmed)}; otherwise: {odd or 'none'}",
    )
    assert named >= 0.95 * len(found)
    assert not alarmed
    assert valid >= 97.0


def judge_right(found: list[Said], request: pytest.FixtureRequest) -> None:
    accused = [(run.job, run.advice) for run in found if run.advice]
    valid = 100 * np.mean([run.valid for run in found])
    say(
        request,
        f"right masses, {len(found)} runs: something accused in {len(accused)}; "
        f"{valid:.1f} % valid {accused}",
    )
    assert len(accused) <= 0.01 * len(found)
    assert valid >= 99.0


def right(seeds: range) -> list[Job]:
    return [Job(None, 1.0, noise, seed) for noise in range(len(NOISES)) for seed in seeds]


def test_wrong_mass_is_named_and_nothing_alarmed(request: pytest.FixtureRequest) -> None:
    assess(each(one, wrong(range(QUICK), range(1))), request)


def test_right_mass_is_not_accused(request: pytest.FixtureRequest) -> None:
    judge_right(each(one, right(range(3))), request)


@pytest.mark.soak
def test_wrong_mass_is_named_and_nothing_alarmed_in_300_runs(request: pytest.FixtureRequest) -> None:
    assess(each(one, wrong(range(10_000, 10_000 + FULL))), request)


@pytest.mark.soak
def test_right_mass_is_not_accused_in_300_runs(request: pytest.FixtureRequest) -> None:
    judge_right(each(one, right(range(10_000, 10_000 + 4 * FULL))), request)
