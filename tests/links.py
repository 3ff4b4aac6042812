"""A link whose events are noted, for tests that read it many times before they ask."""

from drivers.port import SampleBlock
from drivers.reconnect import LinkEvent, ReconnectingDriver


class NotedLink(ReconnectingDriver):
    """Reads a driver through its faults and keeps what happened."""

    noted: tuple[LinkEvent, ...] = ()

    def read(self, timeout_s: float) -> SampleBlock:  # type: ignore[override]
        delivery = super().read(timeout_s)
        self.noted += tuple(delivery.events)
        return delivery.block

    def take_events(self) -> list[LinkEvent]:
        events, self.noted = list(self.noted), ()
        return events
