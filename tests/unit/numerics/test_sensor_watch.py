"""Stuck and clipped channels named; turning points, coarse wires and standstill left alone."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from agent.numerics.sensor_watch import Finding, SensorWatch
from tests.unit.numerics.rigs import FloatArray, noisy, record, sampled

INPUTS = np.array([False, False, True])
WINDOW = 250


def smooth(seed: int, samples: int = 12_000) -> FloatArray:
    """The rig under a force of 20 Hz band width, with sensor noise: displacements, force."""
    rng = np.random.default_rng(seed)
    b, a = butter(2, 0.04)
    u = lfilter(b, a, rng.standard_normal(samples + 2000))[:, None]
    played = record(sampled(), 5.0 * u / u.std()).v[2000:]
    played[:, :2] += 1e-6 * rng.standard_normal((samples, 2))
    return played


def white(seed: int, samples: int = 12_000) -> FloatArray:
    return noisy(np.random.default_rng(seed), samples, 1e-6).v


def watch(v: FloatArray, step: FloatArray | None = None, cut: int = 100) -> list[Finding]:
    watcher = SensorWatch(INPUTS, np.zeros(3) if step is None else step, WINDOW)
    return [found for start in range(0, len(v), cut) for found in watcher.take(v[start : start + cut])]


def on_wire(v: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    steps = np.array([step, step, 1e-3])
    return np.round(v / steps) * steps, steps


@pytest.mark.parametrize("play", [smooth, white])
@pytest.mark.parametrize("step", [0.0, 2e-6, 2e-5, 2e-4])
@pytest.mark.parametrize("seed", range(3))
def test_watch_of_healthy_channels_finds_nothing(play, step: float, seed: int) -> None:
    v = play(seed)
    assert watch(*(on_wire(v, step) if step else (v,))) == []


@pytest.mark.parametrize("play", [smooth, white])
@pytest.mark.parametrize("step", [0.0, 2e-6])
@pytest.mark.parametrize("channel", [0, 1])
def test_watch_names_a_stuck_output_within_a_window_and_sees_it_move_again(play, step: float, channel: int) -> None:
    v = play(1)
    v[6000:8000, channel] = v[6000, channel]
    stuck, sound = watch(*(on_wire(v, step) if step else (v,)))
    assert (stuck.channel, stuck.kind) == (channel, "stuck")
    assert 6000 < stuck.stop <= 6000 + WINDOW + 64
    assert (sound.channel, sound.kind) == (channel, None)
    assert 8000 < sound.stop <= 8064


@pytest.mark.parametrize("step", [0.0, 2e-6, 2e-5])
def test_watch_at_standstill_finds_nothing(step: float) -> None:
    v = smooth(2)
    v[4000:9000] *= np.linspace(1.0, 0.0, 5000)[:, None] ** 4
    rest = np.random.default_rng(0).standard_normal((2000, 3)) * np.array([1e-6, 1e-6, 1e-3])
    v[7000:9000] = rest
    v[9000:10_000] *= np.linspace(0.0, 1.0, 1000)[:, None]
    assert watch(*(on_wire(v, step) if step else (v,))) == []


def test_watch_of_an_input_that_stands_still_finds_nothing() -> None:
    v = smooth(3)
    v[5000:, 2] = 0.0
    assert watch(v) == []


@pytest.mark.parametrize("step", [0.0, 2e-6])
def test_watch_names_a_channel_at_the_end_of_its_range(step: float) -> None:
    v = smooth(0)
    limit = 0.6 * np.abs(v[:, 1]).max()
    v[:, 1] = np.clip(v[:, 1], -limit, limit)
    found = watch(*(on_wire(v, step) if step else (v,)))
    assert {f.channel for f in found} == {1}
    assert found[0].kind in {"saturated", "stuck"}
    assert "saturated" in {f.kind for f in found}


def test_watch_gives_the_same_however_the_stream_is_cut() -> None:
    v = smooth(4)
    v[3000:3700, 0] = v[3000, 0]
    v[:, 1] = np.clip(v[:, 1], -0.05, 0.05)
    whole = watch(v, cut=len(v))
    assert len(whole) > 4
    for cut in (1, 13, 500):
        assert watch(v, cut=cut) == whole


def test_watch_after_a_gap_remembers_a_stuck_channel_until_it_moves() -> None:
    v = smooth(5)
    v[3000:5000, 0] = v[3000, 0]
    watcher = SensorWatch(INPUTS, np.zeros(3), WINDOW)
    before = watcher.take(v[:4000])
    watcher.restart()
    after = watcher.take(v[4100:])
    assert before[-1].kind == "stuck"
    assert [f.kind for f in after] == [None]
    assert 900 < after[0].stop <= 964
