"""Faults of a line, sample by sample, and what the ledger says of them."""

import pytest

from sim_bus.errors import SimUsageError
from sim_bus.faults import KNOWN, LineFaults, Strike, check, strikes
from sim_bus.scenario import Scenario


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
def test_line_faults_change_the_samples_they_name_and_no_others(name: str, first: int, end: int, sent: bytes) -> None:
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
    assert strikes(scenario, "serial", "line", 1000.0) == (Strike("drop", 1500, 1501), Strike("freeze", 2000, 2250))
    one = Scenario.model_validate({"fault": [{"name": "can.drop", "at_s": 1, "source": "b"}]})
    assert strikes(one, "can", "a", 1000.0) == ()


@pytest.mark.parametrize("text", ["serial.drop", "serial.drop@", "@1", "serial.drop@-1", "serial.drop@1+", "x y@1"])
def test_with_faults_malformed_text_is_refused(text: str) -> None:
    with pytest.raises(SimUsageError, match="not of the form"):
        Scenario().with_faults([text])


@pytest.mark.parametrize(("name", "words"), [("serial.melt", "no fault is called"), ("can.drop", "no source")])
def test_check_fault_that_cannot_be_is_refused(name: str, words: str) -> None:
    with pytest.raises(SimUsageError, match=words):
        check(Scenario().with_faults([f"{name}@1"]), ["serial"])


def test_check_every_known_fault_passes() -> None:
    for driver, faults in KNOWN.items():
        check(Scenario().with_faults([f"{driver}.{name}@1" for name in faults]), [driver])
