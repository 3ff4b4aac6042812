"""Modbus requests and replies as bytes, over TCP and RTU, each reply held against its request.

pymodbus builds the requests and finds the frames in the stream; every field of a reply is then checked here,
since the library hands out replies of another function, unit, transaction or length as good ones. Pure: no
I/O.
"""

import importlib
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.fields import ByteArray
from drivers.modbus.tuning import REMEMBERED_REQUESTS

if TYPE_CHECKING:
    from pymodbus.framer.base import FramerBase
    from pymodbus.pdu import DecodePDU, ModbusPDU

MAX_REGISTERS = 125
FIFO = 24
FIFO_REGISTERS = 31  # fixed by the Modbus application protocol 1.1b3: read, function 24 and its queue
BUSY = frozenset({5, 6})
"""Exceptions by which a device asks to be asked later."""
GATEWAY = frozenset({10, 11})
"""Exceptions by which a gateway says that a unit behind it is silent."""
ADDRESS, VALUE = 2, 3  # fixed by the protocol's exception codes
REFUSED = frozenset({1, ADDRESS, VALUE})
"""Exceptions by which a device says that it will never answer such a request."""
_LONGEST_TCP = 260  # fixed by Modbus messaging on TCP/IP 1.0b
_LOADING = threading.Lock()
EXCEPTIONS: Mapping[int, str] = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge, still working",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer",
}
"""What a device may answer instead, by its code in the standard."""
UNKNOWN_EXCEPTION = "not a code of the standard"
_ADVICE = {
    1: "look at function, 3 or 4",
    2: "look at address, which counts from 0, at function and at the number of registers",
    3: "the device takes fewer registers at a time, or none here",
    10: "look at the gateway's table of units",
    11: "look at the unit, at device_id and at the gateway's line",
}


class ReplyError(Exception):
    """A reply not answering its request, or none: kind counts it, code is an exception's, data came."""

    def __init__(self, kind: str, words: str, code: int = 0) -> None:
        super().__init__(words)
        self.kind = kind
        self.code = code
        self.data = b""

    @property
    def silent(self) -> bool:
        """Whether the unit itself did not answer, to us or to its gateway."""
        return self.kind == "timeout" or self.code in GATEWAY


@dataclass(frozen=True, slots=True)
class Request:
    """A read request: count registers from address; the whole queue at address for function 24."""

    unit: int
    function: int
    address: int
    count: int = 0

    @property
    def words(self) -> str:
        """The request in words, for messages."""
        if self.function == FIFO:
            return f"function 24, unit {self.unit}, queue {self.address}"
        last = self.address + self.count - 1
        return f"function {self.function}, unit {self.unit}, registers {self.address} to {last}"


def check_reply(pdu: bytes, request: Request) -> ByteArray:
    """Return a reply's register bytes (function code first); ReplyError unless it answers the request."""
    if not pdu:
        raise ReplyError("reply", "an empty reply")
    if pdu[0] == request.function | 0x80:
        raise _exception(pdu, request)
    if pdu[0] != request.function:
        raise ReplyError("reply", f"a reply of function {pdu[0]} to {request.words}")
    return _fifo_bytes(pdu, request) if request.function == FIFO else _register_bytes(pdu, request)


def _exception(pdu: bytes, request: Request) -> ReplyError:
    if len(pdu) != 2:
        return ReplyError("reply", f"an exception of {len(pdu)} bytes to {request.words}")
    named = f"exception {pdu[1]} ({EXCEPTIONS.get(pdu[1], UNKNOWN_EXCEPTION)})"
    advice = f"; {_ADVICE[pdu[1]]}" if pdu[1] in _ADVICE else ""
    return ReplyError(named, f"the device answers {named} to {request.words}{advice}", pdu[1])


def _register_bytes(pdu: bytes, request: Request) -> ByteArray:
    said, true = pdu[1] if len(pdu) > 1 else -1, len(pdu) - 2
    if said != 2 * request.count or true != said:
        raise ReplyError(
            "reply",
            f"a reply of {true} bytes that says {said} where {2 * request.count} belong to {request.words}",
        )
    return np.frombuffer(pdu, np.uint8, offset=2)


def _fifo_bytes(pdu: bytes, request: Request) -> ByteArray:
    said = int.from_bytes(pdu[1:3], "big")
    count = int.from_bytes(pdu[3:5], "big")
    if len(pdu) < 5 or said != len(pdu) - 3 or said != 2 + 2 * count or count > FIFO_REGISTERS:
        raise ReplyError(
            "reply", f"a reply whose counts ({said} bytes, {count} registers) disagree to {request.words}"
        )
    return np.frombuffer(pdu, np.uint8, offset=5)


class Frames(ABC):
    """One way to put requests and replies on a wire.

    Attributes:
        protocol: its name in `drivers.write_gate`.
        late: of each reply to a request that was given up and stood in the bytes handed to `reply` last, the
            number that `give_up` gave it; 0 where replies do not say what they answer.
    """

    protocol: str
    late: tuple[int, ...] = ()

    @abstractmethod
    def request(self, request: Request) -> bytes:
        """Return the bytes of a request."""

    @abstractmethod
    def reply(self, data: bytes, request: Request) -> ByteArray | None:
        """Return the reply's register bytes, None while there is none; ReplyError if it is no good answer."""

    def give_up(self) -> int:
        """Wait for the last request's reply no longer: should it come, it is ignored. Return its number."""
        return 0

    def restart(self) -> None:  # noqa: B027 (where replies do not say what they answer, there is nothing to forget)
        """Forget what was given up: the connection is new."""

    def partial(self, data: bytes) -> bool:
        """Tell whether the bytes end amid a frame."""
        return bool(data)


