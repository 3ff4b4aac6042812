"""What every simulated device has: a life, a place in the ledger, a clock shared with the others."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel

from sim_bus.clock import PlayClock
from sim_bus.devices.oscillator import CovariatesAlone, OwnClock, OwnTrajectory, Pace
from sim_bus.devices.stream import Encode, Stream
from sim_bus.devices.wire import Feed, Pack, WireNumber
from sim_bus.errors import SimUsageError
from sim_bus.rig.faults import LineFaults, strikes
from sim_bus.rig.rigfile import RigFile, Source, checked
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Trajectory

SettingsType = TypeVar("SettingsType", bound=BaseModel)


class Device(ABC):
    """A device, or several on one line, that readers reach over a real protocol."""

    def __init__(self, clock: PlayClock) -> None:
        self.clock = clock

    @abstractmethod
    def start(self) -> None:
        """Make the device readable; return when it is. Raises SimBusError when the bus cannot be opened."""

    @abstractmethod
    def stop(self) -> None:
        """Let go of the bus; harmless when stopped already."""

    @abstractmethod
    def ledger(self) -> Mapping[str, dict[str, Any]]:
        """Return what was shown, by source."""


@dataclass(frozen=True, slots=True)
class Bench:
    """What devices are made from.

    Attributes:
        rig: the configuration.
        trajectory: what is played.
        clock: how much of it there is by now.
        scenario: its faults and seed.
        own_trajectories: what devices with clocks of their own read, by source.
    """

    rig: RigFile
    trajectory: Trajectory
    clock: PlayClock
    scenario: Scenario
    own_trajectories: dict[int, OwnTrajectory] = field(default_factory=dict)

    def pace(self, number: int) -> Pace | None:
        """Return how a source's device samples; None where it does so with the rig."""
        name, rigs_rate = self.rig.source_names[number], self.rig.rig.sample_rate_hz
        own = next((own for own in self.scenario.device if own.source in {None, name}), None)
        if own is None and self.rig.rate_hz(number) == rigs_rate:
            return None
        slowness, jitter_s = (1.0, 0.0) if own is None else (own.slowness, own.jitter_s)
        return Pace(rigs_rate, self.rig.rate_hz(number), slowness, jitter_s)

    def clock_of(self, number: int) -> PlayClock:
        """Return what paces a source's device."""
        if self.clock.fast and not self.rig.has_signals(number):
            name = self.rig.source_names[number]
            raise SimUsageError(
                f'--fast: source "{name}": covariates are read by the clock on the wall; play it in real time'
            )
        pace = self.pace(number)
        if pace is None:
            return self.clock
        if self.clock.fast and self.rig.slow_or_fast:
            raise SimUsageError(
                "--fast: devices that sample at other rates (rate_hz) are played in real time only"
            )
        return OwnClock(self.clock, pace)

    def trajectory_of(self, number: int) -> Trajectory:
        """Return what a source's device reads."""
        pace = self.pace(number)
        if not self.rig.has_signals(number):
            rigs_hz = self.rig.rig.sample_rate_hz
            return CovariatesAlone(
                self.trajectory, pace or Pace(rigs_hz, rigs_hz), self.scenario.seed + number
            )
        if pace is None:
            return self.trajectory
        made = OwnTrajectory(self.trajectory, pace, self.scenario.seed + number)
        self.own_trajectories[number] = made
        return made

    def faults(self, number: int, *, text: bool = False) -> LineFaults:
        """Return the faults of a source; text: its line carries text."""
        source = self.source(number)
        struck = strikes(self.scenario, source.driver, source.name, self.rig.rate_hz(number))
        return LineFaults(struck, self.scenario.seed + number, text=text)

    def stream(
        self, number: int, numbers: Sequence[WireNumber], pack: Pack, encode: Encode, faults: LineFaults
    ) -> Stream:
        """Return what a source's device sends by itself: fields packed, rendered, struck by faults."""
        source = self.source(number)
        feed = Feed(self.trajectory_of(number), self.rig, source, numbers, pack, faults.strikes)
        return Stream(source.name, feed, self.clock_of(number), encode, faults)

    def settings(self, model: type[SettingsType], number: int) -> SettingsType:
        """Return a source's own keys as the driver's settings; SimUsageError lists every fault."""
        return checked(model, self.rig.source[number].keys, f"source[{number}]")

    def source(self, number: int) -> Source:
        """Return a source with its name filled in."""
        return self.rig.source[number].model_copy(update={"name": self.rig.source_names[number]})
