"""Several sources become rows: whoever comes first, however late, by whatever clock; every sample is
accounted for."""

from pathlib import Path

import numpy as np

from agent.blocks.acquisition.alignment import Alignment
from agent.blocks.acquisition.interface import ChannelScale
from agent.blocks.acquisition.single_source import SingleSource, source_plan
from agent.blocks.acquisition.stream import AlignmentPlan, StreamPlan
from agent.config import load
from agent.runtime.assembly.acquisition_plan import make_acquisition
from agent.types import Aligned
from drivers.port import FloatArray, IntArray, SampleBlock
from tests.scenario.live import example

CHANNELS = ["force", "x1", "x2"]
SCALES = dict.fromkeys(CHANNELS, ChannelScale(1.0, 0.0, 1.0))


def pair(
    late: float = 0.0, *, own_clock: bool = False, rate_hz: float = 1000.0, keep_incomplete: bool = False
) -> Alignment:
    """Force and x1 from one source, x2 from another that is late."""
    one = source_plan("one", {"force": "f", "x1": "a"}, CHANNELS, SCALES)
    two = source_plan("two", {"x2": "b"}, CHANNELS, SCALES)
    streams = StreamPlan(one, 1000.0), StreamPlan(two, rate_hz, own_clock)
    delay = np.array([0.0, 0.0, late])
    return Alignment(
        AlignmentPlan(streams, 0, 3, 1, "counter", 1000.0, delay), keep_incomplete=keep_incomplete
    )


def block(counter: object, values: object, arrival_ns: int = 0) -> SampleBlock:
    counts = np.asarray(counter, dtype=np.int64)
    return SampleBlock(np.asarray(values, dtype=float).reshape(len(counts), -1), arrival_ns, counts)


def first(counter: object) -> SampleBlock:
    counts = np.asarray(counter, dtype=np.int64)
    return block(counts, np.outer(counts, [1.0, 2.0]))


def joined(pieces: list[Aligned]) -> tuple[IntArray, FloatArray]:
    index = np.concatenate([p.index for p in pieces]) if pieces else np.zeros(0, dtype=np.int64)
    return index, np.vstack([np.hstack([p.u, p.y]) for p in pieces]) if pieces else np.zeros((0, 3))


def assert_conserved(alignment: Alignment, received: dict[str, int]) -> None:
    """Complete samples went with a row, wait, or were refused; here rows are never followed further."""
    for name, count in received.items():
        stream = alignment.streams[name]
        assert stream.waiting + stream.tally.rejected.total() + stream.state.refusals().total() == count


def test_alignment_two_sources_join_by_counter_whoever_comes_first() -> None:
    alignment = pair()
    assert alignment.step("one", first([0, 1, 2, 3]), 256).values == []
    (piece,) = alignment.step("two", block([1, 2], [10.0, 20.0]), 256).values
    assert piece.index.tolist() == [1, 2]
    np.testing.assert_allclose(piece.u[:, 0], [1, 2])
    np.testing.assert_allclose(piece.y, [[2, 10], [4, 20]])
    (piece,) = alignment.step("two", block([3, 4], [30.0, 40.0]), 256).values
    assert piece.index.tolist() == [3]
    assert alignment.streams["one"].tally.rejected == {"unpaired": 1}
    assert_conserved(alignment, {"one": 4, "two": 4})


def test_alignment_partner_that_never_comes_is_counted_after_a_second() -> None:
    alignment = pair()
    for start in range(0, 3000, 500):
        alignment.step("one", first(range(start, start + 500)), None)
    stream = alignment.streams["one"]
    assert stream.tally.rejected["unpaired"] >= 1999
    assert stream.waiting <= 1001
    assert_conserved(alignment, {"one": 3000})


def test_alignment_silence_of_the_reference_does_not_pile_up_the_others() -> None:
    alignment = pair()
    alignment.step("one", first(range(10)), None)
    for start in range(0, 5000, 100):
        alignment.step("two", block(range(start, start + 100), np.zeros(100)), None)
    stream = alignment.streams["two"]
    assert stream.waiting <= 1100
    assert len(stream.index) <= 1200
    assert_conserved(alignment, {"one": 10, "two": 5000})


def smooth(place: FloatArray) -> FloatArray:
    return np.asarray(np.sin(place / 40.0) + 0.3 * np.cos(place / 23.0))


def test_alignment_late_channel_is_read_where_it_was_true() -> None:
    """x2 is read 3.7 samples late: its reading number i shows the motion of instant i - 3.7."""
    alignment = pair(late=0.0037)
    rows = np.arange(400)
    pieces = list(alignment.step("one", first(rows), None).values)
    pieces += alignment.step("two", block(rows, smooth(rows - 3.7)), None).values
    index, values = joined(pieces)
    assert index.tolist() == list(range(400 - 3 - 2))
    np.testing.assert_allclose(values[:, 2], smooth(index), atol=2e-7)
    assert np.abs(values[10:, 2] - smooth(index[10:] - 3.7)).max() > 0.05


def test_alignment_missing_reading_spoils_only_what_needs_it() -> None:
    alignment = pair(late=0.0005, keep_incomplete=True)
    rows = np.arange(60)
    values = smooth(rows - 0.5)
    values[30] = np.nan
    later, sooner = alignment.step("two", block(rows, values), None), alignment.step("one", first(rows), None)
    pieces = [*later.values, *sooner.values]
    index, got = joined(pieces)
    assert index.tolist() == list(range(58))
    assert index[np.isnan(got[:, 2])].tolist() == [0, 28, 29, 30, 31]
    assert np.isfinite(got[:, :2]).all()


