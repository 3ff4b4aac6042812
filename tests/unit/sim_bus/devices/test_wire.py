"""From readings to bytes and back by means of the standard library."""

import struct
from pathlib import Path

import numpy as np
import pytest

from sim_bus.devices import guard
from sim_bus.devices.wire import Feed, Raw, WireNumber
from sim_bus.errors import SimUsageError
from sim_bus.rig.scenario import Scenario, load_scenario
from sim_bus.rig.trajectory import Rig, Trajectory
from sim_bus.tuning import CHUNK
from tests.sim.rigs import rig, ring_config


def test_encode_halves_go_to_even_and_ends_hold() -> None:
    number = WireNumber.of_type("x", "int16", scale=2.0, offset=1.0)
    raw, held = number.encode(np.array([2.0, 4.0, 6.0, -1.0, 1e9, -1e9]))
    assert raw.tolist() == [0, 2, 2, -1, 32767, -32768]
    assert held.tolist() == [False, False, False, False, True, True]


@pytest.mark.parametrize("kind", ["int8", "uint16", "int32", "uint32", "int64", "uint64"])
def test_encode_ends_of_each_type_never_wrap(kind: str) -> None:
    number = WireNumber.of_type("x", kind)
    raw, held = number.encode(np.array([-1e30, 1e30]))
    limits = np.iinfo(kind)
    assert raw[0] == limits.min
    assert raw[1] <= limits.max
    assert raw[1] > limits.max * 0.4999
    assert held.all()


def test_encode_round_trip_stays_within_half_a_step(rng: np.random.Generator) -> None:
    number = WireNumber.of_type("x", "int32", scale=1e-11)
    values = rng.uniform(-0.02, 0.02, 1000)
    raw, held = number.encode(values)
    assert np.abs(raw * 1e-11 - values).max() <= 0.5001e-11
    assert not held.any()


@pytest.mark.parametrize(
    ("kind", "index", "expected"),
    [
        ("uint8", 257, 1),
        ("int8", 128, -128),
        ("uint16", 65536, 0),
        ("uint32", 5, 5),
        ("int16", 32768, -32768),
    ],
)
def test_count_wraps_in_the_bits_of_the_field(kind: str, index: int, expected: int) -> None:
    assert WireNumber.of_type("n", kind).count(np.array([index])).tolist() == [expected]


def feed(scenario: Scenario, scale: float) -> Feed:
    file = rig(ring_config(1))
    numbers = [WireNumber.of_type(name, "int16", s) for name, s in (("F", 1e-3), ("X1", scale), ("X2", 2e-3))]

    def pack(raw: Raw) -> list[bytes]:
        rows = zip(*(raw[name].tolist() for name in ("F", "X1", "X2")), strict=True)
        return [struct.pack(">hhh", *row) for row in rows]

    return Feed(Trajectory(Rig(file, scenario)), file, file.source[0], numbers, pack)


def test_feed_rows_across_chunks_hold_the_readings() -> None:
    scenario = load_scenario("default", {})
    chunk = Rig(rig(ring_config(1)), scenario).advance(2 * CHUNK)
    rows = feed(scenario, 2e-6).rows(CHUNK - 3, CHUNK + 3)
    for row, reading in zip(rows, chunk.readings[CHUNK - 3 : CHUNK + 3], strict=True):
        force, x1, x2 = struct.unpack(">hhh", row)
        assert force == round(reading[0] / 1e-3)
        assert x1 == pytest.approx(reading[1] / 2e-6, abs=0.51)
        assert x2 == pytest.approx(reading[2] / 2e-3, abs=0.51)


def test_feed_saturation_is_counted_to_the_sample() -> None:
    scenario = load_scenario("paper", {})
    coarse = feed(scenario, 2e-7)
    coarse.rows(0, 3000)
    x1 = Rig(rig(ring_config(1)), scenario).advance(3000).readings[:, 1]
    beyond = np.abs(np.rint(x1 / 2e-7)) > 32767
    assert beyond.any()
    assert coarse.saturated(3000) == {"X1": int(beyond.sum())}
    assert coarse.saturated(40) == {"X1": int(beyond[:40].sum())}
    assert feed(scenario, 2e-6).saturated(3000) == {}


def test_feed_channel_scale_and_offset_are_undone_before_the_field() -> None:
    text = ring_config(1).replace('unit = "m"\n', 'unit = "m"\nscale = 1e-6\noffset = 0.5\n', 1)
    file = rig(text)
    numbers = [WireNumber.of_type(name, "int32") for name in ("F", "X1", "X2")]
    trajectory = Trajectory(Rig(file, Scenario.model_validate({"initial": {"all": 0.01}})))
    raw, _ = Feed(trajectory, file, file.source[0], numbers, lambda _: []).raw(trajectory.chunk(0))
    assert raw["X1"][0] * 1e-6 + 0.5 == pytest.approx(0.01, abs=1e-6)


def test_feed_field_that_is_not_there_is_named() -> None:
    file = rig(ring_config(1))
    with pytest.raises(SimUsageError, match="X2"):
        Feed(
            Trajectory(Rig(file, Scenario())),
            file,
            file.source[0],
            [WireNumber.of_type("F", "int16")],
            lambda _: [],
        )


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.1", "::1", "localhost"])
def test_guard_loopback_is_allowed(host: str) -> None:
    assert guard.loopback(host, "source[0].host")


@pytest.mark.parametrize("host", ["192.168.1.10", "0.0.0.0", "::", "plc.example", "8.8.8.8", ""])
def test_guard_other_hosts_look_like_a_real_bus(host: str) -> None:
    with pytest.raises(
        SimUsageError, match=r"source\[0\]\.host: this looks like a real bus; sim never transmits"
    ):
        guard.loopback(host, "source[0].host")


@pytest.mark.parametrize(
    ("interface", "channel", "allowed"),
    [
        ("socketcan", "vcan0", True), ("socketcan", "vcan12", True), ("socketcan", "can0", False),
        ("socketcan", "vcan0x", False), ("slcan", "/dev/ttyUSB0", False), ("pcan", "vcan0", False),
    ],
)  # fmt: skip
def test_guard_can_interfaces(interface: str, channel: str, allowed: bool) -> None:
    if allowed:
        guard.virtual_can(interface, channel, "k")
    else:
        with pytest.raises(SimUsageError, match="real bus"):
            guard.virtual_can(interface, channel, "k")


def test_guard_pty_link_takes_free_paths_and_links_to_pseudo_terminals_only(tmp_path: Path) -> None:
    assert guard.pty_link("free", tmp_path, "k") == tmp_path / "free"
    (tmp_path / "stale").symlink_to("/dev/pts/987654")
    assert guard.pty_link("stale", tmp_path, "k") == tmp_path / "stale"
    (tmp_path / "file").touch()
    (tmp_path / "usb").symlink_to("/dev/ttyUSB0")
    (tmp_path / "null").symlink_to("/dev/null")
    for name in ("file", "usb", "null", "/dev/ttyUSB0", "/dev/shm/x", "../../../../../../dev/ttyS0"):
        with pytest.raises(SimUsageError, match="real bus"):
            guard.pty_link(name, tmp_path, "k")
