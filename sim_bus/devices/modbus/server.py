"""The library's servers, their replies handed out as the device's faults will have them."""

import asyncio
import socket
import struct
from abc import abstractmethod
from typing import Any, Protocol

from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler

from sim_bus.devices.modbus.faults import Deliveries

_AT_ONCE = struct.pack("ii", 1, 0)


class Manners(Protocol):
    """How a device treats its connections."""

    @abstractmethod
    def opened(self) -> int | None:
        """Return which sample was the newest when a connection was made; None to hang up at once."""

    @abstractmethod
    def deliveries(self, adu: bytes, opened: int) -> Deliveries:
        """Return what goes out instead of a reply on a connection made at sample `opened`."""


class _Handler(ServerRequestHandler):
    """One connection."""

    manners: Manners
    opened = 0

    def callback_connected(self) -> None:
        super().callback_connected()
        opened = self.manners.opened()
        if opened is None:
            self.loop.call_soon(self.close)
        self.opened = opened or 0

    def send(self, data: bytes, addr: tuple[Any, ...] | None = None) -> None:
        for delay_s, piece in self.manners.deliveries(data, self.opened):
            if delay_s or not piece:
                self.loop.call_later(delay_s, self._send_later, piece)
            else:
                super().send(piece, addr)

    def _send_later(self, piece: bytes | None) -> None:
        if piece is None:
            self._reset()
        elif not piece:
            self.close()
        elif self.transport is not None:
            super().send(piece)

    def _reset(self) -> None:
        """End the connection with RST instead of FIN: closed without lingering it does."""
        if isinstance(self.transport, asyncio.Transport):
            self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
            self.transport.abort()


class _Mannered:
    """What makes a server of the library hand out its replies as a device's manners will have them."""

    def __init__(self, manners: Manners, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._manners = manners

    def callback_new_connection(self: Any) -> _Handler:
        traces = self.trace_packet, self.trace_pdu, self.trace_connect
        handler = _Handler(self, *traces)  # type: ignore[no-untyped-call]  # the library's has no annotation
        handler.manners = self._manners
        return handler


class TcpServer(_Mannered, ModbusTcpServer):
    """Modbus TCP with manners."""


class SerialServer(_Mannered, ModbusSerialServer):
    """Modbus RTU with manners."""
