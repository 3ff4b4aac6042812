"""Gaps bridged or cut, spikes counted, faulty channels labelled and said once."""

import numpy as np
import pytest

from agent.blocks.quality import Quality, QualitySettings
from agent.blocks.sensor_alarms import SensorAlarms
from agent.blocks.sensor_labels import Labelled
from agent.types import FloatArray, IntArray, Reason, Samples, SensorEvent, SensorFault
from tests.unit.numerics.rigs import noisy

W = 250
CHANNELS = ("force", "x1", "x2")


def readings(samples: int, seed: int = 0) -> FloatArray:
    """Force, then displacements."""
    v = noisy(np.random.default_rng(seed), samples, 1e-6).v
    return np.column_stack([v[:, 2], v[:, :2]])


def play(
    v: FloatArray, index: IntArray | None = None, cut: int = 100, bridge: int = 5
) -> tuple[list[Samples], list[SensorEvent], Quality]:
    quality = Quality(QualitySettings(CHANNELS, 1, np.zeros(3), W, bridge))
    index = np.arange(len(v), dtype=np.int64) if index is None else index
    found: list[Labelled] = []
    for start in range(0, len(v), cut):
        part = slice(start, start + cut)
        found.append(quality.step(index[part], index[part] * 1_000_000, v[part]))
    whole = Labelled.joined([*found, quality.finish()])
    return list(whole.values), list(whole.events), quality


def joined(pieces: list[Samples], name: str) -> np.ndarray:
    return np.concatenate([getattr(piece, name) for piece in pieces])


def test_quality_passes_sound_samples_as_they_are() -> None:
    v = readings(1000)
    pieces, events, quality = play(v)
    assert np.array_equal(joined(pieces, "index"), np.arange(1000))
    assert np.array_equal(np.column_stack([joined(pieces, "u"), joined(pieces, "y")]), v)
    assert all(piece.usable and piece.fault is None and piece.missing is None for piece in pieces)
    assert {piece.segment for piece in pieces} == {1}
    assert (events, dict(quality.rejected)) == ([], {})


def test_quality_bridges_a_short_gap_within_the_segment() -> None:
    v, index = readings(1000), np.delete(np.arange(1000), [400, 401, 402, 403, 404])
    pieces, _, _ = play(v[index], index)
    assert np.array_equal(joined(pieces, "index"), np.arange(1000))
    assert np.array_equal(joined(pieces, "t_ns"), np.arange(1000) * 1_000_000)
    assert {piece.segment for piece in pieces} == {1}
    lost = [piece.index[piece.missing.all(axis=1)] for piece in pieces if piece.missing is not None]
    assert np.concatenate(lost).tolist() == [400, 401, 402, 403, 404]
    assert np.isfinite(joined(pieces, "y")).all()


def test_quality_starts_a_new_segment_after_a_longer_gap() -> None:
    v, index = readings(1000), np.delete(np.arange(1000), np.arange(400, 406))
    pieces, _, _ = play(v[index], index)
    assert np.array_equal(joined(pieces, "index"), index)
    assert {piece.segment for piece in pieces if piece.index[-1] < 400} == {1}
    assert {piece.segment for piece in pieces if piece.index[0] > 400} == {2}


def test_quality_marks_a_lost_reading_of_one_channel_alone() -> None:
    v = readings(600)
    v[300, 1] = np.nan
    pieces, _, _ = play(v)
    (piece,) = [piece for piece in pieces if piece.missing is not None]
    row = 300 - int(piece.index[0])
    assert piece.missing is not None
    assert np.flatnonzero(piece.missing.any(axis=1)).tolist() == [row]
    assert piece.missing[row].tolist() == [True, False, False]  # outputs first
    assert abs(piece.y[row, 0] - readings(600)[300, 1]) < 1e-5


def test_quality_counts_spikes_and_fills_them() -> None:
    v = readings(1000)
    true = v.copy()
    v[500, 1] += 0.02
    v[700:703, 2] -= 0.01
    pieces, _, quality = play(v)
    assert dict(quality.rejected) == {"spike": 4}
    assert np.abs(joined(pieces, "y") - true[:, 1:]).max() < 1e-5


def test_quality_names_a_stuck_channel_once_and_takes_it_back_a_window_after_it_moves() -> None:
    v = readings(4000, seed=1)
    v[1500:2500, 1] = v[1500, 1]
    pieces, events, quality = play(v)
    raised, cleared = events
    assert (raised.fault, raised.standing) == (SensorFault("x1", Reason.STUCK), True)
    assert 1500 < raised.index < 1500 + W + 64
    assert not cleared.standing
    assert 2500 + W <= cleared.index < 2500 + W + 64
    bad = [piece for piece in pieces if not piece.usable]
    assert bad[0].index[0] == raised.index + 1
    assert quality.rejected["stuck"] == sum(len(piece.index) for piece in bad)
    after = [piece for piece in pieces if piece.usable and piece.fault is not None]
    assert sum(len(piece.index) for piece in after) == W - 1
    assert {piece.segment for piece in after} == {2}


