"""Stuck and clipped channels named; turning points, coarse wires and standstill left alone."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from agent.numerics.preprocessing.rails import resolution, tops
from agent.numerics.preprocessing.sensor_watch import Finding, SensorWatch
from agent.numerics.preprocessing.wire import Wire
from tests.unit.numerics.rigs import FloatArray, noisy, record, sampled

INPUTS, KINDS = np.array([False, False, True]), np.array([0, 0, 1])
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


def watch(
    v: FloatArray, step: FloatArray | None = None, cut: int = 100, wire: Wire | None = None
) -> list[Finding]:
    watcher = SensorWatch(INPUTS, np.zeros(3) if step is None else step, WINDOW, KINDS, wire=wire)
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


def of_16_bits(seed: int) -> list[Finding]:
    """What is found in a rig whose displacements and force are the steps of 16 bits, without other noise."""
    v, steps = noisy(np.random.default_rng(seed), 12_000, 0.0).v, np.array([0.05, 0.05, 50.0]) / 2**15
    return watch(np.round(v / steps) * steps, steps, cut=2000)


@pytest.mark.parametrize("seed", [45, 60, 75, 94])
def test_watch_of_a_channel_of_16_bits_that_halts_at_a_peak_finds_nothing(seed: int) -> None:
    assert of_16_bits(seed) == []


@pytest.mark.soak
def test_watch_of_channels_of_16_bits_finds_nothing_in_200_runs() -> None:
    assert [seed for seed in range(200) if of_16_bits(seed)] == []


def slow(seed: int, samples: int = 12_000) -> FloatArray:
    """Channels of unit spread that turn each 200 samples or so, the outputs with 0.3 % of noise."""
    rng = np.random.default_rng(seed)
    b, a = butter(2, 0.004)
    v = lfilter(b, a, rng.standard_normal((samples + 4000, 3)), axis=0)[4000:]
    v /= v.std(axis=0)
    v[:, :2] += 3e-3 * rng.standard_normal((samples, 2))
    return v


def of_digits(v: FloatArray, count: int) -> FloatArray:
    """Readings as a table of so many significant digits gives them: their step grows with what they say."""
    step = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(v), 1e-300))) - count + 1)
    return np.round(v / step) * step


@pytest.mark.parametrize(("seed", "count"), [(3, 3), (5, 3), (9, 3), (7, 2)])
def test_watch_of_readings_of_few_digits_finds_nothing(seed: int, count: int) -> None:
    assert watch(of_digits(slow(seed), count)) == []


def tones(seed: int) -> FloatArray:
    """Channels of three tones each, with noise, whose peaks are 1.01 to 1.24."""
    rng = np.random.default_rng(seed)
    t = np.arange(12_000)[:, None]
    period, phase = rng.uniform(30, 300, (3, 1, 3)), rng.uniform(0, 2 * np.pi, (3, 1, 3))
    v = np.tensordot([1.0, 0.4, 0.2], np.cos(2 * np.pi * t / period + phase), 1)
    v *= rng.uniform(1.01, 1.24, 3) / np.abs(v).max(axis=0)
    return np.asarray(v + 2e-4 * rng.standard_normal(v.shape))


@pytest.mark.parametrize("seed", range(10))
def test_watch_of_peaks_just_beyond_a_power_of_ten_finds_nothing(seed: int) -> None:
    """There a table's step is ten times that of readings not much smaller."""
    table = of_digits(tones(seed), 3)
    assert watch(table) == []
    scaled = Wire(np.full(3, 9.80665), np.array([1.0, -3.0, 0.0]))
    assert watch(table * scaled.unit + scaled.zero, wire=scaled) == []


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("power", range(-8, 5))
def test_tops_at_a_power_of_ten_are_found_whatever_its_last_bit(power: int, sign: int) -> None:
    into = 0.93 - np.cumsum([0.0, 0.16, 0.17, 0.16, 0.17, 0.16, 0.17, 0.16])[::-1]
    x = np.concatenate([into, np.ones(12), np.full(9, 0.95)]) * float(f"{sign}e{power}")
    found = tops(x, 1e-3 * 10.0**power, Wire.in_si(1))
    assert [top.value for top in found] == [x[8]]
    assert found[0].beyond == pytest.approx(0.16 * 12 / 0.01, rel=1e-6)


@pytest.mark.parametrize("digits", [4, 5])
@pytest.mark.parametrize("end", [0.8, 1.0, 1.05, 1.1])
def test_watch_names_a_channel_that_is_clipped_about_a_power_of_ten(end: float, digits: int) -> None:
    v = tones(0)
    v[:, 0] = np.clip(1.3 * v[:, 0], -1.6, end)
    assert {f.channel for f in watch(of_digits(v, digits))} == {0}


@pytest.mark.parametrize("count", [4, 5])
def test_watch_names_a_clipped_channel_of_few_digits(count: int) -> None:
    v = slow(0)
    v[:, 0] = np.clip(v[:, 0], -0.7, 0.7)
    found = watch(of_digits(v, count))
    assert {f.channel for f in found} == {0}
    assert "saturated" in {f.kind for f in found}


@pytest.mark.parametrize(
    ("readings", "step"),
    [([1.23, 1.25, 1.28], 0.01), ([0.998, 1.0, 1.01], 0.002), ([5.0, 5.0], 0.0), ([], 0.0)],
)
def test_resolution_of_readings_is_what_divides_all_their_differences(
    readings: list[float], step: float
) -> None:
    assert resolution(np.array(readings)) == pytest.approx(step, rel=1e-6)


