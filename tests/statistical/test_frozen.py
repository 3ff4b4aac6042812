"""A force that freezes, or every channel at once, is named after a window; what rests in health is not."""

from collections.abc import Callable

import numpy as np
import pytest

from agent.records import HealthEvent, Record
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Reason, Status
from tests.statistical.detection import pipeline, records
from tests.statistical.machine import NOMINAL, SECOND, Machine, each, on_second, say
from tests.statistical.operation import NOISE_M, drive
from tests.statistical.sensor_faults import healthy

LASTS, AFTER = 3 * SECOND, 3 * SECOND
QUICK, FULL = 1, 200
Spoil = Callable[[FloatArray, int], None]


def force_stays(v: FloatArray, at: int) -> None:
    v[at : at + LASTS, 0] = v[at, 0]


def force_falls_to_zero(v: FloatArray, at: int) -> None:
    v[at : at + LASTS, 0] = 0.0


def everything_stays(v: FloatArray, at: int) -> None:
    v[at : at + LASTS] = v[at]


SPOILT: dict[str, tuple[Spoil, tuple[str, ...]]] = {
    "force stays": (force_stays, ("force",)),
    "force falls to zero": (force_falls_to_zero, ("force",)),
    "everything stays": (everything_stays, ("x1", "x2")),
}
AT_FAULT = (Reason.STUCK, Reason.SATURATED)
"""One that stays where it never was before may be at the end of its range."""


def one(job: tuple[str, int]) -> tuple[bool, bool, float]:
    """Play one run: whether one channel at fault and nothing else was alarmed; rows are right; seconds to the
    alarm."""
    kind, seed = job
    rng = np.random.default_rng([seed, 77])
    at = int(rng.integers(4 * SECOND, 5 * SECOND))
    v = healthy(rng, at + LASTS + AFTER)
    spoil, channels = SPOILT[kind]
    spoil(v, at)
    found = records(pipeline(), v)
    alarms = [(r.kind, r.parameter, r.to_state) for r in found if isinstance(r, AlarmTransition)]
    raised = [
        r.t_ns // 1_000_000 - at for r in found if isinstance(r, AlarmTransition) and r.to_state == "UNACK"
    ]
    named = any(alarms == [("sensor", name, "UNACK"), ("sensor", name, "RTNUN")] for name in channels)
    return named, rows_are_right(found, at), raised[0] / SECOND if raised else np.inf


def rows_are_right(found: list[Record], at: int) -> bool:
    """Tell whether rows say so from a window after the fault until it ended, and are valid a window after
    that."""
    batches = [r for r in found if isinstance(r, EstimateBatch)]
    index, status, reason = (
        np.concatenate([getattr(b, p) for b in batches]) for p in ("index", "status", "reason")
    )
    stuck = (index >= at + 1.2 * SECOND) & (index < at + LASTS)
    sound = index >= at + LASTS + 1.2 * SECOND
    return bool(np.isin(reason[stuck], AT_FAULT).all() and (status[sound] == Status.VALID).all())


def assess(kind: str, found: list[tuple[bool, bool, float]], request: pytest.FixtureRequest) -> None:
    named, right, delays = zip(*found, strict=True)
    say(
        request,
        f"{kind}, {len(found)} runs: named and nothing else in {sum(named)}, "
        f"after {np.median(delays):.2f} s in the median and {max(delays):.2f} s at most; "
        f"every row right in {sum(right)}",
    )
    assert sum(named) >= 0.95 * len(found)
    assert sum(right) >= 0.95 * len(found)


@pytest.mark.parametrize("kind", SPOILT)
def test_channel_that_freezes_is_named(kind: str, request: pytest.FixtureRequest) -> None:
    assess(kind, each(one, [(kind, seed) for seed in range(QUICK)]), request)


@pytest.mark.soak
@pytest.mark.parametrize("kind", SPOILT)
def test_channel_that_freezes_is_named_in_200_runs(kind: str, request: pytest.FixtureRequest) -> None:
    assess(kind, each(one, [(kind, 10_000 + seed) for seed in range(FULL)]), request)


def test_force_that_read_the_same_from_the_first_sample_is_named_where_nothing_else_explains_the_motion() -> (
    None
):
    named = 0
    for seed in (0, 1):
        v = healthy(np.random.default_rng(seed), 6 * SECOND)
        v[:, 0] = 0.61
        found = records(pipeline(), v)
        alarms = [(r.kind, r.parameter, r.to_state) for r in found if isinstance(r, AlarmTransition)]
        words = [r.message for r in found if isinstance(r, HealthEvent) and r.source == "model"]
        assert alarms in ([], [("sensor", "force", "UNACK")])
        assert all("force stood at 0.61 N" in message for message in words)
        named += len(alarms)
    assert named


def test_force_that_rests_where_it_used_to_is_not_blamed_for_a_load_nobody_measures() -> None:
    rng = np.random.default_rng(6)
    force = drive(rng, 14 * SECOND + 1)
    force[4 * SECOND : 7 * SECOND] = 0.0  # the motion dies out, as the model says
    measured = force.copy()
    measured[10 * SECOND :] = 0.0  # somebody else moves the rig
    y = Machine.at_rest().play(on_second(force))[:, :2]
    v = np.column_stack([measured[:-1], y + NOISE_M * rng.standard_normal(y.shape)])
    found = records(pipeline(), v)
    assert not [r for r in found if isinstance(r, AlarmTransition)]
    last = [r for r in found if isinstance(r, EstimateBatch)][-1]
    # a force that nobody measures: what little the rig shows under it is true, within 3 sd in this one row
    holds = np.abs(last.value[-1] - NOMINAL) < 3 * last.sd[-1]
    assert (np.isin(last.status[-1], (Status.INVALID, Status.UNEXCITED)) | holds).all()
    assert (last.status[-1] == Status.UNEXCITED).any()


def test_force_that_is_held_at_each_of_its_levels_is_not_blamed_for_a_load_nobody_measures() -> None:
    for seed, held in ((0, 1200), (4, 1200), (4, 2000)):  # samples, of windows of 1000
        rng = np.random.default_rng(seed)
        levels = np.repeat(np.round(2.0 * rng.standard_normal(18 * SECOND // held), 3), held)
        load = np.where(np.arange(len(levels)) < 10.5 * SECOND, 0.0, drive(rng, len(levels)))
        y = Machine.at_rest().play(on_second(levels + load))[:, :2]
        v = np.column_stack([levels[:-1], y + NOISE_M * rng.standard_normal(y.shape)])
        assert not [r for r in records(pipeline(), v) if isinstance(r, AlarmTransition)]


@pytest.mark.parametrize("begins", [0, 300])
@pytest.mark.parametrize("seed", [1, 4])
def test_force_that_is_held_through_the_first_window_of_a_sound_rig_is_not_blamed(
    begins: int, seed: int
) -> None:
    """What little the forces that nobody measures are found to be does not explain such a window better."""
    rng = np.random.default_rng(seed)
    force = np.full(3 * SECOND, np.round(2.0 * rng.standard_normal(), 3))
    y = Machine.at_rest().play(on_second(force))[:, :2]
    v = np.column_stack([force[:-1], y + NOISE_M * rng.standard_normal(y.shape)])
    assert not [r for r in records(pipeline(), v[begins:]) if isinstance(r, AlarmTransition)]