def test_quality_says_that_a_channel_is_silent_after_a_window_and_when_it_speaks() -> None:
    v = readings(3000)
    v[1000:2000, 2] = np.nan
    pieces, events, _ = play(v)
    raised, cleared = events
    assert (raised.fault, raised.standing) == (SensorFault("x2", Reason.NO_DATA), True)
    assert 1000 + W <= raised.index <= 1000 + W + 5
    assert (cleared.standing, cleared.index) == (False, 2000)
    silent = [piece for piece in pieces if not piece.usable]
    assert all(piece.fault == SensorFault("x2", Reason.NO_DATA) for piece in silent)
    whole = np.concatenate([piece.index for piece in pieces if piece.usable])
    assert not np.isin(np.arange(1010, 2000), whole).any()


@pytest.mark.parametrize("seed", range(3))
def test_quality_gives_the_same_however_the_stream_is_cut(seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = readings(3000, seed)
    v[700:1300, 1] = v[700, 1]
    v[1800:1900, 2] = np.nan
    v[rng.integers(200, 3000, 20), 1 + rng.integers(0, 2, 20)] += 0.03
    v[rng.random(v.shape) < 0.003] = np.nan
    v[0] = 0.0
    index = np.flatnonzero(rng.random(3000) > 0.01).astype(np.int64)
    whole, said, counted = play(v[index], index, cut=3000)
    for cut in (1, 37, 400):
        again, events, quality = play(v[index], index, cut=cut)
        assert (events, quality.rejected) == (said, counted.rejected)
        for name in ("index", "t_ns", "u", "y"):
            assert np.array_equal(joined(whole, name), joined(again, name), equal_nan=True), name
        for name in ("segment", "usable", "fault"):
            assert _spread(whole, name) == _spread(again, name), name


def _spread(pieces: list[Samples], name: str) -> list[object]:
    return [getattr(piece, name) for piece in pieces for _ in piece.index]


def test_sensor_alarms_raise_once_and_clear_once() -> None:
    alarms, fault = SensorAlarms("rig"), SensorFault("x1", Reason.STUCK)
    other = SensorFault("x1", Reason.SENSOR)
    events = [
        SensorEvent(f, s, i, i) for i, (f, s) in enumerate([(fault, True), (other, True), (fault, False)])
    ]
    states = [(change.kind, change.parameter, change.to_state) for change in alarms.step(events)]
    assert states == [("sensor", "x1", "UNACK"), ("sensor", "x1", "RTNUN")]
    assert alarms.step([SensorEvent(other, False, 9, 9)]) == []


def accounted(v: FloatArray, index: IntArray, cut: int) -> tuple[int, int]:
    """Return how many samples arrived complete, and how many were used, refused here or still wait."""
    pieces, _, quality = play(v, index, cut)
    used = sum(int(piece.complete.sum()) for piece in pieces if piece.usable)
    return int(np.isfinite(v).all(axis=1).sum()), used + quality.rejected.total() + quality.waiting


def test_quality_leaves_the_spike_of_a_sample_that_lacks_a_reading_uncounted() -> None:
    v = readings(1000)
    v[500, 0], v[500, 1] = np.nan, 1.0
    v[700, 1], v[700, 2] = np.nan, 0.5
    v[800, 1:] += 0.02
    _, _, quality = play(v)
    assert dict(quality.rejected) == {"spike": 1}
    assert accounted(v, np.arange(1000), cut=100) == (998, 998)


def test_quality_counts_the_spike_that_ends_a_stretch() -> None:
    v = readings(1000)
    v[600, 1] += 0.02
    v[601:603, 2] = np.nan
    index = np.delete(np.arange(1000), np.arange(603, 620))
    assert accounted(v[index], index, cut=100) == (981, 981)


@pytest.mark.parametrize("seed", range(6))
def test_quality_counts_each_sample_once_whatever_befalls_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = readings(4000, seed)
    v[900:1500, 1] = v[900, 1]
    v[2000:2600, 2] = np.minimum(v[2000:2600, 2], np.quantile(v[:2000, 2], 0.7))
    v[3000:3100, 2] = np.nan
    struck = rng.integers(200, 4000, 60)
    v[struck, 1 + rng.integers(0, 2, 60)] += 0.03
    v[struck[:30], 0] = np.nan
    v[rng.random(v.shape) < 0.004] = np.nan
    index = np.flatnonzero(rng.random(4000) > 0.01).astype(np.int64)
    arrived, found = accounted(v[index], index, cut=37)
    assert found == arrived