@pytest.mark.parametrize("play", [smooth, white])
@pytest.mark.parametrize("step", [0.0, 2e-6])
@pytest.mark.parametrize("channel", [0, 1])
def test_watch_names_a_stuck_output_within_a_window_and_sees_it_move_again(
    play, step: float, channel: int
) -> None:
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
    v = smooth(4, 6000)
    v[3000:3700, 0] = v[3000, 0]
    v[:, 1] = np.clip(v[:, 1], -0.05, 0.05)
    whole = watch(v, cut=len(v))
    assert len(whole) > 4
    for cut in (1, 13, 500):
        assert watch(v, cut=cut) == whole


def test_watch_of_coarse_and_shrunken_channels_is_the_same_however_the_stream_is_cut() -> None:
    v = smooth(0, 12_000)
    v[:, 0] = np.round(v[:, 0] / 0.004) * 0.004
    limit = 0.4 * np.abs(v[:6000, 1]).max()
    v[6000:, 1] = np.clip(v[6000:, 1], -limit, limit)
    v[:, 2] = np.maximum(v[:, 2], -3.0)
    whole = watch(v, cut=len(v))
    assert {f.channel for f in whole} >= {1, 2}
    for cut in (7, 500, 777):
        assert watch(v, cut=cut) == whole


def test_watch_after_a_gap_remembers_a_stuck_channel_until_it_moves() -> None:
    v = smooth(5)
    v[3000:5000, 0] = v[3000, 0]
    watcher = SensorWatch(INPUTS, np.zeros(3), WINDOW, KINDS)
    before = watcher.take(v[:4000])
    watcher.restart()
    after = watcher.take(v[4100:])
    assert before[-1].kind == "stuck"
    assert [f.kind for f in after] == [None]
    assert 900 < after[0].stop <= 964


def blows(samples: int, rest: float, width: int, first: int) -> FloatArray:
    """Blows of a hammer, one each 200 samples, on a force that rests in between; the record begins at one
    `first`."""
    t = np.arange(first, first + samples)
    amplitude = 800.0 * (1.0 + 0.2 * np.random.default_rng(1).standard_normal(t.max() // 200 + 1))[t // 200]
    into = (t % 200) / width
    return np.where(into < 1.0, amplitude * np.sin(np.pi * np.minimum(into, 1.0)), 0.0) + rest


def under(force: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rig under a force, on wires of fine steps."""
    v = record(sampled(), force[:, None]).v
    v[:, :2] += 1e-6 * np.random.default_rng(2).standard_normal((len(v), 2))
    steps = np.array([1e-9, 1e-9, 1e-4])
    return np.round(v / steps) * steps, steps


@pytest.mark.parametrize("rest", [0.0, 3.0])
@pytest.mark.parametrize("width", [4, 60])
@pytest.mark.parametrize("first", [0, 2])
def test_watch_of_a_force_that_rests_between_blows_finds_nothing(rest: float, width: int, first: int) -> None:
    assert watch(*under(blows(2000, rest, width, first))) == []


@pytest.mark.parametrize("force", [
    np.minimum(50.0 * np.sin(0.02 * np.arange(2000)), 40.0),
    np.maximum(50.0 * np.sin(0.02 * np.arange(2000)), -40.0),
], ids=["top", "bottom"])  # fmt: skip
def test_watch_names_a_force_that_runs_into_the_end_of_its_range_again_and_again(force: FloatArray) -> None:
    found = watch(*under(force))
    assert {(f.channel, f.kind) for f in found} == {(2, "saturated"), (2, None)}
    assert found[0].stop < 800


def test_watch_names_a_channel_whose_range_has_shrunk() -> None:
    v = smooth(0)
    limit = 0.4 * np.abs(v[:6000, 1]).max()
    v[6000:, 1] = np.clip(v[6000:, 1], -limit, limit)
    found = [f for f in watch(v) if f.kind is not None]
    assert {f.channel for f in found} == {1}
    assert "saturated" in {f.kind for f in found}


def slow_and_coarse(levels: float, seed: int, samples: int = 40_000) -> tuple[FloatArray, FloatArray]:
    """Two outputs that follow a slow movement of changing size, the second on a wire of few levels."""
    rng = np.random.default_rng(seed)
    b, a = butter(2, 0.002)
    u = lfilter(b, a, rng.standard_normal(samples + 2000))[:, None]
    knots = np.arange(0, len(u) + 5000, 5000)
    size = np.interp(np.arange(len(u)), knots, 10 ** rng.uniform(-1.5, 0, len(knots)))
    v = record(sampled(), 5.0 * u / u.std() * size[:, None]).v[2000:]
    v[:, 0] += 1e-5 * np.ptp(v[:, 0]) * rng.standard_normal(samples)
    step = np.ptp(v[:, 1]) / levels
    v[:, 1] = np.round(v[:, 1] / step) * step
    return v, np.array([0.0, step, 0.0])


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("levels", [2, 10, 40])
def test_watch_of_a_channel_of_few_levels_finds_nothing(levels: int, stated: bool) -> None:
    v, step = slow_and_coarse(levels, levels, 20_000)
    assert watch(v, step if stated else None, cut=1000) == []


@pytest.mark.parametrize("stated", [True, False])
def test_watch_names_a_stuck_channel_of_few_levels_where_the_others_go_back_and_forth(stated: bool) -> None:
    v, step = slow_and_coarse(100, 1)
    v[20_000:, 1] = v[20_000, 1]
    (stuck,) = watch(v, step if stated else None, cut=1000)
    assert (stuck.channel, stuck.kind) == (1, "stuck")
    assert stuck.stop > 20_000
