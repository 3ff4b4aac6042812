"""Replies as faults make them: what goes out, and when."""

import struct

import pytest

from drivers.modbus.frames import ReplyError, Request, RtuFrames, TcpFrames
from sim_bus.devices.modbus.faults import Deliveries, ReplyFaults, join, split

PDU = bytes([4, 4, 0, 1, 2, 3])
TCP = struct.pack(">HHHB", 1, 0, 7, 9) + PDU


def out(name: str, adu: bytes = TCP, framing: str = "tcp") -> Deliveries:
    return ReplyFaults(framing, 0.4, 1).deliveries(adu, frozenset({name} if name else ()))


@pytest.mark.parametrize("framing", ["tcp", "rtu"])
def test_join_is_what_split_took_apart(framing: str) -> None:
    head = b"\0\1\0\0" if framing == "tcp" else b""
    adu = join(head, 9, PDU, framing)
    assert split(adu, framing) == (head, 9, PDU)
    assert framing == "rtu" or adu == TCP


def test_deliveries_without_a_fault_are_the_reply_at_once() -> None:
    assert out("") == [(0.0, TCP)]


def test_deliveries_of_a_reset_end_amid_the_answer() -> None:
    (first, half), (then, nothing) = out("reset")
    assert (first, half, nothing) == (0.0, TCP[: len(TCP) // 2], None)
    assert then > 0.0


@pytest.mark.parametrize("name", ["silent", "half-open", "black-hole", "restart"])
def test_deliveries_of_the_silent_are_none(name: str) -> None:
    assert out(name) == []


def test_deliveries_take_their_time() -> None:
    assert out("late") == [(pytest.approx(0.52), TCP)]
    assert out("slow") == [(pytest.approx(0.2), TCP)]
    dribbled = out("dribble")
    assert b"".join(piece for _, piece in dribbled) == TCP
    assert [at for at, _ in dribbled] == sorted({at for at, _ in dribbled})


WRONG = {
    "wrong-unit": "unit", "wrong-transaction": "transaction", "wrong-protocol": "reply",
    "wrong-function": "reply",
    "wrong-count": "reply", "short": "reply", "long": "reply", "garbage": "reply", "duplicate": "reply",
    "exception-2": "exception 2 (illegal data address)", "busy": "exception 6 (device busy)",
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_deliveries_that_are_wrong_are_so_in_that_one_place(name: str) -> None:
    frames = TcpFrames()
    request = Request(9, 4, 0, 2)
    frames.request(request)
    assert frames.reply(TCP, request).tolist() == [0, 1, 2, 3]
    ((_, adu),) = out(name)
    with pytest.raises(ReplyError) as caught:
        frames.reply(adu, request)
    assert caught.value.kind == WRONG[name]


@pytest.mark.parametrize("name", ["corrupt", "truncate"])
def test_deliveries_on_a_serial_line_that_are_broken_are_no_reply(name: str) -> None:
    frames, request = RtuFrames(), Request(9, 4, 0, 2)
    frames.request(request)
    good = join(b"", 9, PDU, "rtu")
    assert frames.reply(good, request).tolist() == [0, 1, 2, 3]
    ((_, adu),) = out(name, good, "rtu")
    assert adu != good
    assert frames.reply(adu, request) is None
