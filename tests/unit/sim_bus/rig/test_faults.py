"""Faults of a line, sample by sample, and what the ledger says of them."""

import pytest

from sim_bus.errors import SimUsageError
from sim_bus.rig.faults import KNOWN, LineFaults, Strike, check, strikes
from sim_bus.rig.scenario import Scenario


def line(name: str, first: int, end: int, samples: int = 10) -> tuple[bytes, LineFaults]:
    faults = LineFaults([Strike(name, first, end)], 1)
    return b"".join(faults.apply(k, b"<%d>" % k) for k in range(samples)), faults


@pytest.mark.parametrize(
    ("name", "first", "end", "sent"),
    [
        ("drop", 3, 5, b"<0><1><2><5><6><7><8><9>"),
        ("freeze", 3, 5, b"<0><1><2><5><6><7><8><9>"),
        ("duplicate", 3, 4, b"<0><1><2><3><3><4><5><6><7><8><9>"),
        ("reorder", 3, 4, b"<0><1><2><4><3><5><6><7><8><9>"),
        ("truncate", 3, 4, b"<0><1><2><<4><5><6><7><8><9>"),
        ("stall", 3, 6, b"<0><1><2><3><4><5><6><7><8><9>"),
    ],
)
def test_line_faults_change_the_samples_they_name_and_no_others(
    name: str, first: int, end: int, sent: bytes
) -> None:
    data, faults = line(name, first, end)
    assert data == sent
    assert faults.ledger(10) == [{"fault": name, "samples": [(first, end - 1)]}]
    assert faults.ledger(first) == [{"fault": name, "samples": []}]


def test_line_faults_stall_sends_nothing_until_it_ends() -> None:
    faults = LineFaults([Strike("stall", 3, 6)], 1)
    assert [faults.apply(k, b"%d" % k) for k in range(8)] == [b"0", b"1", b"2", b"", b"", b"", b"3456", b"7"]


def test_line_faults_corrupt_is_one_wrong_bit() -> None:
    data, _ = line("corrupt", 3, 4)
    clean, _ = line("drop", 20, 21)
    wrong = [(a, b) for a, b in zip(data, clean, strict=True) if a != b]
    assert [(a ^ b).bit_count() for a, b in wrong] == [1]


def test_line_faults_garbage_comes_before_the_whole_sample() -> None:
    data, _ = line("garbage", 3, 4)
    assert data.startswith(b"<0><1><2>")
    assert data.endswith(b"<3><4><5><6><7><8><9>")
    assert len(data) > 30


def test_strikes_text_of_the_command_line_becomes_samples() -> None:
    scenario = Scenario().with_faults(["serial.drop@1.5s", "serial.freeze@2+0.25s", "can.drop@1"])
    assert strikes(scenario, "serial", "line", 1000.0) == (
        Strike("drop", 1500, 1501),
        Strike("freeze", 2000, 2250),
    )
    one = Scenario.model_validate({"fault": [{"name": "can.drop", "at_s": 1, "source": "b"}]})
    assert strikes(one, "can", "a", 1000.0) == ()


@pytest.mark.parametrize(
    "text", ["serial.drop", "serial.drop@", "@1", "serial.drop@-1", "serial.drop@1+", "x y@1"]
)
def test_with_faults_malformed_text_is_refused(text: str) -> None:
    with pytest.raises(SimUsageError, match="not of the form"):
        Scenario().with_faults([text])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("serial.melt@1", 'no fault is called "serial.melt"; .*--list-faults'),
        ("serial.dorp@1", r"did you mean serial\.drop"),
        ("can.drop@1", r"no source has the driver can; sources are line \(serial\), plc \(modbus\)"),
        ("serial.drop:plc@1", 'no serial source is called "plc"'),
        ("serial.drop:lime@1", 'no serial source is called "lime"'),
    ],
)
def test_check_fault_that_cannot_be_is_refused(text: str, words: str) -> None:
    with pytest.raises(SimUsageError, match=words):
        check(Scenario().with_faults([text]), {"line": "serial", "plc": "modbus"})


def test_with_faults_one_that_would_never_come_is_refused() -> None:
    nine = Scenario(duration_s=9.0)
    assert len(nine.with_faults(["serial.drop@8.9", "sensor.stuck@0"]).fault) == 2
    assert len(nine.with_faults(["serial.drop@12"], 20.0).fault) == 1
    assert len(nine.with_faults(["serial.drop@12"], 0.0).fault) == 1
    with pytest.raises(SimUsageError, match="at 9 s all is over, after 9 s"):
        nine.with_faults(["serial.drop@9", "serial.drop@1"])


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"name": "sensor.stuck", "source": "line"}, "strikes a channel, not a source"),
        ({"name": "serial.drop", "channel": "x1"}, "strikes a source, not a channel"),
    ],
)
def test_check_fault_of_the_wrong_thing_is_refused(fault: dict[str, str], words: str) -> None:
    scenario = Scenario.model_validate({"fault": [{"at_s": 1, **fault}]})
    with pytest.raises(SimUsageError, match=words):
        check(scenario, {"line": "serial"})


def test_check_tells_of_every_fault_that_is_wrong() -> None:
    with pytest.raises(SimUsageError) as caught:
        check(Scenario().with_faults(["can.drop@1", "serial.melt@1", "serial.drop@1"]), {"line": "serial"})
    assert len(caught.value.lines) == 2


def test_check_every_known_fault_passes() -> None:
    for driver, faults in KNOWN.items():
        check(Scenario().with_faults([f"{driver}.{name}@1" for name in faults]), {"line": driver})
