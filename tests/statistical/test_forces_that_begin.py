"""Unknown forces that begin long after the first fit are learnt after ten windows; nothing else is taken for
them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from agent.records import HealthEvent, Record
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status
from tests.statistical.detection import pipeline, records
from tests.statistical.machine import NOMINAL, SECOND, Machine, each, on_second, say
from tests.statistical.operation import NOISE_M, drive

SETTLE, BEFORE, LASTS = 10 * SECOND, 6 * SECOND, 30 * SECOND
LEARNT = 13 * SECOND
"""A record of ten windows, and three more."""
QUICK, FULL = 1, 100
STRONG_N = 0.5
WEIGHTS = {"m1": (1.0, 0.0), "both": (0.7, 0.7)}


def pushed(rng: np.random.Generator, weights: tuple[float, float], after: int = 0) -> FloatArray:
    """Readings (N, 3) of a healthy rig on whose masses white forces that nobody measures act from BEFORE to
    LASTS."""
    samples = SETTLE + BEFORE + LASTS + after + 1
    force = drive(rng, samples)
    unknown = STRONG_N * rng.standard_normal((samples, 2)) * weights
    unknown[: SETTLE + BEFORE] = unknown[SETTLE + BEFORE + LASTS :] = 0.0
    y = Machine.at_rest().play(on_second(force) + unknown)[SETTLE:, :2]
    return np.column_stack([force[SETTLE:-1], y + NOISE_M * rng.standard_normal(y.shape)])


@dataclass(frozen=True, slots=True)
class Rows:
    """All rows of a run: sample (N,), status, whether the interval holds the truth, and sd (N, 4)."""

    index: FloatArray
    status: FloatArray
    holds: FloatArray
    sd: FloatArray

    @property
    def valid(self) -> FloatArray:
        return self.status == Status.VALID

    @classmethod
    def of(cls, found: list[Record]) -> "Rows":
        batches = [r for r in found if isinstance(r, EstimateBatch)]
        parts = ("index", "status", "lower", "upper", "sd")
        index, status, lower, upper, sd = (np.concatenate([getattr(b, p) for b in batches]) for p in parts)
        return cls(index, status, (lower <= NOMINAL) & (upper >= NOMINAL), sd)


@dataclass(frozen=True, slots=True)
class Run:
    """What came of a run after the forces had been learnt: share of rows that are understood (valid, or
    unexcited where the forces hide a parameter), disjoint windows that are valid and that hold the truth
    (4,); and what was alarmed."""

    understood: float
    valid: FloatArray
    hold: FloatArray
    alarms: int


def learnt(job: tuple[str, int]) -> Run:
    where, seed = job
    found = records(pipeline(), pushed(np.random.default_rng([seed, 31]), WEIGHTS[where]))
    rows = Rows.of(found)
    late = rows.index >= BEFORE + LEARNT
    apart = late & ((rows.index + 1) % SECOND == 0)
    return Run(
        float(np.isin(rows.status[late], (Status.VALID, Status.UNEXCITED)).mean()),
        rows.valid[apart].sum(axis=0),
        (rows.valid & rows.holds)[apart].sum(axis=0),
        sum(isinstance(r, AlarmTransition) for r in found),
    )


def assess(where: str, runs: list[Run], request: pytest.FixtureRequest) -> None:
    understood = 100 * float(np.mean([run.understood for run in runs]))
    valid, hold = (sum(float(getattr(run, part).sum()) for run in runs) for part in ("valid", "hold"))
    alarms = sum(run.alarms > 0 for run in runs)
    say(
        request,
        f"forces of {STRONG_N:g} N on {where} that begin, {len(runs)} runs: "
        f"after 13 windows {understood:.1f} % of the rows understood, "
        f"{100 * hold / valid:.1f} % of {valid:.0f} intervals hold the truth, alarms in {alarms}",
    )
    assert understood >= 98.0
    assert hold >= 0.90 * valid
    assert alarms <= 0.02 * len(runs)


@pytest.mark.parametrize("where", WEIGHTS)
def test_forces_that_begin_are_learnt_after_ten_windows(where: str, request: pytest.FixtureRequest) -> None:
    assess(where, each(learnt, [(where, seed) for seed in range(QUICK)]), request)


@pytest.mark.parametrize(
    "job",
    [("m1", 1008), ("m1", 1027), ("m1", 1048), ("both", 1024),
     pytest.param(("both", 1008), marks=pytest.mark.soak)],
)  # fmt: skip
def test_forces_that_begin_are_taken_for_no_fault(job: tuple[str, int]) -> None:
    """A joint fit that began at weak forces took these for the slow noise of a sensor, and rows were sure; or
    the parameters were believed to change again and again."""
    where, seed = job
    v = pushed(np.random.default_rng([seed, 31]), WEIGHTS[where])[: BEFORE + LEARNT]
    assert not [r for r in records(pipeline(), v) if isinstance(r, AlarmTransition)]


@pytest.mark.soak
@pytest.mark.parametrize("where", WEIGHTS)
def test_forces_that_begin_are_learnt_in_100_runs(where: str, request: pytest.FixtureRequest) -> None:
    assess(where, each(learnt, [(where, 1000 + seed) for seed in range(FULL)]), request)


def test_forces_that_cease_are_forgotten() -> None:
    v = pushed(np.random.default_rng(5), WEIGHTS["m1"], after=100 * SECOND)
    rows = Rows.of(records(pipeline(), v))
    sd = {when: np.median(rows.sd[(rows.index >= at) & (rows.index < at + 5 * SECOND)], axis=0)
          for when, at in {"healthy": SECOND, "forced": LASTS,
                           "after": len(v) - 5 * SECOND}.items()}  # fmt: skip
    assert (sd["forced"] > 2.0 * sd["healthy"])[[0, 2]].all()
    assert (sd["after"] < 1.25 * sd["healthy"]).all()


def never_zeroed(v: FloatArray) -> None:
    v[BEFORE:, 1] += 5.0 * NOISE_M


def read_late(v: FloatArray) -> None:
    v[BEFORE:, 2] = v[BEFORE - 40 : -40, 2]


SPOILT: dict[str, tuple[Callable[[FloatArray], None], str]] = {
    "an offset": (never_zeroed, "x1"),
    "a delay": (read_late, "x2 comes 40"),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_channel_that_goes_wrong_for_long_is_not_taken_for_forces(kind: str) -> None:
    spoil, words = SPOILT[kind]
    rng = np.random.default_rng(8)
    v = pushed(rng, (0.0, 0.0))[: BEFORE + 17 * SECOND]
    spoil(v)
    found = records(pipeline(), v)
    rows = Rows.of(found)
    assert not rows.valid[rows.index >= BEFORE + 1.1 * SECOND].any()
    reported = [r.message for r in found if isinstance(r, HealthEvent) and r.source == "model"]
    reported += [str(r.parameter) for r in found if isinstance(r, AlarmTransition)]
    assert any(words in message for message in reported), reported
