"""Reads TCP streams out of a packet capture (libpcap's classic format), by the formats' own documents."""

import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_ETHERNET, _RAW = 1, 101
_IPV4, _VLAN, _TCP = 0x0800, 0x8100, 6


@dataclass(frozen=True, slots=True)
class Segment:
    """What one TCP packet carried.

    Attributes:
        source, target: (address, port).
        number: sequence number of the first byte.
        data: the bytes.
        syn: whether the connection begins.
    """

    source: tuple[str, int]
    target: tuple[str, int]
    number: int
    data: bytes
    syn: bool


def packets(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield each packet as captured, with the link type."""
    raw = path.read_bytes()
    order = {b"\xd4\xc3\xb2\xa1": "<", b"\xa1\xb2\xc3\xd4": ">"}[raw[:4]]
    (link,) = struct.unpack_from(f"{order}I", raw, 20)
    place = 24
    while place + 16 <= len(raw):
        (size,) = struct.unpack_from(f"{order}I", raw, place + 8)
        yield link, raw[place + 16 : place + 16 + size]
        place += 16 + size


def segments(path: Path) -> Iterator[Segment]:
    """Yield the TCP packets of a capture, in its order."""
    for link, packet in packets(path):
        kind, place = (_IPV4, 0) if link == _RAW else (int.from_bytes(packet[12:14], "big"), 14)
        if kind == _VLAN:
            kind, place = int.from_bytes(packet[16:18], "big"), 18
        if kind == _IPV4 and packet[place + 9] == _TCP:
            yield _segment(packet[place : place + int.from_bytes(packet[place + 2 : place + 4], "big")])


def _segment(packet: bytes) -> Segment:
    header = 4 * (packet[0] & 15)
    source, target = (".".join(map(str, packet[at : at + 4])) for at in (12, 16))
    tcp = packet[header:]
    from_port, to_port, number = struct.unpack_from(">HHI", tcp)
    return Segment(
        (source, from_port), (target, to_port), number, tcp[4 * (tcp[12] >> 4) :], bool(tcp[13] & 2)
    )


def streams(path: Path) -> dict[tuple[tuple[str, int], tuple[str, int]], list[bytes]]:
    """Return what went each way of each connection, one piece a packet; bytes that were sent twice count
    once."""
    found: dict[tuple[tuple[str, int], tuple[str, int]], list[bytes]] = defaultdict(list)
    due: dict[tuple[tuple[str, int], tuple[str, int]], int] = {}
    for segment in segments(path):
        way = (segment.source, segment.target)
        if segment.syn:
            due[way] = (segment.number + 1) % 2**32
            continue
        ahead = (due.get(way, segment.number) - segment.number) % 2**32
        known = ahead if ahead < 2**31 else 0
        if len(segment.data) > known:
            found[way].append(segment.data[known:])
            due[way] = (segment.number + len(segment.data)) % 2**32
    return dict(found)
