"""Machines that brake and dwell, commands that are held: no end of a range; and batches that say what blocks
say."""

import numpy as np
import pytest
from scipy.signal import lfilter

from agent.numerics.preprocessing.sensor_watch import Finding, SensorWatch, _Blocks
from tests.unit.numerics.preprocessing.test_sensor_watch import (
    INPUTS,
    KINDS,
    WINDOW,
    blows,
    smooth,
    under,
    watch,
)
from tests.unit.numerics.rigs import FloatArray

RATE_HZ, BRAKING, SPEED = 1000, 5.0, 0.5


def travel(distance: float) -> FloatArray:
    """Accelerations of a move that speeds up, goes on and brakes, each at a constant rate."""
    sign, distance = np.sign(distance), abs(distance)
    ramp = round(RATE_HZ * min(SPEED / BRAKING, np.sqrt(distance / BRAKING)))
    even = max(0, round(RATE_HZ * (distance - BRAKING * (ramp / RATE_HZ) ** 2) / SPEED))
    return sign * BRAKING * np.concatenate([np.ones(ramp), np.zeros(even), -np.ones(ramp)])


def positioning(seconds: int, step: float, rounded: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """A carriage that moves between places and dwells at each: force and position, of fine steps and no other
    noise."""
    rng, pieces, at = np.random.default_rng(seed), [np.zeros(500)], 0.0
    while sum(map(len, pieces)) < seconds * RATE_HZ:
        to = float(rng.choice([0.0, 0.05, 0.15, 0.2]))
        pieces += [travel(to - at) if to != at else np.zeros(0), np.zeros(int(rng.integers(300, 1500)))]
        at = to
    a = np.convolve(np.concatenate(pieces), np.ones(rounded) / rounded)[: seconds * RATE_HZ]
    v = np.cumsum(a) / RATE_HZ
    force = 90.0 * a + 200.0 * v + 20.0 * np.tanh(v / 1e-3) + 0.5 * rng.standard_normal(len(a))
    steps = np.array([0.01, step])
    return np.round(np.column_stack([force, np.cumsum(v) / RATE_HZ]) / steps) * steps, steps


@pytest.mark.parametrize(
    ("step", "rounded"),
    [(1e-7, 1), (1e-6, 20), (1e-5, 1),
     *(pytest.param(*more, marks=pytest.mark.soak) for more in ((1e-7, 20), (1e-6, 1), (1e-5, 20)))],
)  # fmt: skip
def test_watch_of_a_machine_that_brakes_and_dwells_for_165_s_finds_nothing(step: float, rounded: int) -> None:
    v, steps = positioning(165, step, rounded, 1)
    watcher = SensorWatch(np.array([True, False]), steps, WINDOW, np.array([0, 1]))
    assert [
        found for start in range(0, len(v), 5000) for found in watcher.take(v[start : start + 5000])
    ] == []


def test_watch_names_a_position_that_is_clipped_while_the_machine_still_goes_on() -> None:
    v, steps = positioning(20, 1e-6, 20, 1)
    v[:, 1] = np.minimum(v[:, 1], 0.18)
    watcher = SensorWatch(np.array([True, False]), steps, WINDOW, np.array([0, 1]))
    assert ("saturated", 1) in {(found.kind, found.channel) for found in watcher.take(v)}


def ramps(samples: int) -> FloatArray:
    """A force that goes from end to end at one speed and is held at each."""
    return np.interp(np.arange(samples) % 800, [0, 250, 400, 650, 800], [-40.0, -40.0, 40.0, 40.0, -40.0])


@pytest.mark.parametrize(("commanded", "found"), [(False, True), (True, False)])
def test_watch_of_a_commanded_force_that_is_held_at_its_ends_finds_nothing(
    *, commanded: bool, found: bool
) -> None:
    v, steps = under(ramps(8000))
    named = SensorWatch(INPUTS, steps, WINDOW, KINDS, INPUTS & commanded).take(v)
    assert bool([finding for finding in named if finding.channel == 2]) == found


def settling(lag: float, zero: float) -> FloatArray:
    """A square wave behind two lags of so many samples as computed: it settles on ±1 less zero."""
    times, samples = 16, 8000
    steps = np.where(np.arange(times * samples) // round(95 * times * lag) % 2 == 0, 1.0, -1.0)
    kept = np.exp(-1 / (times * lag))
    for _ in range(2):
        steps = lfilter([1 - kept], [1, -kept], steps)
    return np.asarray(steps[::times] - zero)


@pytest.mark.parametrize("zero", [0.0, 1.0])
@pytest.mark.parametrize("lag", [4.3, 6.0, 10.0])
@pytest.mark.parametrize("is_input", [True, False])
def test_watch_of_a_channel_that_settles_by_rounding_errors_finds_nothing(
    *, is_input: bool, lag: float, zero: float
) -> None:
    force = settling(lag, zero)
    v = np.column_stack([np.random.default_rng(0).standard_normal(len(force)), force])
    watcher = SensorWatch(np.array([False, is_input]), np.zeros(2), 1200)
    assert [found for found in watcher.take(v) if found.kind == "saturated"] == []


class EachBlock(SensorWatch):
    """Looks at every block by itself."""

    def _quiet_until(self, blocks: _Blocks, doubtful: np.ndarray, b: int) -> int:
        return b


def held_levels(seed: int) -> FloatArray:
    """A force that stays at each level for 100 samples."""
    return np.repeat(np.round(np.random.default_rng(seed).normal(0.0, 5.0, 120), 3), 100)


def switched(samples: int) -> FloatArray:
    """A force that is switched between the two ends of its range."""
    return np.where(np.arange(samples) % 1000 < 500, 5.0, -5.0)


def clipped(seed: int) -> FloatArray:
    v = smooth(seed, 6000)
    v[3000:3700, 0] = v[3000, 0]
    v[:, 1] = np.clip(v[:, 1], -0.05, 0.05)
    return v


PLAYED = {
    "levels": lambda: under(held_levels(0)),
    "other levels": lambda: under(held_levels(1)),
    "blows": lambda: under(blows(6000, 3.0, 60, 0)),
    "switched": lambda: under(switched(6000)),
    "ramps": lambda: under(np.where(np.arange(8000) < 4000, switched(8000), ramps(8000))),
    "force clipped": lambda: under(np.clip(smooth(2, 6000)[:, 2], -4.0, 4.0)),
    "clipped": lambda: (clipped(0), None),
    "clipped on a wire": lambda: (clipped(4), np.array([2e-6, 2e-6, 1e-3])),
}


@pytest.mark.parametrize("played", PLAYED.values(), ids=PLAYED)
def test_watch_of_batches_finds_what_a_watch_of_each_block_finds(played) -> None:
    v, steps = played()
    each: list[Finding] = EachBlock(INPUTS, np.zeros(3) if steps is None else steps, WINDOW, KINDS).take(v)
    assert watch(v, steps, cut=len(v)) == watch(v, steps, cut=333) == each


@pytest.mark.parametrize("force", [held_levels(0), switched(12_000)], ids=["levels", "switched"])
def test_watch_of_a_force_that_is_held_looks_at_few_blocks_by_themselves(
    monkeypatch: pytest.MonkeyPatch, force: FloatArray
) -> None:
    looked: list[int] = []
    assess = SensorWatch._assess
    monkeypatch.setattr(
        SensorWatch, "_assess", lambda self, blocks, b: looked.append(b) or assess(self, blocks, b)
    )
    v, steps = under(force)
    assert watch(v, steps) == []
    assert len(looked) < 0.15 * len(v) / 15
