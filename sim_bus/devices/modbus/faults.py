"""Modbus replies as faults make them: wrong in one place, cut, doubled, late, byte by byte, or none."""

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from drivers import crc
from sim_bus.rig.fault_names import EXCEPTIONS
from sim_bus.tuning import BYTE_S, LATE_SHARE, NOISE_BYTES, SLOW_SHARE

Framing = Literal["tcp", "rtu"]
Deliveries = list[tuple[float, bytes | None]]
"""When, s from now, which bytes go out; None: the connection is reset, no bytes: it is closed."""

_CRC = crc.by_name("CRC-16/MODBUS")
_MUTE = frozenset({"silent", "half-open", "black-hole", "restart"})


def split(adu: bytes, framing: Framing) -> tuple[bytes, int, bytes]:
    """Return a frame's transaction and protocol (TCP), unit and protocol data unit."""
    return (adu[:4], adu[6], adu[7:]) if framing == "tcp" else (b"", adu[0], adu[1:-2])


def join(head: bytes, unit: int, pdu: bytes, framing: Framing) -> bytes:
    """Return a frame with its length or check as they belong."""
    if framing == "tcp":
        return head + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu
    body = bytes([unit]) + pdu
    return body + bytes(_CRC.bytes_of(np.frombuffer(body, np.uint8)[None])[0].tolist())


def _wrong_count(pdu: bytes) -> bytes:
    return pdu[:1] + bytes([(pdu[1] + 2) % 256]) + pdu[2:]


def _short(pdu: bytes) -> bytes:
    return pdu[:1] + bytes([pdu[1] - 2]) + pdu[2:-2]


def _long(pdu: bytes) -> bytes:
    return pdu[:1] + bytes([(pdu[1] + 2) % 256]) + pdu[2:] + bytes(2)


def _exception(code: int) -> Callable[[bytes], bytes]:
    return lambda pdu: bytes([pdu[0] | 0x80, code])


_PDU: Mapping[str, Callable[[bytes], bytes]] = {
    "wrong-function": lambda pdu: bytes([pdu[0] ^ 7]) + pdu[1:],
    "wrong-count": _wrong_count,
    "short": _short,
    "long": _long,
    "busy": _exception(6),
    **{f"exception-{code}": _exception(code) for code in EXCEPTIONS},
}


class ReplyFaults:
    """What becomes of one unit's replies.

    Args:
        framing: of the line.
        timeout_s: what the reader waits for an answer.
        seed: of wrong bits and rubbish.
    """

    def __init__(self, framing: Framing, timeout_s: float, seed: int) -> None:
        self._framing = framing
        self._timeout_s = timeout_s
        self._rng = np.random.default_rng([seed, 5])

    def deliveries(self, adu: bytes, names: frozenset[str]) -> Deliveries:
        """Return what goes out, and when, instead of a good reply while the named faults last."""
        if not names:
            return [(0.0, adu)]
        return [] if names & _MUTE else self._spoilt(self._reframed(adu, names), names)

    def _spoilt(self, adu: bytes, names: frozenset[str]) -> Deliveries:
        if "duplicate" in names:
            adu += adu
        if "reset" in names:
            return [(0.0, adu[: len(adu) // 2]), (BYTE_S, None)]
        if "dribble" in names:
            return [(number * BYTE_S, adu[number : number + 1]) for number in range(len(adu))]
        if "hang-up" in names:
            return [(0.0, adu), (0.0, b"")]
        share = LATE_SHARE if "late" in names else SLOW_SHARE if "slow" in names else 0.0
        return [(share * self._timeout_s, adu)]

    def _reframed(self, adu: bytes, names: frozenset[str]) -> bytes:
        head, unit, pdu = split(adu, self._framing)
        for name in sorted(names & _PDU.keys()):
            if not pdu[0] & 0x80:
                pdu = _PDU[name](pdu)
        if "wrong-unit" in names:
            unit = unit % 247 + 1
        if head and "wrong-transaction" in names:
            head = bytes([head[0] ^ 0x40]) + head[1:]
        if head and "wrong-protocol" in names:
            head = head[:2] + b"\x13\x37"
        return self._damaged(join(head, unit, pdu, self._framing), names)

    def _damaged(self, adu: bytes, names: frozenset[str]) -> bytes:
        if "corrupt" in names:
            place, bit = int(self._rng.integers(len(adu))), int(self._rng.integers(8))
            adu = adu[:place] + bytes([adu[place] ^ 1 << bit]) + adu[place + 1 :]
        if "truncate" in names:
            adu = adu[: len(adu) // 2]
        return self._rng.bytes(NOISE_BYTES) + adu if "garbage" in names else adu