class TcpFrames(Frames):
    """Frames with the header of Modbus TCP."""

    protocol = "modbus-tcp"

    def __init__(self) -> None:
        _load_library()
        from pymodbus.framer.socket import FramerSocket

        self._framer: FramerBase = FramerSocket(_decoder())
        self._transaction = 0
        self._given_up: deque[int] = deque(maxlen=REMEMBERED_REQUESTS)

    def request(self, request: Request) -> bytes:
        """Return the bytes of a request with a transaction number of its own."""
        self._transaction = self._transaction % 65535 + 1
        return self._framer.encode(request_pdu(request), request.unit, self._transaction)

    def give_up(self) -> int:
        self._given_up.append(self._transaction)
        return self._transaction

    def restart(self) -> None:
        self._given_up.clear()

    def partial(self, data: bytes) -> bool:
        return bool(self._behind_late(data)[0])

    def reply(self, data: bytes, request: Request) -> ByteArray | None:
        data, self.late = self._behind_late(data)
        if len(data) >= 6:
            _check_header(data)
        used, unit, transaction, pdu = self._framer.decode(data)
        if not used:
            return None
        if transaction != self._transaction:
            raise ReplyError("transaction", f"a reply of transaction {transaction} to {self._transaction}")
        if unit != request.unit:
            raise ReplyError("unit", f"a reply of unit {unit} to {request.words}")
        rest, late = self._behind_late(data[used:])
        self.late += late
        if rest:
            raise ReplyError("reply", f"{len(rest)} bytes too many after the reply to {request.words}")
        return check_reply(pdu, request)

    def _behind_late(self, data: bytes) -> tuple[bytes, tuple[int, ...]]:
        """Return what stands behind the whole replies to requests given up, and the numbers of these."""
        late: list[int] = []
        while len(data) >= 6 and (number := int.from_bytes(data[:2], "big")) in self._given_up:
            size = 6 + int.from_bytes(data[4:6], "big")
            if len(data) < size:
                break
            data = data[size:]
            late.append(number)
        return data, tuple(late)


def _check_header(data: bytes) -> None:
    length = int.from_bytes(data[4:6], "big") + 6
    if data[2:4] != b"\x00\x00":
        raise ReplyError(
            "reply", f"a reply of protocol {int.from_bytes(data[2:4], 'big')}, which is not Modbus"
        )
    if not 8 < length <= _LONGEST_TCP:
        raise ReplyError("reply", f"a reply that says it has {length} bytes")


class RtuFrames(Frames):
    """Frames with the checksum of Modbus RTU; finds the reply behind stray bytes and behind late replies."""

    protocol = "modbus-rtu"

    def __init__(self) -> None:
        _load_library()
        from pymodbus.framer.rtu import FramerRTU

        self._framer: FramerBase = FramerRTU(_decoder())
        self._sent = b""

    def request(self, request: Request) -> bytes:
        self._sent = self._framer.encode(request_pdu(request), request.unit, 0)
        return self._sent

    def reply(self, data: bytes, request: Request) -> ByteArray | None:
        """Return the reply's register bytes, None while there is none; ReplyError for an exception reply.

        The library's framer gives up at a stray byte that looks like a function code, so each place at which
        the expected reply can begin is offered to it by itself. An echo of the request (two-wire adapters) is
        passed over, and so is a sound reply of another length: it answers a request that was given up.
        """
        self.late = ()
        for start in _starts(data, request):
            piece = data[start : start + _rtu_size(data[start:])]
            used, _, _, pdu = self._framer.decode(piece)
            is_whole = used == len(piece) and piece != self._sent
            found = self._checked(pdu, request) if is_whole and pdu else None
            if found is not None:
                return found
        return None

    def _checked(self, pdu: bytes, request: Request) -> ByteArray | None:
        """Return a sound reply's register bytes; None, noted as late, where it answers a request given up."""
        try:
            return check_reply(pdu, request)
        except ReplyError as error:
            if error.code:
                raise
            self.late += (0,)
            return None


def _starts(data: bytes, request: Request) -> list[int]:
    answers = (request.function, request.function | 0x80)
    return [i for i in range(len(data) - 4) if data[i] == request.unit and data[i + 1] in answers]


def _rtu_size(data: bytes) -> int:
    if data[1] & 0x80:
        return 5
    return 6 + int.from_bytes(data[2:4], "big") if data[1] == FIFO else 5 + data[2]


def request_pdu(request: Request) -> bytes:
    """Return a request's function code and data."""
    from pymodbus.pdu.file_message import ReadFifoQueueRequest
    from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadInputRegistersRequest

    pdu: ModbusPDU
    if request.function == FIFO:
        pdu = ReadFifoQueueRequest(address=request.address, dev_id=request.unit)
    else:
        kind = {3: ReadHoldingRegistersRequest, 4: ReadInputRegistersRequest}[request.function]
        pdu = kind(address=request.address, count=request.count, dev_id=request.unit)
    return bytes([request.function]) + bytes(pdu.encode())


def _load_library() -> None:
    """Import pymodbus from its top: threads that first meet it at different modules wait for each other."""
    with _LOADING:
        importlib.import_module("pymodbus")


def _decoder() -> "DecodePDU":
    """Return the library's reply table, its size of a function 24 reply over RTU mended (two bytes short)."""
    from pymodbus.pdu import DecodePDU
    from pymodbus.pdu.file_message import ReadFifoQueueResponse

    class WholeFifoReply(ReadFifoQueueResponse):
        @classmethod
        def calculateRtuFrameSize(cls, data: bytes) -> int:  # noqa: N802 (the library's name)
            return 6 + int.from_bytes(data[2:4], "big") if len(data) >= 4 else 0

    decoder = DecodePDU(False)
    decoder.register(WholeFifoReply)
    return decoder
