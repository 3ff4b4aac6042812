"""The gate that every byte written to a device passes: read requests and listed handshakes, nothing else.

Drivers only listen. No other module of this package writes to a descriptor; `permitted` is what the test
suite holds every traced write against.
"""

import re
import socket
import struct
from collections.abc import Callable, Mapping

from drivers.port import DriverError

READ_FUNCTIONS = frozenset({1, 2, 3, 4, 24})
_REQUEST_BYTES = {1: 5, 2: 5, 3: 5, 4: 5, 24: 3}
_SOCKETCAND = re.compile(rb"(< (open [A-Za-z0-9_.-]{1,32}|rawmode) >)+")
_SLCAN = re.compile(rb"(C|S[0-8]|Z[01]|L)\r")
_ASK_FOR_LINK = (18, 1)  # fixed by linux/rtnetlink.h: RTM_GETLINK, NLM_F_REQUEST


class ForbiddenWriteError(DriverError):
    """A driver tried to write what a listener must not; nothing was sent."""


def modbus_pdu(pdu: bytes) -> bool:
    """Tell whether a Modbus protocol data unit is a read request of the right length."""
    return bool(pdu) and pdu[0] in READ_FUNCTIONS and len(pdu) == _REQUEST_BYTES[pdu[0]]


def _modbus_tcp(data: bytes) -> bool:
    header_says = int.from_bytes(data[4:6], "big") == len(data) - 6 and data[2:4] == b"\x00\x00"
    return len(data) >= 8 and header_says and modbus_pdu(data[7:])


def _modbus_rtu(data: bytes) -> bool:
    return len(data) >= 4 and modbus_pdu(data[1:-2])


def _socketcand(data: bytes) -> bool:
    return _SOCKETCAND.fullmatch(data) is not None


def _slcan(data: bytes) -> bool:
    return _SLCAN.fullmatch(data) is not None


def _netlink(data: bytes) -> bool:
    """Tell whether a message asks for one interface and changes nothing."""
    length, kind, flags = struct.unpack_from("=IHH", data.ljust(8, b"\0"))
    return bool(length == len(data) and (kind, flags) == _ASK_FOR_LINK)


_RULES: Mapping[str, Callable[[bytes], bool]] = {
    "modbus-tcp": _modbus_tcp,
    "modbus-rtu": _modbus_rtu,
    "socketcand": _socketcand,
    "slcan": _slcan,
    "netlink": _netlink,
}


def permitted(protocol: str, data: bytes) -> bool:
    """Tell whether a listener may write these bytes; protocols without a rule may write nothing."""
    rule = _RULES.get(protocol)
    return rule is not None and rule(data)


def check(protocol: str, data: bytes) -> bytes:
    """Return the bytes; raise ForbiddenWriteError unless a listener may write them."""
    if not permitted(protocol, data):
        raise ForbiddenWriteError(f"{protocol}: refused to write {data[:16].hex(' ')}: a listener only reads")
    return data


def send(protocol: str, sock: socket.socket, data: bytes) -> None:
    """Write permitted bytes to a socket."""
    sock.sendall(check(protocol, data))
