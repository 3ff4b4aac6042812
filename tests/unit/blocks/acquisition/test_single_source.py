"""Blocks become aligned SI samples; everything that does not is counted by reason."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.blocks.acquisition.interface import ChannelScale
from agent.blocks.acquisition.single_source import SingleSource, source_plan
from agent.types import Aligned
from drivers.port import FloatArray, SampleBlock

PLAIN = ChannelScale(1.0, 0.0, 1.0)
CHANNELS = ["force", "x1", "x2"]


def single(scales: dict[str, ChannelScale] | None = None, rate_hz: float = 1000.0) -> SingleSource:
    scales = scales or dict.fromkeys(CHANNELS, PLAIN)
    # fields come in the order of the map, not of the channels
    plan = source_plan("rig", {"x1": "a", "x2": "b", "force": "c"}, CHANNELS, scales)
    return SingleSource(plan, 1, "counter", rate_hz)


def block(
    counter: object, values: object = None, arrival_ns: int = 0, t_ns: object = None, columns: int = 3
) -> SampleBlock:
    counts = np.asarray(counter, dtype=np.int64)
    array = np.outer(counts, np.arange(1, columns + 1)) if values is None else np.asarray(values, dtype=float)
    return SampleBlock(
        array.astype(float), arrival_ns, counts, None if t_ns is None else np.asarray(t_ns, dtype=np.int64)
    )


def indices(pieces: list[Aligned]) -> list[int]:
    return [int(i) for piece in pieces for i in piece.index]


def test_acquisition_readings_become_si_in_the_order_of_channels() -> None:
    scales = {
        "force": ChannelScale(2.0, 1.0, 1e3),
        "x1": ChannelScale(1.0, 0.0, 1e-3),
        "x2": ChannelScale(-1.0, 5.0, 1.0),
    }
    (piece,) = single(scales).step("rig", block([0], [[7.0, 3.0, 4.0]]), None).values
    np.testing.assert_allclose(piece.u, [[9000.0]])
    np.testing.assert_allclose(piece.y, [[0.007, 2.0]])


def test_acquisition_gap_starts_a_new_segment_and_is_counted() -> None:
    acquisition = single()
    first = acquisition.step("rig", block([5, 6, 7]), 256).values
    later = acquisition.step("rig", block([8, 9, 14, 15]), 256).values
    assert [p.index.tolist() for p in first + later] == [[0, 1, 2], [3, 4], [9, 10]]
    assert [p.segment for p in first + later] == [1, 1, 2]
    state = acquisition.sources["rig"]
    assert (state.gaps, state.missing, state.passed) == (1, 4, 7)


def test_acquisition_stamps_travel_with_their_samples() -> None:
    pieces = single().step("rig", block([0, 1, 1, 3], t_ns=[10, 20, 25, 40]), None).values
    assert [p.stamps.tolist() for p in pieces if p.stamps is not None] == [[10, 20], [40]]


def test_acquisition_values_that_are_none_are_refused_by_reason() -> None:
    acquisition = single()
    values = np.ones((6, 3))
    values[1, 0], values[2, 2], values[4] = np.nan, np.inf, [np.nan, -np.inf, 1.0]
    pieces = acquisition.step("rig", block(range(6), values), None).values
    assert indices(pieces) == [0, 3, 5]
    assert acquisition.sources["rig"].refusals() == {"missing value": 1, "not finite": 2}
    assert all(np.isfinite(p.y).all() and np.isfinite(p.u).all() for p in pieces)


@pytest.mark.parametrize("reading", [1.1e30, -1e80, 1e300, 3.4e38])
def test_acquisition_readings_that_no_instrument_means_are_refused_by_a_reason_of_their_own(
    reading: float,
) -> None:
    acquisition = single()
    values = np.ones((4, 3))
    values[1, 0], values[2, 1], values[3, 2] = reading, 0.9e30, -0.9e30
    pieces = acquisition.step("rig", block(range(4), values), None).values
    assert indices(pieces) == [0, 2, 3]
    assert acquisition.sources["rig"].refusals() == {"too large": 1}


def test_acquisition_reading_that_its_scale_makes_infinite_is_too_large() -> None:
    acquisition = single({name: ChannelScale(1e20, 0.0, 1e3) for name in ("force", "x1", "x2")})
    values = np.array([[1.0, 1.0, 1.0], [1e290, 1.0, 1.0], [1.0, np.inf, 1.0]])
    assert indices(acquisition.step("rig", block(range(3), values), None).values) == [0]
    assert acquisition.sources["rig"].refusals() == {"too large": 1, "not finite": 1}


@given(st.lists(st.integers(0, 60), min_size=1, max_size=80), st.integers(0, 2**32 - 1), st.data())
def test_acquisition_any_stream_is_used_or_refused_sample_by_sample(
    counters: list[int], seed: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    values: FloatArray = rng.standard_normal((len(counters), 3))
    values[rng.random(values.shape) < 0.05] = np.nan
    acquisition, passed, cut = single(rate_hz=1e6), 0, 0
    last = -1
    while cut < len(counters):
        end = data.draw(st.integers(cut + 1, len(counters)))
        for piece in acquisition.step("rig", block(counters[cut:end], values[cut:end]), 64).values:
            passed += len(piece.index)
            assert piece.index[0] > last
            assert np.all(np.diff(piece.index) == 1)
            last = int(piece.index[-1])
        cut = end
    state = acquisition.sources["rig"]
    assert passed == state.passed
    assert passed + state.refusals().total() == len(counters)
