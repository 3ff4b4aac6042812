import gc
import importlib.util
import re
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

from drivers.can.log.driver import CanLogDriver, CanLogSettings
from drivers.port import DriverConfigError, SampleBlock, SourceRequest
from tests import peers

# Every log of python-can's own corner cases: frames in it, and those of them that are errors or ask for data.
CORNER_CASES = {
    "issue_1256.asc": (1457, 0, 0),
    "issue_1299.asc": (4, 0, 0),
    "issue_1905.blf": (22, 0, 0),
    "logfile.asc": (20, 4, 4),
    "logfile_errorframes.asc": (12, 3, 2),
    "single_frame.asc": (1, 0, 0),
    "single_frame_us_locale.asc": (1, 0, 0),
    "test_CanErrorFrameExt.blf": (2, 2, 0),
    "test_CanErrorFrames.asc": (4, 4, 0),
    "test_CanFdMessage.asc": (3, 0, 0),
    "test_CanFdMessage.blf": (2, 0, 0),
    "test_CanFdMessage64.asc": (2, 0, 0),
    "test_CanFdMessage64.blf": (2, 0, 2),
    "test_CanFdRemoteMessage.asc": (1, 0, 1),
    "test_CanMessage.asc": (2, 0, 0),
    "test_CanMessage.asc.gz": (2, 0, 0),
    "test_CanMessage.blf": (2, 0, 0),
    "test_CanMessage.trc": (2, 0, 0),
    "test_CanMessage2.blf": (2, 0, 0),
    "test_CanMessage_V1_0_BUS1.trc": (11, 0, 1),
    "test_CanMessage_V1_1.trc": (11, 0, 1),
    "test_CanMessage_V1_3.trc": (11, 0, 1),
    "test_CanMessage_V2_0_BUS1.trc": (11, 0, 1),
    "test_CanMessage_V2_1.trc": (11, 0, 1),
    "test_CanRemoteMessage.asc": (3, 0, 3),
}
DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 9 TRUCK: 8 A
 SG_ n : 0|8@1+ (1,0) [0|0] "" A
 SG_ a : 15|16@0- (0.125,-3) [0|0] "" A
 SG_ b : 28|30@1+ (0.1,0) [0|0] "" A