def test_alignment_rows_do_not_depend_on_the_order_in_which_blocks_come() -> None:
    rows = np.arange(3000)
    cuts = [("one", s, s + 70) for s in range(0, 3000, 70)] + [
        ("two", s, s + 110) for s in range(0, 3000, 110)
    ]
    found = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        order = sorted(cuts, key=lambda cut: cut[2] + rng.uniform(0, 300))
        alignment, pieces = pair(late=0.0123), []
        sent = {"one": 0, "two": 0}
        for name, begin, end in order:
            # each source's own blocks stay in their order
            part = rows[sent[name] : sent[name] + end - begin]
            sent[name] += end - begin
            if len(part):
                taken = first(part) if name == "one" else block(part, smooth(part))
                pieces += alignment.step(name, taken, None).values
        found.append(joined([*pieces, *alignment.finish().values]))
        assert_conserved(alignment, {"one": 3000, "two": 3000})
    for index, values in found[1:]:
        np.testing.assert_array_equal(index, found[0][0])
        np.testing.assert_array_equal(values, found[0][1])


def played(alignment: Alignment, seconds: float, ppm: float, rate_hz: float, begin_s: float) -> list[Aligned]:
    """Devices "one" at 1 kHz from 0 s, "two" at rate_hz from begin_s, ppm fast; 1 and 5 ms of transport."""
    rng, pieces = np.random.default_rng(3), []
    sent = {"one": 0, "two": 0}
    devices = ("one", 1000.0, 0.0, 0.001), ("two", rate_hz * (1 + ppm * 1e-6), begin_s, 0.005)
    for tick in range(1, round(seconds * 100)):
        now = tick / 100 + rng.uniform(0, 0.004)
        for name, rate, since, delay in devices:
            taken = max(0, int((now - delay - since) * rate) + 1)
            part = np.arange(sent[name], taken)
            if len(part):
                at = (since + part / rate) * 1000.0
                arrival = round((now + rng.exponential(5e-4)) * 1e9) + 10**15
                both = np.column_stack([part, smooth(at)])
                counted = (
                    block(part, both, arrival) if name == "one" else block(part + 77, smooth(at), arrival)
                )
                pieces += alignment.step(name, counted, 65536).values
                sent[name] = taken
    return pieces


def test_alignment_devices_that_count_for_themselves_meet_by_their_clocks() -> None:
    """What is left is a constant: the difference of the transports' delays, which only the model can tell."""
    alignment = pair(own_clock=True)
    pieces = played(alignment, 24.0, 400.0, 1000.0, 0.4567)
    index, values = joined(pieces)
    assert len(index) > 20_000
    assert np.all(np.diff(index) == 1)
    late, found = np.arange(-30.0, 30.0, 0.05), []
    for begin in (3000, 14_000, 20_000):
        part = slice(begin, begin + 2000)
        errors = [np.std(values[part, 2] - smooth(index[part] - shift)) for shift in late]
        found.append(float(late[int(np.argmin(errors))]))
        assert min(errors) < 0.02
    assert abs(abs(found[1]) - 4.0) < 1.5
    assert abs(found[2] - found[1]) < 1.0


def test_alignment_slower_device_is_resampled_to_the_rows() -> None:
    alignment = pair(rate_hz=200.0, own_clock=True)
    index, values = joined(played(alignment, 14.0, -50.0, 200.0, 0.2))
    assert len(index) > 10_000
    part = slice(6000, 8000)
    errors = [np.std(values[part, 2] - smooth(index[part] - shift)) for shift in np.arange(-12.0, 12.0, 0.1)]
    assert min(errors) < 0.02
    stream = alignment.streams["two"]
    total = stream.waiting + stream.tally.rejected.total()
    assert total == stream.newest + 1


def test_alignment_is_what_a_configuration_with_delays_asks_for(tmp_path: Path) -> None:
    """A delay that the force shares moves the time stamps, not the readings against each other."""
    path = example("modbus", tmp_path)
    plain = load(path)
    maps = {"modbus": plain.source[0].map}
    assert isinstance(make_acquisition(plain, maps, np.zeros(2)), SingleSource)
    text = path.read_text(encoding="utf-8").replace('unit = "m"', 'unit = "m"\ndelay_s = 0.0052').replace(
        'unit = "N"', 'unit = "N"\ndelay_s = 0.0015'
    )  # fmt: skip
    path.write_text(text, encoding="utf-8")
    found = make_acquisition(load(path), maps, np.zeros(2))
    assert isinstance(found, Alignment)
    np.testing.assert_allclose(found.plan.delay_s, [0.0, 0.0037, 0.0037])
    assert found.plan.late_s == 0.0015
    rows = np.arange(100)
    pieces = list(found.step("modbus", block(rows, np.column_stack([rows, rows, rows])), None).values)
    pieces += found.finish().values
    index, values = joined(pieces)
    np.testing.assert_allclose(values[5:90, 1] - values[5:90, 0], 3.7)
    assert pieces[0].stamps is not None
    assert pieces[0].stamps[0] == int(index[0]) * 1_000_000 - 1_500_000
