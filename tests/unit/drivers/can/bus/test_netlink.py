"""How an interface is set up, as the kernel says; a controller's answers are read in tests/vcan."""

import struct

import pytest

from drivers.can.bus.bus import BusKeys
from drivers.can.bus.netlink import Link, hints, look, question, read_answer


def attribute(kind: int, data: bytes) -> bytes:
    return (struct.pack("=HH", 4 + len(data), kind) + data).ljust((4 + len(data) + 3) & ~3, b"\0")


def answer(
    mode: int = 2, state: int = 0, restart_ms: int = 100, bitrate: int = 500_000, mtu: int = 16
) -> bytes:
    """An RTM_NEWLINK as the kernel lays it out for a controller."""
    data = attribute(1, struct.pack("=I28x", bitrate)) + attribute(4, struct.pack("=I", state))
    data += attribute(5, struct.pack("=II", 0xFF, mode)) + attribute(6, struct.pack("=I", restart_ms))
    info = attribute(18, attribute(1, b"can\0") + attribute(2, data))
    body = bytes(16) + attribute(3, b"can0\0") + attribute(4, struct.pack("=I", mtu)) + info
    return struct.pack("=IHHII", 16 + len(body), 16, 0, 0, 0) + body


@pytest.mark.parametrize(
    ("values", "link"),
    [
        ({}, Link("can", False, True, "error-active", 100, 500_000)),
        ({"mode": 0, "state": 3, "mtu": 72}, Link("can", True, False, "bus-off", 100, 500_000)),
        ({"mode": 0x31, "state": 99, "restart_ms": 0}, Link("can", False, False, None, 0, 500_000)),
    ],
)
def test_answer_of_the_kernel_is_read(values: dict[str, int], link: Link) -> None:
    assert read_answer(answer(**values)) == link


@pytest.mark.parametrize("data", [b"", bytes(40), struct.pack("=IHHIIi", 36, 2, 0, 0, 0, -19) + bytes(16)])
def test_refusal_of_the_kernel_is_no_link(data: bytes) -> None:
    assert read_answer(data) is None


def test_answer_cut_anywhere_is_read_without_a_fault() -> None:
    whole = answer()
    links = [link for end in range(len(whole)) if (link := read_answer(whole[:end]))]
    assert all("can".startswith(link.kind) for link in links)


def test_interface_that_every_machine_has_is_found_and_another_is_not() -> None:
    assert look("lo") == Link("", False)
    assert look("nosuch0") is None


def test_question_is_one_message_for_one_name() -> None:
    asked = question("can0")
    assert struct.unpack_from("=IHH", asked) == (len(asked), 18, 1)
    assert asked.endswith(b"can0\0\0\0\0")


@pytest.mark.parametrize(
    ("interface", "words"),
    [
        ("pcan", "whether pcan can0 listens only cannot be seen"),
        ("socketcand", None),
        ("slcan", None),
        ("virtual", None),
    ],
)
def test_bus_that_is_set_up_elsewhere_is_minded_where_it_has_a_controller_here(
    interface: str, words: str | None
) -> None:
    found = hints(BusKeys(interface=interface, channel="can0"))
    assert [hint.startswith(words or "") for hint in found] == ([True] if words else [])
