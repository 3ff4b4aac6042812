"""Health assessment of a rig's channels: what the model finds wrong with one, as alarms and in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from agent.blocks.constants_watch import SOURCE
from agent.numerics.estimator.faults import Finding
from agent.numerics.inference.channels import Fault
from agent.records import HealthEvent
from agent.text import number
from agent.types import Output, Reason, SensorEvent, SensorFault

UNITS = {"force": "N", "displacement": "m", "velocity": "m/s", "acceleration": "m/s²"}


@dataclass(frozen=True, slots=True)
class ChannelWatch:
    """Says what is found of one rig's channels.

    Args:
        rig: its name.
        channels: names and quantities of its channels, outputs first, as the estimator counts them.
    """

    rig: str
    channels: tuple[tuple[str, str], ...]

    def step(self, findings: Sequence[Finding], times: Mapping[int, int]) -> Output[HealthEvent, SensorEvent]:
        """Take what was found, and the samples' times; return what follows from it."""
        records: list[HealthEvent] = []
        alarms: list[SensorEvent] = []
        for found in findings:
            name, t_ns = self.channels[found.fault.channel][0], times[found.sample]
            reason = Reason.STUCK if found.fault.kind == "stood" else Reason.SENSOR
            alarms.append(SensorEvent(SensorFault(name, reason), found.standing, found.sample, t_ns))
            if found.standing:
                records.append(HealthEvent(self.rig, SOURCE, t_ns, found.fault.kind, self.words(found.fault)))
        return Output(records, alarms)

    def words(self, fault: Fault) -> str:
        """Return a fault as a sentence for people."""
        name, quantity = self.channels[fault.channel]
        unit = UNITS.get(quantity, "")
        if fault.kind == "stood":
            return (
                f"{name} stood at {_amount(fault.size, unit)} while the rig moved; "
                "check the sensor and its line"
            )
        if fault.kind == "delay":
            return f"{name} comes {fault.size:.0f} samples late ({fault.size:.1f} ± {number(fault.sd, 2)})"
        if fault.kind == "offset":
            much = "too much" if fault.size > 0 else "too little"
            return (
                f"{name} reads {_amount(abs(fault.size), unit)} {much}; "
                "set its zero anew, and check its mounting"
            )
        return f"{name} reads {_factor(fault)}; check its mounting, sign and scale"


def _factor(fault: Fault) -> str:
    """A gain that changed, in words."""
    if fault.size < -1:
        return f"{number(1 + fault.size, 3)} times what it should: its sign is turned"
    if fault.size > 1:
        return f"{number(1 + fault.size, 3)} times what it should"
    larger = "more" if fault.size > 0 else "less"
    return f"{number(100 * abs(fault.size), 3)} ± {number(100 * fault.sd, 2)} % {larger} than it should"


def _amount(size: float, unit: str) -> str:
    """A quantity with its unit; what is small in thousandths."""
    small = 0 < abs(size) < 0.1 and unit != ""
    return f"{number(1000 * size, 3)} m{unit}" if small else f"{number(size, 3)} {unit}".rstrip()
