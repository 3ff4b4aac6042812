"""Advisory of channels: an alarm for each one not to be believed, raised once, cleared when it recovers."""

from collections.abc import Iterable, Sequence

import numpy as np

from agent.types import AlarmTransition, EstimateBatch, Reason, SensorEvent, SensorFault, Status

WORDS = {
    Reason.STUCK: "stands still while other channels move",
    Reason.SATURATED: "is at the end of its range",
    Reason.NO_DATA: "gives no readings",
    Reason.SENSOR: "does not fit the motion that the other channels show: its offset or its gain changed",
    Reason.INSEPARABLE: "or the structure changed; the readings do not tell which",
}


class SensorAlarms:
    """The sensor alarms of one rig."""

    def __init__(self, rig: str) -> None:
        self._rig = rig
        self._standing: set[str] = set()
        self._restored: set[str] = set()

    @property
    def any_stand(self) -> bool:
        """Whether a channel cannot be believed now."""
        return bool(self._standing)

    def restore(self, standing: Sequence[str]) -> None:
        """Go on with the channels whose alarms the run before left standing."""
        self._standing = set(standing)
        self._restored = set(standing)

    def start_anew(self) -> None:
        """Go on with standing alarms, though what watched their channels begins anew and knows of none."""
        self._restored = set(self._standing)

    def step(self, events: Iterable[SensorEvent]) -> list[AlarmTransition]:
        """Return the transitions that events make; a fault that stands already is not raised again."""
        changes = []
        for event in events:
            channel = event.fault.channel
            if event.standing != (channel in self._standing):
                (self._standing.add if event.standing else self._standing.discard)(channel)
                changes.append(self._transition(event))
        return changes

    def confirm(self, batch: EstimateBatch) -> list[AlarmTransition]:
        """Return what a batch says of alarms raised by an earlier watch: a valid estimate clears them."""
        valid = (batch.status == Status.VALID).any(axis=1)
        if not self._restored or not valid.any():
            return []
        at = int(np.argmax(valid))
        index, t_ns = int(batch.index[at]), int(batch.t_ns[at])
        names, self._restored = sorted(self._restored), set()
        return self.step(SensorEvent(SensorFault(name, Reason.SENSOR), False, index, t_ns) for name in names)

    def _transition(self, event: SensorEvent) -> AlarmTransition:
        channel, raised = event.fault.channel, event.standing
        words = f"{channel} {WORDS[event.fault.reason]}" if raised else f"{channel} is sound again"
        return AlarmTransition.plain(self._rig, "sensor", channel, event.t_ns, words, stands=raised)
