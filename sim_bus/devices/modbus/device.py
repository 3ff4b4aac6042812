"""Modbus devices, TCP and RTU: pymodbus carries the protocol, the units answer with their registers."""

import asyncio
import socket
import threading
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, ClassVar

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.file_message import ReadFifoQueueRequest, ReadFifoQueueResponse
from pymodbus.server.base import ModbusBaseServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.modbus.settings import ModbusSettings
from sim_bus.clock import PlayClock
from sim_bus.devices import guard
from sim_bus.devices.device import Bench, Device
from sim_bus.devices.modbus.faults import Deliveries, Framing, ReplyFaults, split
from sim_bus.devices.modbus.server import SerialServer, TcpServer
from sim_bus.devices.modbus.units import Unit, make_unit
from sim_bus.devices.pty_line import PtyLine, join
from sim_bus.errors import SimBusError
from sim_bus.tuning import LISTEN_S, STOP_S

_READ = frozenset({3, 4})


def _sim_device(unit: Unit) -> SimDevice:
    """Return the library's view of a unit; every access that is not a read of registers is refused."""

    async def action(
        function: int,
        start: int,
        address: int,
        count: int,
        memory: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        unit.asked()
        if function not in _READ or values is not None:
            return ExcCodes.ILLEGAL_FUNCTION
        if not unit.has_fault("hang"):
            unit.bring_up(memory, start, address, count)
        return None

    unit.renew()
    areas = sorted(unit.areas()) or [(65535, 1)]
    data = [SimData(address, count=count, values=0, datatype=DataType.REGISTERS) for address, count in areas]
    return SimDevice(unit.settings.device_id, simdata=data, action=action)


def _fifo_request(units: Mapping[int, Unit]) -> type[ReadFifoQueueRequest]:
    """Return the function 24 request that answers from the units' queues (the library's own is a dummy)."""

    class Request(ReadFifoQueueRequest):
        async def datastore_update(self, context: Any, device_id: int) -> ModbusPDU:
            unit = units.get(device_id)
            if unit is None:
                return ExceptionResponse(self.function_code, ExcCodes.GATEWAY_NO_RESPONSE)
            unit.asked()
            values = unit.queue(self.address)
            if values is None:
                return ExceptionResponse(self.function_code, ExcCodes.ILLEGAL_ADDRESS)
            return ReadFifoQueueResponse(values=values, dev_id=device_id, transaction_id=self.transaction_id)

    return Request


class ModbusDevice(Device):
    """The units that share one TCP port or serial line, served by a thread with an event loop of its own."""

    framing: ClassVar[Framing]

    def __init__(self, clock: PlayClock, units: Sequence[Unit]) -> None:
        super().__init__(clock)
        self.units = tuple(units)
        self._by_number = {unit.settings.device_id: unit for unit in units}
        self._faults = ReplyFaults(self.framing, units[0].settings.timeout_s, units[0].settings.device_id)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="modbus device", daemon=True)
        self._server: ModbusBaseServer | None = None
        self._keeper: asyncio.Task[None] | None = None

    def start(self) -> None:
        self._thread.start()
        opened: Future[None] = asyncio.run_coroutine_threadsafe(self._serve(), self._loop)
        try:
            opened.result(STOP_S)
        except (OSError, RuntimeError) as error:
            self.stop()
            raise SimBusError(
                f'source "{self.units[0].source}": {self.address} cannot be served: {error}'
            ) from error

    async def _serve(self) -> None:
        self._server = await ModbusDevice._plug(self)
        self._keeper = asyncio.create_task(self._keep_plugged())

    async def _keep_plugged(self) -> None:
        """Let the server die, and come back, when faults say so."""
        while True:
            await asyncio.sleep(LISTEN_S)
            gone = any(unit.has_fault("disconnect") or unit.has_fault("black-hole") for unit in self.units)
            if gone and self._server is not None:
                server, self._server = self._server, None
                await self._unplug(server)
            elif not gone and self._server is None:
                self._server = await self._plug()

    async def _unplug(self, server: ModbusBaseServer) -> None:
        await server.shutdown()  # type: ignore[no-untyped-call]  # the library's has no annotation

    async def _plug(self) -> ModbusBaseServer:
        server = self._make_server([_sim_device(unit) for unit in self.units], self._custom())
        await server.serve_forever(background=True)
        return server

    def opened(self) -> int | None:
        """Return the newest sample at which a connection is made; None where it is closed at once."""
        if any(unit.has_fault("accept-close") for unit in self.units):
            return None
        return max(unit.newest() for unit in self.units)

    def deliveries(self, adu: bytes, opened: int) -> Deliveries:
        """Return what goes out instead of a reply."""
        unit = self._by_number.get(split(adu, self.framing)[1])
        return [(0.0, adu)] if unit is None else self._faults.deliveries(adu, unit.active_faults(opened))

    def _custom(self) -> list[type[ModbusPDU]]:
        return [_fifo_request(self._by_number)]

    @property
    @abstractmethod
    def address(self) -> str:
        """Where the device is reached."""

    @abstractmethod
    def _make_server(self, devices: list[SimDevice], custom: list[type[ModbusPDU]]) -> ModbusBaseServer:
        """Return the server that answers for the units."""

    def stop(self) -> None:
        if not self._thread.is_alive():
            self._loop.close()
            return
        asyncio.run_coroutine_threadsafe(self._shut_down(), self._loop).result(STOP_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(STOP_S)
        self._loop.close()

    async def _shut_down(self) -> None:
        rest = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in rest:
            task.cancel()
        await asyncio.gather(*rest, return_exceptions=True)
        if self._server is not None:
            await self._server.shutdown()  # type: ignore[no-untyped-call]  # the library's has no annotation

    def ledger(self) -> Mapping[str, dict[str, Any]]:
        return {unit.source: {"bus": self.address} | unit.ledger() for unit in self.units}


class ModbusTcpDevice(ModbusDevice):
    """Units behind one TCP port."""

    framing = "tcp"

    def __init__(self, clock: PlayClock, units: Sequence[Unit], host: str, port: int) -> None:
        super().__init__(clock, units)
        self._host, self._port = host, port
        self._hole: list[socket.socket] = []
        self._mute: ModbusBaseServer | None = None

    @property
    def address(self) -> str:
        return f"Modbus TCP {self._host}:{self._port}"

    def start(self) -> None:
        self._refuse_taken_port()
        super().start()

    def _refuse_taken_port(self) -> None:
        """The library only logs a port in use: ask the system first."""
        family = socket.AF_INET6 if ":" in self._host else socket.AF_INET
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((self._host, self._port))
            except OSError as error:
                words = f"port {self._port} on {self._host} cannot be opened: {error.strerror}"
                raise SimBusError(f'source "{self.units[0].source}": {words}') from error

    async def _unplug(self, server: ModbusBaseServer) -> None:
        if not any(unit.has_fault("black-hole") for unit in self.units):
            await super()._unplug(server)
            return
        # its connections stay, and whoever wants a new one stands in a queue that is full
        if isinstance(server.transport, asyncio.Server):
            server.transport.close()
        self._mute = server
        self._hole = _full_queue(self._host, self._port)

    async def _plug(self) -> ModbusBaseServer:
        await self._fill()
        return await super()._plug()

    async def _fill(self) -> None:
        """Let go of what a black hole held."""
        for end in self._hole:
            end.close()
        self._hole.clear()
        if self._mute is not None:
            mute, self._mute = self._mute, None
            await super()._unplug(mute)

    async def _shut_down(self) -> None:
        await self._fill()
        await super()._shut_down()

    def _make_server(self, devices: list[SimDevice], custom: list[type[ModbusPDU]]) -> ModbusBaseServer:
        return TcpServer(self, devices, address=(self._host, self._port), custom_pdu=custom)


def _full_queue(host: str, port: int) -> list[socket.socket]:
    """Return a listener whose queue is full, and those who stand in it: the kernel drops what else knocks."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    ends = [socket.socket(family) for _ in range(4)]
    listener, *waiting = ends
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind((host, port))
    listener.listen(0)
    for end in waiting:
        end.setblocking(False)
        end.connect_ex((host, port))
    return ends


class ModbusRtuDevice(ModbusDevice):
    """Units on a serial line: a pseudo-terminal, joined to a second on whose far end the library listens."""

    framing = "rtu"

    def __init__(self, clock: PlayClock, units: Sequence[Unit], line: PtyLine) -> None:
        super().__init__(clock, units)
        self._line = line
        self._inner = PtyLine(None)
        self._joined = threading.Event()

    @property
    def address(self) -> str:
        return f"Modbus RTU {self._line.path}"

    def start(self) -> None:
        self._line.open()
        self._inner.open()
        threading.Thread(target=join, args=(self._line, self._inner, self._joined), daemon=True).start()
        super().start()

    def stop(self) -> None:
        super().stop()
        self._joined.set()
        self._inner.close()
        self._line.close()

    def _make_server(self, devices: list[SimDevice], custom: list[type[ModbusPDU]]) -> ModbusBaseServer:
        baudrate = self.units[0].settings.baudrate
        port = str(self._inner.path)
        return SerialServer(
            self, devices, framer=FramerType.RTU, port=port, baudrate=baudrate, custom_pdu=custom
        )

    async def _unplug(self, server: ModbusBaseServer) -> None:
        self._line.close()
        await super()._unplug(server)

    async def _plug(self) -> ModbusBaseServer:
        self._line.open()
        return await super()._plug()


def make_devices(bench: Bench, numbers: Sequence[int]) -> list[Device]:
    """Return a device for each TCP port and each serial line of the Modbus sources."""
    ports: dict[tuple[str, int], list[Unit]] = {}
    lines: dict[Path, list[Unit]] = {}
    for number in numbers:
        settings = bench.settings(ModbusSettings, number)
        unit = make_unit(bench, number, settings)
        if settings.transport == "tcp":
            host = guard.loopback(settings.host, f"source[{number}].host")
            ports.setdefault((host, int(settings.port)), []).append(unit)
        else:
            link = guard.pty_link(str(settings.port), bench.rig.folder, f"source[{number}].port")
            lines.setdefault(link, []).append(unit)
    tcp = [ModbusTcpDevice(bench.clock, units, host, port) for (host, port), units in ports.items()]
    return [*tcp, *(ModbusRtuDevice(bench.clock, units, PtyLine(link)) for link, units in lines.items())]
