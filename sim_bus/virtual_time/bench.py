"""A scenario on its bench: its rig's devices on machines that are played, for `deltak score`."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.can.driver import CanSettings
from drivers.clock import playing
from drivers.modbus.settings import ModbusSettings
from drivers.serial.driver import SerialSettings
from sim_bus.clock import PlayClock
from sim_bus.devices import serial_device
from sim_bus.devices.can import device as can_device
from sim_bus.devices.can import slcan as slcan_device
from sim_bus.devices.device import Bench
from sim_bus.devices.modbus.units import make_unit
from sim_bus.devices.oscillator import OwnTrajectory
from sim_bus.errors import SimUsageError
from sim_bus.player import ledger_of
from sim_bus.rig.faults import check, strikes
from sim_bus.rig.rigfile import RigFile, read_rig
from sim_bus.rig.scenario import Scenario, built_in_names, load_scenario, scenario_path
from sim_bus.rig.trajectory import Rig, Trajectory
from sim_bus.rig.truth import TruthRecorder
from sim_bus.tuning import CHUNK, START_NS
from sim_bus.virtual_time.played import Line, ModbusLine, PlayedSource, PlayedTime, StreamLine


class PlayedBench:
    """The sources of a rig, each on a machine of its own, all playing the same scenario from the same time.

    Args:
        config: the rig's configuration.
        scenario: what is played; it needs an end.

    Raises:
        SimUsageError: the scenario or a source cannot be played.
    """

    def __init__(self, config: Path, scenario: Scenario) -> None:
        self.config = config
        self.scenario = scenario
        self._file: RigFile = read_rig(config)
        if not scenario.duration_s:
            raise SimUsageError(
                "duration_s: without an end nothing can be scored; give the scenario a duration_s"
            )
        if self._file.slow_or_fast:
            names = ", ".join(self._file.slow_or_fast)
            raise SimUsageError(
                f"source {names}: rate_hz: only devices of the rig's rate can be scored; play it (sim)"
            )
        check(scenario, self._file.drivers)
        rate = self._file.rig.sample_rate_hz
        self._rig = Rig(self._file, scenario)
        self._truth = TruthRecorder(self._rig, rate)
        self._trajectory = Trajectory(self._rig, self._truth.keep)
        self.total = round(scenario.duration_s * rate)
        if not self.total:
            raise SimUsageError(
                f"duration_s: {scenario.duration_s:g} s are less than a sample of {1.0 / rate:g} s"
            )
        self._times = {name: PlayedTime() for name in self.sources}
        self._lines: dict[str, Line] = {}
        self._own: dict[int, OwnTrajectory] = {}
        self._machines = {name: self._machine(number, name) for number, name in enumerate(self.sources)}

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources."""
        return self._file.source_names

    @property
    def duration_s(self) -> float:
        """How long the scenario is, s."""
        return self.scenario.duration_s

    @property
    def expect(self) -> Mapping[str, Any]:
        """What is to be found."""
        return self.scenario.expect

    def _machine(self, number: int, name: str) -> PlayedSource:
        time = self._times[name]
        clock = PlayClock(self._file.rig.sample_rate_hz, self.total, (name,), "ready", now_ns=time)
        clock.ready()
        bench = Bench(self._file, self._trajectory, clock, self.scenario)
        self._lines[name] = self._line(bench, number, time)
        time.begin()
        self._own |= bench.own_trajectories
        return PlayedSource(time, self._lines[name])

    def _line(self, bench: Bench, number: int, time: PlayedTime) -> Line:
        driver = self._file.source[number].driver
        if driver == "serial":
            greeting = serial_device.greeting(bench.settings(SerialSettings, number))
            return StreamLine(serial_device.make_stream(bench, number), bench.clock, None, greeting)
        if driver == "modbus":
            settings = bench.settings(ModbusSettings, number)
            return ModbusLine(
                make_unit(bench, number, settings), time, settings.transport, self.scenario.seed
            )
        keys = bench.settings(CanSettings, number)
        if keys.interface == "slcan":
            return StreamLine(
                can_device.make_adapter_stream(bench, number), bench.clock, None, slcan_device.GREETING
            )
        if keys.interface != "socketcand":
            words = f'"{keys.interface}" has no played bus; "socketcand" and "slcan" have'
            raise SimUsageError(f"source[{number}].interface: {words}")
        return StreamLine(can_device.make_stream(bench, number), bench.clock, keys.channel)

    def at(self, source: str) -> AbstractContextManager[None]:
        """Let this thread's drivers live on a source's machine."""
        return playing(self._machines[source])

    def now_s(self, source: str) -> float:
        """Return how long a source has been playing, s."""
        return (self._times[source].now_ns - START_NS) / 1e9

    def strikes(self) -> Sequence[tuple[str, str, int, int]]:
        """Return every fault as (source, name, first sample, end)."""
        rate = self._file.rig.sample_rate_hz
        found = []
        for number, source in enumerate(self.sources):
            driver = self._file.source[number].driver
            found += [(source, s.name, s.first, s.end) for s in strikes(self.scenario, driver, source, rate)]
        return found

    def finish(self) -> Mapping[str, Any]:
        """Return what a truth file holds of the whole scenario, the ledger as text in it."""
        self._trajectory.chunk((self.total - 1) // CHUNK)
        shown = [line.ledger() for line in self._lines.values()]
        ledger = ledger_of(self._file, self.scenario, self._rig, shown, self.total)
        arrays = self._truth.arrays(self.total, ledger)
        for number, trajectory in self._own.items():
            trajectory.chunk((self.total - 1) // CHUNK)
            self._own_readings(arrays["readings"], number, np.concatenate(trajectory.readings)[: self.total])
        return arrays

    def _own_readings(self, readings: Any, number: int, own: Any) -> None:
        """Put what a device with a clock of its own read in place of what it would have read by the rig's."""
        for column, channel in enumerate(self._file.channel):
            if channel.name in self._file.source[number].map:
                readings[:, column] = own[:, column]


def scored() -> list[str]:
    """Return the names of the scenarios that come along with a rig to score them with."""
    return [name for name in built_in_names() if load_scenario(name).rig is not None]


def open_bench(name_or_file: str, more_faults: Sequence[str] = ()) -> PlayedBench:
    """Return the bench of a scenario that names its rig."""
    scenario = load_scenario(name_or_file).with_faults(more_faults)
    if scenario.rig is None:
        raise SimUsageError(
            f"{scenario_path(name_or_file)}: rig: names no configuration to score it with; add one"
        )
    return PlayedBench(scenario.folder / scenario.rig, scenario)
