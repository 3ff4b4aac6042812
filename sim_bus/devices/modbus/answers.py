"""A Modbus unit's answers without a server: requests as bytes in, replies as bytes out."""

from sim_bus.devices.modbus.faults import Framing, join, split
from sim_bus.devices.modbus.units import Unit

_READ = frozenset({3, 4})
_FIFO = 24  # fixed by the Modbus application protocol 1.1b3
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS = 1, 2  # fixed by the Modbus application protocol 1.1b3


class Answers:
    """One unit's registers, and what it answers.

    Args:
        unit: the unit.
        framing: of its line.
    """

    def __init__(self, unit: Unit, framing: Framing) -> None:
        self._unit = unit
        self._framing: Framing = framing
        self._areas = sorted(unit.areas())
        self._start = min((address for address, _ in self._areas), default=0)
        end = max((address + count for address, count in self._areas), default=0)
        self._memory = [0] * (end - self._start)
        unit.renew()

    def reply(self, adu: bytes) -> bytes | None:
        """Return the reply to a request; None where it is for another unit."""
        head, number, pdu = split(adu, self._framing)
        if number != self._unit.settings.device_id:
            return None
        self._unit.asked()
        return join(head, number, self._answer(pdu), self._framing)

    def _answer(self, pdu: bytes) -> bytes:
        function = pdu[0]
        address = int.from_bytes(pdu[1:3], "big")
        count = int.from_bytes(pdu[3:5], "big")
        if function == _FIFO:
            return self._queue(address)
        if function not in _READ:
            return bytes([function | 0x80, _ILLEGAL_FUNCTION])
        if not self._there(address, count):
            return bytes([function | 0x80, _ILLEGAL_ADDRESS])
        if not self._unit.has_fault("hang"):
            self._unit.bring_up(self._memory, self._start, address, count)
        values = self._memory[address - self._start : address - self._start + count]
        return bytes([function, 2 * count]) + _bytes(values)

    def _there(self, address: int, count: int) -> bool:
        """Tell whether every register of a request exists; areas that touch are one."""
        wanted = set(range(address, address + count))
        for first, registers_there in self._areas:
            wanted -= set(range(first, first + registers_there))
        return not wanted

    def _queue(self, address: int) -> bytes:
        values = self._unit.queue(address)
        if values is None:
            return bytes([_FIFO | 0x80, _ILLEGAL_ADDRESS])
        data = _bytes(values)
        return bytes([_FIFO]) + (len(data) + 2).to_bytes(2, "big") + len(values).to_bytes(2, "big") + data


def _bytes(values: list[int]) -> bytes:
    return b"".join(value.to_bytes(2, "big") for value in values)