"""


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "truck.dbc"
    path.write_text(DBC)
    return path


def driver(log: Path, dbc: Path, *fields: str, counter: str | None = None) -> CanLogDriver:
    settings = CanLogSettings(path=log, dbc=dbc)
    return CanLogDriver(SourceRequest("log", settings, fields or ("TRUCK.a", "TRUCK.b"), counter))


def blocks_of(log: CanLogDriver) -> list[SampleBlock]:
    log.open()
    blocks = []
    while True:
        try:
            blocks.append(log.read(0.0))
        except EOFError:
            return blocks


def test_real_truck_log_as_text_and_mf4_reads_what_cantools_reads(dbc: Path) -> None:
    database: Any = cantools.database.load_file(dbc)
    for name in ("can/j1939_2F6913DB.log", "can/j1939_2F6913DB.MF4"):
        if name.endswith("MF4"):
            need_mf4()
        path = peers.data(name)
        with can.LogReader(path) as reader:
            frames = [
                message for message in reader if message.arbitration_id == 9 and not message.is_extended_id
            ]
        expected = [database.decode_message(9, message.data) for message in frames]
        log = driver(path, dbc, counter="TRUCK.n")
        got = np.concatenate([block.values for block in blocks_of(log)])
        assert len(got) == 4724
        np.testing.assert_array_equal(got, [[row["a"], row["b"]] for row in expected])
        assert log.counts.received == 4724


def need_mf4() -> None:
    if importlib.util.find_spec("asammdf") is None:
        peers.missing("MF4 logs: asammdf is not installed (pip install deltak[mf4])")


@pytest.mark.parametrize("name", sorted(CORNER_CASES))
def test_corner_case_log_is_read_to_its_last_frame(
    name: str, dbc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = driver(peers.data(f"can/{name}"), dbc)
    frames = []
    monkeypatch.setattr(
        log, "decoded", lambda batch: frames.append(batch) or SampleBlock(np.empty((0, 2)), 0)
    )
    blocks_of(log)
    table = np.concatenate([batch.table for batch in frames])
    errors, remote = (table["id"] & 0x20000000) != 0, (table["id"] & 0x40000000) != 0
    assert (len(table), int(errors.sum()), int(remote.sum())) == CORNER_CASES[name]


def test_every_corner_case_log_there_is_stands_in_the_list() -> None:
    there = {path.name for path in peers.data("can").iterdir() if path.suffix not in (".dbc", ".MF4", ".log")}
    assert there == set(CORNER_CASES)


@pytest.mark.parametrize("suffix", ["asc", "blf", "log", "trc"])
def test_log_of_every_format_reads_the_same_samples(tmp_path: Path, dbc: Path, suffix: str) -> None:
    rng = np.random.default_rng(1)
    path = tmp_path / f"a.{suffix}"
    messages = [
        can.Message(1.5 + i / 1000, 9, is_extended_id=False, data=rng.integers(0, 256, 8, np.uint8).tobytes())
        for i in range(100)
    ]
    with can.Logger(path) as writer:
        for message in messages:
            writer(message)
    blocks = blocks_of(driver(path, dbc, counter="TRUCK.n"))
    counter = np.concatenate([block.counter for block in blocks if block.counter is not None])
    assert counter.tolist() == [message.data[0] for message in messages]
    t_ns = np.concatenate([block.t_ns for block in blocks if block.t_ns is not None])
    np.testing.assert_allclose(np.diff(t_ns), 1e6, atol=200_000)


@pytest.mark.parametrize("name", ["a.csv", "a.db", "a", "a.gz"])
def test_log_of_an_unknown_format_is_refused_in_words(tmp_path: Path, dbc: Path, name: str) -> None:
    with pytest.raises(DriverConfigError, match="is no CAN log that can be read"):
        driver(tmp_path / name, dbc).open()


@pytest.mark.parametrize("suffix", ["asc", "blf", "log", "trc", "mf4"])
def test_log_that_is_missing_empty_or_rubbish_is_refused_in_words(
    tmp_path: Path, dbc: Path, suffix: str
) -> None:
    with pytest.raises(DriverConfigError):
        driver(tmp_path / f"none.{suffix}", dbc).open()
    for number, content in enumerate((b"", bytes(range(256)) * 40)):
        path = tmp_path / f"{number}.{suffix}"
        path.write_bytes(content)
        with pytest.raises(DriverConfigError, match=path.name):
            driver(path, dbc).open()


def test_log_damaged_further_on_is_read_up_to_there_and_says_so(tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 009#0102030405060708\nrubbish\n(1.1) can0 009#0202030405060708\n")
    log = driver(path, dbc, counter="TRUCK.n")
    assert sum(map(len, blocks_of(log))) == 2
    assert log.counts.faults == {"text": 1}
    assert log.take_notes() == [f"{path}:2: is no frame; it is passed over"]


def cut_log(folder: Path, suffix: str, behind: str, letters: int) -> Path:
    """Write a log of which 50 frames are whole; of the next one stands what comes before and some letters."""
    path = folder / f"cut.{suffix}"
    with can.Logger(path) as writer:
        for number in range(100):
            data = bytes([number, 0x5A, *range(6)])
            writer.on_message_received(
                can.Message(timestamp=1.0 + number / 10, arbitration_id=9, data=data, is_extended_id=False)
            )
    whole = path.read_text()
    place = whole.index(behind, whole.index(" 32 5A 00 01 02") - 8) + len(behind)
    path.write_text(whole[: place + letters])
    return path


@pytest.mark.parametrize(("suffix", "behind", "letters"), [("asc", "d 8", -2), ("trc", " 32 5A", -1)])
def test_log_cut_within_a_line_is_read_up_to_there_and_says_so(
    tmp_path: Path, dbc: Path, suffix: str, behind: str, letters: int
) -> None:
    path = cut_log(tmp_path, suffix, behind, letters)
    log = driver(path, dbc, counter="TRUCK.n")
    assert sum(map(len, blocks_of(log))) == 50
    assert log.counts.faults == {"log": 1}
    (note,) = log.take_notes()
    assert note.startswith(f"{path}: is damaged, its end is not read: ")


def test_measurement_cut_within_its_header_is_refused_without_a_traceback(
    tmp_path: Path, dbc: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("asammdf")
    whole = tmp_path / "whole.mf4"
    with can.Logger(whole) as writer:
        writer.on_message_received(can.Message(timestamp=1.0, arbitration_id=9, data=bytes(8)))
    cut = tmp_path / "cut.mf4"
    cut.write_bytes(whole.read_bytes()[:1000])
    with pytest.raises(DriverConfigError, match=r"cut.mf4: cannot be read as a CAN log"):
        driver(cut, dbc).open()
    gc.collect()
    assert capfd.readouterr().err == ""


def test_log_cut_within_the_bytes_of_a_frame_makes_no_reading_of_what_is_left(
    tmp_path: Path, dbc: Path
) -> None:
    log = driver(cut_log(tmp_path, "asc", " 32 5A", 6), dbc, counter="TRUCK.n")
    assert sum(map(len, blocks_of(log))) == 50
    assert log.counts.rejected == {"dlc": 1}


def two_buses(folder: Path, *wires: str) -> Path:
    """Write 200 frames, those of each interface with its place among `wires` in byte 7, and a line that is
    none."""
    path = folder / "buses.log"
    line_lock = [(i, i % len(wires)) for i in range(200)]
    frames = [f"({1 + i / 1000:.6f}) {wires[turn]} 009#{i:02X}{'00' * 6}{turn:02X}" for i, turn in line_lock]
    path.write_text("\n".join([*frames[:150], "# stopped", *frames[150:], ""]), encoding="ascii")
    return path


def captured(log: Path, dbc: Path, channel: str) -> list[int]:
    """Return the counters that are read of a log by a source that listens to an interface."""
    settings = CanLogSettings(path=log, dbc=dbc, channel=channel)
    reader = CanLogDriver(SourceRequest("log", settings, ("TRUCK.a",), "TRUCK.n"))
    counters = [block.counter.tolist() for block in blocks_of(reader) if block.counter is not None]
    assert reader.counts.faults == {"text": 1}
    return [counter for block in counters for counter in block]


@pytest.mark.parametrize(
    ("wires", "first"), [(("can1", "can0"), 1), (("can0", "can1"), 0), (("can0", "can01"), 0)]
)
def test_log_of_several_interfaces_is_read_of_the_sources_alone(
    wires: tuple[str, ...], first: int, tmp_path: Path, dbc: Path
) -> None:
    assert captured(two_buses(tmp_path, *wires), dbc, "can0") == list(range(first, 200, 2))


def test_log_of_one_interface_of_another_name_is_read(tmp_path: Path, dbc: Path) -> None:
    assert captured(two_buses(tmp_path, "can7"), dbc, "can0") == list(range(200))


def test_log_of_several_interfaces_without_the_sources_is_refused_in_words(tmp_path: Path, dbc: Path) -> None:
    with pytest.raises(
        DriverConfigError, match=r"buses.log: holds frames of can1, can2 and none of can0; name one"
    ):
        captured(two_buses(tmp_path, "can1", "can2"), dbc, "can0")


def test_interface_that_is_named_late_in_a_log_counts_from_its_beginning(tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / "late.log"
    other = "".join(f"({1 + i / 1000:.6f}) can1 009#{i % 256:02X}{'00' * 7}\n" for i in range(60_000))
    path.write_text(f"{other}# stopped\n(99.0) can0 009#07{'00' * 7}\n", encoding="ascii")
    assert captured(path, dbc, "can0") == [7]


def test_interface_of_an_adapter_is_the_name_that_its_recording_has(tmp_path: Path, dbc: Path) -> None:
    assert captured(two_buses(tmp_path, "can1", "ttyACM0"), dbc, "/dev/ttyACM0") == list(range(1, 200, 2))


BUSES = 3


def three_buses(path: Path) -> Path:
    """Write 90 frames, a third of each bus: the frames of bus b have the counters b, b + 3 ..."""
    first = 1 if path.suffix == ".mf4" and "vehicle" in path.stem else 0
    writer: Any = can.MF4Writer if path.suffix == ".mf4" else can.Logger
    with writer(path) as log:
        for i in range(90):
            data = bytes([i, 0, 0, 0, 0, 0, 0, 0])
            log(can.Message(1.5 + i / 1000, 9, is_extended_id=False, data=data, channel=first + i % BUSES))
    return path


def counters(log: Path, dbc: Path, channel: str) -> list[int]:
    settings = CanLogSettings(path=log, dbc=dbc, channel=channel)
    reader = CanLogDriver(SourceRequest("log", settings, ("TRUCK.a",), "TRUCK.n"))
    got = [block.counter for block in blocks_of(reader) if block.counter is not None]
    return np.concatenate(got).tolist()


def of_bus(number: int) -> list[int]:
    return list(range(number, 90, BUSES))


SUFFIXES = ["asc", "blf", "trc", "mf4", "log"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_log_of_several_buses_is_read_of_the_one_that_the_source_names(
    suffix: str, tmp_path: Path, dbc: Path
) -> None:
    if suffix == "mf4":
        need_mf4()
    path = three_buses(tmp_path / f"buses.{suffix}")
    if suffix == "log":
        path.write_text(re.sub(r"\) (\d) ", r") can\1 ", path.read_text()))
    for number in range(BUSES):
        assert counters(path, dbc, f"can{number}") == of_bus(number)


@pytest.mark.parametrize(("suffix", "first"), [("asc", 1), ("blf", 1), ("trc", 1), ("mf4", 0)])
def test_log_of_several_buses_is_read_of_a_number_as_other_tools_show_it(
    suffix: str, first: int, tmp_path: Path, dbc: Path
) -> None:
    if suffix == "mf4":
        need_mf4()
    path = three_buses(tmp_path / f"buses.{suffix}")
    for number in range(BUSES):
        assert counters(path, dbc, str(first + number)) == of_bus(number)


@pytest.mark.parametrize(
    ("suffix", "channel", "names"),
    [
        ("asc", "can7", "1, 2, 3"), ("blf", "can3", "1, 2, 3"), ("trc", "4", "1, 2, 3"),
        ("mf4", "can7", "0, 1, 2"),
        ("asc", "/dev/ttyACM", "1, 2, 3"),
    ],
)  # fmt: skip
def test_log_of_several_buses_without_the_sources_is_refused_with_what_it_holds(
    suffix: str, channel: str, names: str, tmp_path: Path, dbc: Path
) -> None:
    if suffix == "mf4":
        need_mf4()
    path = three_buses(tmp_path / f"buses.{suffix}")
    with pytest.raises(
        DriverConfigError, match=rf"buses.{suffix}: holds frames of channels {names} and none of "
    ):
        counters(path, dbc, channel)


def test_mf4_log_that_numbers_its_buses_from_1_is_not_guessed_at(tmp_path: Path, dbc: Path) -> None:
    """Python-can writes 0 for can0, vehicle loggers 1: can1 may be either."""
    need_mf4()
    path = three_buses(tmp_path / "vehicle.mf4")
    with pytest.raises(
        DriverConfigError, match=r"holds frames of channels 1, 2, 3 and none of can1; name one"
    ):
        counters(path, dbc, "can1")
    assert counters(path, dbc, "1") == of_bus(0)


def test_log_of_several_buses_is_not_searched_for_a_number_that_another_interface_gives(
    tmp_path: Path, dbc: Path
) -> None:
    settings = CanLogSettings(path=three_buses(tmp_path / "a.asc"), dbc=dbc, interface="kvaser", channel="1")
    with pytest.raises(
        DriverConfigError, match=r"channels 1, 2, 3 and none of 1; .* other interfaces number theirs"
    ):
        CanLogDriver(SourceRequest("log", settings, ("TRUCK.a",), "TRUCK.n")).open()


@pytest.mark.parametrize("suffix", ["asc", "blf", "trc"])
def test_log_of_one_bus_of_another_number_is_read(suffix: str, tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / f"one.{suffix}"
    with can.Logger(path) as log:
        for i in range(9):
            log(can.Message(1.5 + i / 1000, 9, is_extended_id=False, data=bytes([i] * 8), channel=4))
    assert counters(path, dbc, "can0") == list(range(9))


def test_frames_of_other_buses_that_are_passed_over_are_said(tmp_path: Path, dbc: Path) -> None:
    path = three_buses(tmp_path / "buses.asc")
    settings = CanLogSettings(path=path, dbc=dbc, channel="can1")
    reader = CanLogDriver(SourceRequest("log", settings, ("TRUCK.a",), "TRUCK.n"))
    blocks_of(reader)
    assert f"{path}: channel 2 is read for can1, frames of others are passed over" in reader.take_notes()


@pytest.mark.parametrize(
    ("name", "channel", "frames"),
    [
        ("logfile.asc", "can0", 8), ("logfile.asc", "2", 7), ("logfile.asc", "can4", 1),
        ("test_CanMessage.trc", "1", 1), ("test_CanMessage.asc.gz", "can1", 1),
        ("j1939_2F6913DB.MF4", "1", 221),
        ("j1939_2F6913DB.MF4", "2", 5367), ("issue_1905.blf", "can0", 22),
    ],
)  # fmt: skip
def test_real_log_of_several_buses_is_read_of_one(
    name: str, channel: str, frames: int, dbc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name.endswith("MF4"):
        need_mf4()
    settings = CanLogSettings(path=peers.data(f"can/{name}"), dbc=dbc, channel=channel)
    log = CanLogDriver(SourceRequest("log", settings, ("TRUCK.a",), "TRUCK.n"))
    tables = []
    monkeypatch.setattr(
        log, "decoded", lambda batch: tables.append(batch.table) or SampleBlock(np.empty((0, 1)), 0)
    )
    blocks_of(log)
    assert sum(map(len, tables)) == frames
