"""Health assessment of a rig's channels: what the model finds wrong with one, as alarms and in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from agent.blocks.constants_watch import SOURCE
from agent.config.model.tables import Channel
from agent.numerics.estimator.faults import Finding
from agent.numerics.inference.channels import Fault
from agent.records import HealthEvent
from agent.text import number
from agent.types import Output, Reason, SensorEvent, SensorFault

SMALL_UNITS = frozenset({"N", "m", "m/s", "m/s2", "m/s²"})
"""Fixed by the SI: units of which a thousandth is said with a prefix; "mcounts" and "mmm" are none."""


@dataclass(frozen=True, slots=True)
class Named:
    """A channel as people know it: its name, its unit as configured, and what one of that is in SI."""

    name: str
    unit: str
    factor: float = 1.0

    @classmethod
    def of(cls, channel: Channel) -> "Named":
        """Return how a configured channel is known."""
        return cls(channel.name, channel.unit, channel.si_factor)

    def words_of(self, size: float) -> str:
        """Return a size, SI, in the channel's unit; what is small in thousandths."""
        size = size / self.factor
        small = 0 < abs(size) < 0.1 and self.unit in SMALL_UNITS
        if small:
            return f"{number(1000 * size, 3)} m{self.unit}"
        return f"{number(size, 3)} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class ChannelWatch:
    """Says what is found of one rig's channels.

    Args:
        rig: its name.
        channels: its channels, outputs first, as the estimator counts them.
    """

    rig: str
    channels: tuple[Named, ...]

    def step(self, findings: Sequence[Finding], times: Mapping[int, int]) -> Output[HealthEvent, SensorEvent]:
        """Take what was found, and the samples' times; return what follows from it."""
        records: list[HealthEvent] = []
        alarms: list[SensorEvent] = []
        for found in findings:
            name, t_ns = self.channels[found.fault.channel].name, times[found.sample]
            reason = Reason.STUCK if found.fault.kind == "stood" else Reason.SENSOR
            alarms.append(SensorEvent(SensorFault(name, reason), found.standing, found.sample, t_ns))
            if found.standing:
                records.append(HealthEvent(self.rig, SOURCE, t_ns, found.fault.kind, self.words(found.fault)))
        return Output(records, alarms)

    def words(self, fault: Fault) -> str:
        """Return a fault as a sentence for people."""
        channel = self.channels[fault.channel]
        name = channel.name
        if fault.kind == "stood":
            stood = f"{name} stood at {channel.words_of(fault.size)} while the rig moved"
            return f"{stood}; check the sensor and its line"
        if fault.kind == "delay":
            return f"{name} comes {fault.size:.0f} samples late ({fault.size:.1f} ± {number(fault.sd, 2)})"
        if fault.kind == "offset":
            much = "too much" if fault.size > 0 else "too little"
            reads = f"{name} reads {channel.words_of(abs(fault.size))} {much}"
            return f"{reads}; set its zero anew, and check its mounting"
        return f"{name} reads {_factor(fault)}; check its mounting, sign and scale"


def _factor(fault: Fault) -> str:
    """A gain that changed, in words."""
    if fault.size < -1:
        return f"{number(1 + fault.size, 3)} times what it should: its sign is turned"
    if fault.size > 1:
        return f"{number(1 + fault.size, 3)} times what it should"
    larger = "more" if fault.size > 0 else "less"
    return f"{number(100 * abs(fault.size), 3)} ± {number(100 * fault.sd, 2)} % {larger} than it should"
