"""From the sources of a configuration to the devices that play them; several on one line share a device."""

import importlib
from collections.abc import Mapping

from sim_bus.devices.device import Bench, Device
from sim_bus.errors import SimUsageError

MAKERS: Mapping[str, str] = {
    "can": "sim_bus.devices.can.device",
    "modbus": "sim_bus.devices.modbus.device",
    "serial": "sim_bus.devices.serial_device",
}
"""For each driver the module whose `make_devices` plays its sources."""


def make_devices(bench: Bench) -> list[Device]:
    """Return the devices of every source; SimUsageError for a source that cannot be played."""
    kinds = [source.driver for source in bench.rig.source]
    foreign = [
        f'source[{n}].driver: "{kind}" cannot be simulated'
        for n, kind in enumerate(kinds)
        if kind not in MAKERS
    ]
    if foreign:
        raise SimUsageError([f"{text}; {', '.join(sorted(MAKERS))} can" for text in foreign])
    devices: list[Device] = []
    for kind in dict.fromkeys(kinds):
        maker = importlib.import_module(MAKERS[kind])
        devices.extend(maker.make_devices(bench, [number for number, k in enumerate(kinds) if k == kind]))
    return devices
