"""How the kernel has set up a CAN interface, asked over netlink: nothing of it reaches the bus."""

import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from drivers import write_gate
from drivers.can.bus.bus import BusKeys
from drivers.can.tuning import KERNEL_ANSWER_S

_GET_LINK, _REQUEST = 18, 1
_NAME, _MTU, _INFO = 3, 4, 18
_KIND, _DATA = 1, 2
_BITTIMING, _STATE, _MODE, _RESTART = 1, 4, 5, 6
_LISTEN_ONLY = 0x02
_FD_MTU = 72  # fixed by linux/rtnetlink.h, if_link.h, can.h and can/netlink.h
_NOT_HERE = frozenset({"socketcand", "slcan", "virtual", "udp_multicast"})
"""Buses whose controller is another machine's or the adapter's matter, or that have none."""
STATES = ("error-active", "error-warning", "error-passive", "bus-off", "stopped", "sleeping")


@dataclass(frozen=True, slots=True)
class Link:
    """An interface: its kind ("can", "vcan" ...), and where it has a controller, how that is set up.

    Attributes:
        kind: the kernel's word.
        fd: whether it carries FD frames.
        listen_only: whether the controller keeps silent on the bus; None without a controller.
        state: the controller's state in words; None without one.
        restart_ms: pause before the controller returns from bus-off by itself; 0 for never; None without one.
        bitrate: bit/s; None without a controller.
    """

    kind: str
    fd: bool
    listen_only: bool | None = None
    state: str | None = None
    restart_ms: int | None = None
    bitrate: int | None = None


def look(name: str) -> Link | None:
    """Return how an interface is set up; None where it is not there or the kernel cannot be asked."""
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as asked:
            asked.settimeout(KERNEL_ANSWER_S)
            write_gate.send("netlink", asked, question(name))
            return read_answer(asked.recv(1 << 16))
    except (AttributeError, OSError):
        return None


def question(name: str) -> bytes:
    """Return the request for one interface."""
    text = name.encode() + b"\0"
    attribute = (struct.pack("=HH", 4 + len(text), _NAME) + text).ljust((4 + len(text) + 3) & ~3, b"\0")
    body = struct.pack("=BxHiII", 0, 0, 0, 0, 0) + attribute
    return struct.pack("=IHHII", 16 + len(body), _GET_LINK, _REQUEST, 0, 0) + body


def read_answer(answer: bytes) -> Link | None:
    """Return what an answer says; None for a refusal."""
    if len(answer) < 32 or struct.unpack_from("=H", answer, 4)[0] != _GET_LINK - 2:
        return None
    found = dict(_attributes(answer[32:]))
    info = dict(_attributes(found.get(_INFO, b"")))
    kind = info.get(_KIND, b"").rstrip(b"\0").decode("ascii", "replace")
    fd = _number(found.get(_MTU)) == _FD_MTU
    return _controller(kind, fd, dict(_attributes(info.get(_DATA, b"")))) if kind == "can" else Link(kind, fd)


def _controller(kind: str, fd: bool, data: dict[int, bytes]) -> Link:
    mode = data.get(_MODE, b"")
    state = _number(data.get(_STATE))
    return Link(
        kind,
        fd,
        listen_only=bool(_number(mode[4:8]) & _LISTEN_ONLY),
        state=STATES[state] if state < len(STATES) else None,
        restart_ms=_number(data.get(_RESTART)),
        bitrate=_number(data.get(_BITTIMING)),
    )


def _number(data: bytes | None) -> int:
    return int.from_bytes((data or b"")[:4], "little")


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    while len(data) >= 4:
        length, kind = struct.unpack_from("=HH", data)
        if length < 4:
            return
        yield kind & 0x3FFF, data[4:length]
        data = data[(length + 3) & ~3 :]


def hints(keys: BusKeys) -> tuple[str, ...]:
    """Return what to mind about the interface that the keys name, each "what; advice"."""
    if keys.interface in _NOT_HERE:
        return ()
    if keys.interface != "socketcan":
        what = f"whether {keys.interface} {keys.channel} listens only cannot be seen from here"
        return (f"{what}; see to it with the interface's own tools",)
    link = look(keys.channel)
    return () if link is None else tuple(_minded(keys, link))


def _minded(keys: BusKeys, link: Link) -> Iterator[str]:
    name = keys.channel
    if keys.fd and not link.fd:
        yield (
            f"{name} is set up for classic frames, FD frames do not come; "
            "set fd on (of a vcan: mtu 72), with it down"
        )
    if link.kind != "can":
        return
    if not link.listen_only:
        yield (
            f"{name} is not listen-only: its controller acknowledges frames and can disturb the bus; "
            f"ip link set {name} type can listen-only on, with it down, unless nobody else acknowledges"
        )
    if not link.listen_only and not link.restart_ms:
        yield f"{name} stays off the bus after bus-off; ip link set {name} type can restart-ms 100"
    if keys.bitrate is not None and link.bitrate not in (0, keys.bitrate):
        yield (
            f"{name} runs at {link.bitrate} bit/s, not at the {keys.bitrate} of the configuration; "
            "set one of the two"
        )
