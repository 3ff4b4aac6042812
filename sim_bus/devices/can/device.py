"""Simulated CAN devices: on a socketcand daemon, behind an slcan adapter, on a vcan or a virtual bus."""

import threading
from collections.abc import Mapping, Sequence
from typing import Any

from drivers.can.driver import CanSettings
from sim_bus.clock import PlayClock
from sim_bus.devices import guard
from sim_bus.devices.can.kernel import FrameOutlet, KernelFrames, KernelOutlet, VirtualOutlet
from sim_bus.devices.can.packing import Packing, load_database
from sim_bus.devices.can.slcan import SlcanDevice, SlcanText
from sim_bus.devices.can.socketcand import ADAPTERS_REPORT, Endpoint, FrameText, SocketcandDevice
from sim_bus.devices.device import Bench, Device
from sim_bus.devices.pty_line import PtyLine
from sim_bus.devices.stream import Stream
from sim_bus.errors import SimUsageError
from sim_bus.rig.fault_names import FRAMES
from sim_bus.tuning import STOP_S


class BusDevice(Device):
    """One source on a CAN interface of the kernel or a virtual bus; a thread sends at the samples' times."""

    def __init__(self, clock: PlayClock, stream: Stream, outlet: FrameOutlet) -> None:
        super().__init__(clock)
        self._stream = stream
        self._outlet = outlet
        self._received = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="can device", daemon=True)

    def start(self) -> None:
        if self.clock.fast:
            raise SimUsageError(
                f'source "{self._stream.source}": --fast needs a bus whose reader can hold it back'
            )
        self._outlet.open()
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(self._stream.wait_s()):
            if not self._received and self._outlet.has_listener():
                self._received = True
                self._stream.add(self._outlet)
            self._stream.step()

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(STOP_S)
        self._outlet.close()

    def ledger(self) -> Mapping[str, dict[str, Any]]:
        facts = {"bus": self._outlet.bus, "frames_not_sent": self._outlet.not_sent}
        return {self._stream.source: facts | self._stream.ledger()}


def make_stream(bench: Bench, number: int) -> Stream:
    """Return what a source sends on a socketcand daemon."""
    keys = bench.settings(CanSettings, number)
    packing = _packing(bench, number, keys)
    faults = bench.faults(number, text=True)
    text = FrameText(packing.kinds, bench.clock_of(number))
    faults.strange = text.strange
    faults.refuse(ADAPTERS_REPORT, "a daemon does not pass it on; play an adapter (slcan)")
    if keys.checksum is None:
        faults.refuse(("checksum",), "the source's frames have none; give the source a checksum")
    return bench.stream(number, packing.numbers, packing.pack, text, faults)


def _packing(bench: Bench, number: int, keys: CanSettings) -> Packing:
    if keys.counter_modulus is not None:
        raise SimUsageError(
            f"source[{number}].counter_modulus: a counter that ends early cannot be simulated"
        )
    database = load_database(bench.rig.folder / keys.dbc, f"source[{number}].dbc")
    return Packing(database, bench.source(number), fd=keys.fd, keys=keys)


def _bus_device(bench: Bench, number: int, keys: CanSettings) -> Device:
    guard.virtual_can(keys.interface, keys.channel, f"source[{number}].channel")
    packing = _packing(bench, number, keys)
    faults = bench.faults(number)
    faults.refuse(
        ("corrupt", "truncate", "garbage", "split", "disconnect", *FRAMES),
        "cannot be caused on the kernel's interface; ip link set it down, or play a socketcand",
    )
    render = KernelFrames(packing.kinds)
    stream = bench.stream(number, packing.numbers, packing.pack, render, faults)
    outlet = VirtualOutlet if keys.interface == "virtual" else KernelOutlet
    return BusDevice(bench.clock, stream, outlet(keys.channel, render.size))


def make_adapter_stream(bench: Bench, number: int) -> Stream:
    """Return what a source's adapter sends."""
    keys = bench.settings(CanSettings, number)
    faults = bench.faults(number)
    packing = _packing(bench, number, keys)
    text = SlcanText(packing.kinds, bench.rig.rate_hz(number))
    faults.strange = text.strange
    faults.refuse(("checksum",), "cannot be caused behind an adapter; play a socketcand")
    if any(kind.fd for kind in packing.kinds):
        faults.refuse(("remote", "dlc"), "is for classic frames")
    return bench.stream(number, packing.numbers, packing.pack, text, faults)


def make_devices(bench: Bench, numbers: Sequence[int]) -> list[Device]:
    """Return a daemon for each socketcand address, and a device for each other bus."""
    daemons: dict[Endpoint, dict[str, Stream]] = {}
    devices: list[Device] = []
    for number in numbers:
        keys = bench.settings(CanSettings, number)
        where = f"source[{number}]"
        if keys.interface == "slcan":
            link = guard.pty_link(keys.channel, bench.rig.folder, f"{where}.channel")
            devices.append(SlcanDevice(bench.clock, make_adapter_stream(bench, number), PtyLine(link)))
            continue
        if keys.interface != "socketcand":
            devices.append(_bus_device(bench, number, keys))
            continue
        endpoint = Endpoint(guard.loopback(keys.host, f"{where}.host"), keys.port)
        if keys.channel in daemons.setdefault(endpoint, {}):
            raise SimUsageError(f"{where}.channel: {keys.channel} is played for another source already")
        daemons[endpoint][keys.channel] = make_stream(bench, number)
    devices += [SocketcandDevice(bench.clock, endpoint, buses) for endpoint, buses in daemons.items()]
    return devices
