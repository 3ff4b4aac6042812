"""A rig being played: the trajectory, the clock and the devices of every source, from start to ledger."""

import os
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sim_bus.clock import PlayClock
from sim_bus.devices.device import Bench, Device
from sim_bus.devices.factory import make_devices
from sim_bus.errors import SimUsageError
from sim_bus.rig.faults import check
from sim_bus.rig.rigfile import RigFile
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Rig, Trajectory
from sim_bus.rig.truth import TruthRecorder
from sim_bus.tuning import CHUNK, LOOK_S


class Player:
    """Plays a scenario on the devices of a configuration.

    Args:
        rig_file: the configuration.
        scenario: what is played.
        duration_s: how long, instead of the scenario's own duration; 0 is without end.
        fast: as fast as the readers read.
        truth: where to write what was played.
        grain_s: for so long samples may gather in a device that sends by itself; for many rigs on one
            processor.

    Raises:
        SimUsageError: the scenario or a source cannot be played.
    """

    def __init__(
        self,
        rig_file: RigFile,
        scenario: Scenario,
        *,
        duration_s: float | None = None,
        fast: bool = False,
        truth: Path | None = None,
        grain_s: float = 0.0,
    ) -> None:
        seconds = scenario.duration_s if duration_s is None else duration_s
        check(scenario, rig_file.drivers)
        _check_writable(truth)
        self._scenario = scenario
        self._rig_file = rig_file
        rate = rig_file.rig.sample_rate_hz
        self.rig = Rig(rig_file, scenario)
        self._truth_file = truth
        self._truth = TruthRecorder(self.rig, rate)
        self.trajectory = Trajectory(self.rig, self._truth.keep if truth else None)
        total = round(seconds * rate) if seconds else None
        self.clock = PlayClock(rate, total, rig_file.signal_sources, scenario.start, fast=fast)
        self.clock.grain_s = grain_s
        self.devices: Sequence[Device] = make_devices(Bench(rig_file, self.trajectory, self.clock, scenario))
        self._open: list[Device] = []

    def start(self) -> None:
        """Open every device; SimBusError when one cannot be opened (those that were are closed again)."""
        try:
            for device in self.devices:
                self._open.append(device)
                device.start()
        except BaseException:
            self.stop()
            raise
        self.clock.ready()

    def wait(self, stop: threading.Event, linger_s: float | None) -> None:
        """Return when told to stop, or `linger_s` after the last sample (None: only when told to stop)."""
        while not stop.wait(LOOK_S):
            if linger_s is not None and self.clock.finished():
                stop.wait(linger_s)
                return

    def stop(self) -> None:
        """Close the devices."""
        while self._open:
            self._open.pop().stop()

    def finish(self) -> dict[str, Any]:
        """Close the devices, write the truth file where one is wanted, and return the ledger."""
        played = self.clock.played()
        self.stop()
        if played:
            self.trajectory.chunk((played - 1) // CHUNK)
        ledger = self.ledger(played)
        if self._truth_file is not None:
            self._truth.write(self._truth_file, played, ledger)
        return ledger

    def ledger(self, played: int) -> dict[str, Any]:
        """Return what was played, in samples."""
        clock = self.clock
        started = {
            "started_monotonic_ns": clock.start_ns,
            "started_wall_ns": clock.start_wall_ns,
            "fast": clock.fast,
        }
        shown = [device.ledger() for device in self.devices]
        return ledger_of(self._rig_file, self._scenario, self.rig, shown, played) | started


def _check_writable(truth: Path | None) -> None:
    """Raise SimUsageError before anything is played where the truth file could not be written in the end."""
    if truth is None:
        return
    if truth.is_dir():
        raise SimUsageError(f"--truth: {truth} is a folder; name a file")
    if not os.access(truth.parent, os.W_OK):
        raise SimUsageError(f"--truth: {truth.parent} is no folder that can be written to")


def ledger_of(
    rig_file: RigFile, scenario: Scenario, rig: Rig, ledgers: Iterable[Mapping[str, Any]], played: int
) -> dict[str, Any]:
    """Return what a rig's devices have played, in samples."""
    return {
        "rig": rig_file.rig.name,
        "scenario": scenario.title,
        "seed": scenario.seed,
        "sample_rate_hz": rig_file.rig.sample_rate_hz,
        "samples": played,
        "first": 0 if played else None,
        "last": played - 1 if played else None,
        "changes": rig.timeline.summary(played),
        "sensors": {
            chain.channel.name: {
                "noise_sd": chain.noise_sd,
                "delay_s": chain.delay_s,
                "affected": chain.affected_before(played),
            }
            for chain in rig.sensors
        },
        "sources": {source: shown for ledger in ledgers for source, shown in ledger.items()},
    }
