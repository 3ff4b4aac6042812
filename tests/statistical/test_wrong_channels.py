"""A channel that is wrong from the first sample on is said so; a sound spring is never reported, nor alarmed."""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from agent.blocks.advice import SOURCE as MODEL
from agent.types import AlarmTransition, EstimateBatch, FloatArray, HealthEvent, Status
from tests.statistical.detection import pipeline, records
from tests.statistical.machine import SECOND, each, say
from tests.statistical.operation import FULL_SCALE_M
from tests.statistical.sensor_faults import healthy

SAMPLES = 3 * SECOND


def offset(share: float) -> Callable[[FloatArray], None]:
    def spoil(v: FloatArray) -> None:
        v[:, 1] += share * FULL_SCALE_M

    return spoil


def turned(v: FloatArray) -> None:
    v[:, 1] *= -1.0


def exchanged(v: FloatArray) -> None:
    v[:, [1, 2]] = v[:, [2, 1]]


def late(v: FloatArray) -> None:
    v[20:, 1] = v[:-20, 1].copy()


def scaled(v: FloatArray) -> None:
    v[:, 2] *= 1.2


def times(factor: float, *channels: int) -> Callable[[FloatArray], None]:
    def spoil(v: FloatArray) -> None:
        v[:, channels] *= factor

    return spoil


WRONG: dict[str, tuple[Callable[[FloatArray], None], str]] = {
    "offset 0.3": (offset(0.3), "x1 reads 0.02"),
    "offset -3": (offset(-3.0), "x1 reads 0.2"),
    "turned": (turned, "x1 looks turned round"),
    "exchanged": (exchanged, "x1 and x2 look exchanged"),
    "late": (late, "x1 comes "),
    "scaled": (scaled, "x2 reads 1."),
    "mm against m": (times(1000.0, 1), r"x1 reads (1000|99\d|10[01]\d) times"),
    "m against mm": (times(0.001, 2), r"x2 reads 0\.00(1|099\d|10\d) times"),
    "kilograms of force": (times(9.80665, 0), r"force reads 9\.\d+ times"),
    "both in mm": (times(1000.0, 1, 2), r"all that moves reads (1000|99\d|10[01]\d) times"),
}


@dataclass(frozen=True, slots=True)
class Said:
    """What came of a run: words about the model, how many rows were valid, how many alarms were raised."""

    words: tuple[str, ...]
    valid: int
    alarms: int


def one(job: tuple[str, int]) -> Said:
    kind, seed = job
    v = healthy(np.random.default_rng([seed, 31]), SAMPLES)
    WRONG[kind][0](v)
    return said(v)


def said(v: FloatArray) -> Said:
    found = records(pipeline(), v)
    rows = [r.status for r in found if isinstance(r, EstimateBatch)]
    return Said(
        tuple(r.message for r in found if isinstance(r, HealthEvent) and r.source == MODEL),
        int(np.sum(np.vstack(rows) == Status.VALID)),
        sum(isinstance(r, AlarmTransition) and r.to_state == "UNACK" for r in found),
    )


def assess(kinds: list[str], seeds: range, request: pytest.FixtureRequest, least: float) -> None:
    jobs = [(kind, seed) for kind in kinds for seed in seeds]
    found = each(one, jobs)
    right = [bool(re.search(WRONG[kind][1], " ".join(run.words))) for (kind, _), run in zip(jobs, found, strict=True)]
    odd = [(job, run) for job, run, named in zip(jobs, found, right, strict=True) if not named]
    alarms, valid = sum(run.alarms for run in found), sum(run.valid for run in found)
    say(request, f"a wrong channel, {len(jobs)} runs: named in {sum(right)}, {valid} rows valid, {alarms} alarms {odd}")
    assert valid == 0
    assert alarms == 0
    assert sum(right) >= least * len(jobs)


def test_channel_that_is_wrong_from_the_start_is_named_and_no_row_is_valid(request: pytest.FixtureRequest) -> None:
    assess(list(WRONG), range(1), request, 0.99)


@pytest.mark.parametrize("channel", [1, 2])
def test_channel_that_never_moves_is_named_for_that_alone(channel: int) -> None:
    v = healthy(np.random.default_rng([0, 31]), SAMPLES)
    v[:, channel] = 0.0
    found = said(v)
    assert [re.match(f"x{channel} stood at 0 m all through", words) is not None for words in found.words] == [True]
    assert (found.valid, found.alarms) == (0, 1)


@pytest.mark.soak
def test_channel_that_is_wrong_from_the_start_is_named_in_150_runs(request: pytest.FixtureRequest) -> None:
    assess(list(WRONG), range(100, 125), request, 0.9)
