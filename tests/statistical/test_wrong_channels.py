"""A channel that is wrong from the first sample on: no valid row is wrong, no sound parameter alarmed."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from agent.blocks.constants_watch import SOURCE as MODEL
from agent.records import HealthEvent
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status
from sim_bus.rig.plant import Hold
from tests.statistical.chains import TWO
from tests.statistical.detection import pipeline, records
from tests.statistical.machine import NAMES, NOMINAL, SECOND, each, say
from tests.statistical.nearly_right import Case, Play
from tests.statistical.nearly_right import said as said_of
from tests.statistical.operation import FULL_SCALE_M
from tests.statistical.sensor_faults import healthy

SAMPLES = 4 * SECOND
QUICK = ("turned", "scaled", "kilograms of force")


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


WRONG: dict[str, Callable[[FloatArray], None]] = {
    "offset 0.3": offset(0.3),
    "offset -3": offset(-3.0),
    "turned": turned,
    "exchanged": exchanged,
    "scaled": scaled,
    "m against mm": times(0.001, 2),
    "kilograms of force": times(9.80665, 0),
    "both in mm": times(1000.0, 1, 2),
    "late": late,
    "mm against m": times(1000.0, 1),
}


@dataclass(frozen=True, slots=True)
class Said:
    """What came of a run: words about the model, valid estimates, those that hold, and parameters alarmed."""

    words: tuple[str, ...]
    valid: int
    held: int
    alarms: tuple[str, ...]


def one(job: tuple[str, int]) -> Said:
    kind, seed = job
    v = healthy(np.random.default_rng([seed, 31]), SAMPLES)
    WRONG[kind](v)
    found = records(pipeline(), v)
    batches = [r for r in found if isinstance(r, EstimateBatch)]
    status, lower, upper = (
        np.vstack([getattr(b, part) for b in batches]) for part in ("status", "lower", "upper")
    )
    valid = status == Status.VALID
    return Said(
        tuple(r.message for r in found if isinstance(r, HealthEvent) and r.source == MODEL),
        int(valid.sum()), int((valid & (lower <= NOMINAL) & (upper >= NOMINAL)).sum()),
        tuple(r.parameter for r in found if isinstance(r, AlarmTransition) and r.to_state == "UNACK"),
    )  # fmt: skip


def hold(kinds: list[str], seeds: range, request: pytest.FixtureRequest) -> None:
    found = each(one, [(kind, seed) for kind in kinds for seed in seeds])
    valid, held = sum(run.valid for run in found), sum(run.held for run in found)
    alarmed = sorted({p for run in found for p in run.alarms if p in NAMES})
    say(
        request,
        f"{', '.join(kinds)}, {len(found)} runs: {held} of {valid} valid estimates hold; alarmed: {alarmed}",
    )
    assert held >= 0.9 * valid
    assert not alarmed


@pytest.mark.parametrize("kind", QUICK)
def test_channel_that_is_wrong_from_the_start_gives_no_wrong_row(
    kind: str, request: pytest.FixtureRequest
) -> None:
    hold([kind], range(1), request)


@pytest.mark.parametrize(
    ("kind", "seed", "words"),
    [("late", 0, "x1 comes "), ("mm against m", 0, "x1 reads "), ("mm against m", 104, "x1 reads ")],
)
def test_channel_late_or_in_millimetres_is_named_and_gives_no_valid_row(
    kind: str, seed: int, words: str
) -> None:
    said = one((kind, seed))
    assert (said.valid, said.alarms) == (0, ("x1",))
    assert said.words[0].startswith(words)


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_displacement_in_millimetres_is_named_where_masses_move_far(hold: Hold) -> None:
    rng = np.random.default_rng([0, 77])
    made = Play.of(TWO, rng, 10 * TWO.window)
    made.hold = hold
    readings = made.readings()[2 * TWO.window :]
    readings[:, 1] *= 1000.0
    found = said_of(Case(TWO, config={"hold": hold}), readings)
    assert (found.valid.sum(), found.alarms) == (0, ("x1",))


def test_scaled_channel_is_named() -> None:
    assert any(words.startswith("x2 reads 20") for words in one(("scaled", 0)).words)


@pytest.mark.soak
@pytest.mark.parametrize("kind", WRONG)
def test_wrong_channel_gives_no_wrong_row_in_25_runs(kind: str, request: pytest.FixtureRequest) -> None:
    hold([kind], range(100, 125), request)
