"""Clocks of a rig's devices against the gateway's, and how late sources are read: for people and reports."""

from dataclasses import dataclass, field

from agent.blocks.acquisition.interface import SourceState
from agent.numerics.preprocessing.drift import ClockFit, Drift
from agent.records import SourceClock


@dataclass(slots=True)
class SourceClocks:
    """The clock of each source, from its newest samples and when they arrived."""

    _fits: dict[str, ClockFit] = field(default_factory=dict)
    _restarts: dict[str, int] = field(default_factory=dict)

    def observe(self, state: SourceState, arrival_ns: int) -> None:
        """Note that a block of a source arrived."""
        name, restarts = state.plan.name, state.indexer.restarts
        if state.newest is None:
            return
        if name not in self._fits or restarts != self._restarts[name]:
            self._fits[name] = ClockFit(state.indexer.rate_hz)
            self._restarts[name] = restarts
        self._fits[name].observe(state.newest, arrival_ns)

    def drift(self, source: str) -> Drift | None:
        """Return how fast a source's clock runs, where that is known."""
        return self._fits[source].drift() if source in self._fits else None

    def report(self, source: str, skew_s: float | None, skew_sd_s: float | None) -> SourceClock | None:
        """Return what is known of a source's time; None where nothing is."""
        drift = self.drift(source)
        if drift is None and skew_s is None:
            return None
        return SourceClock(
            None if drift is None else drift.ppm, None if drift is None else drift.sd, skew_s, skew_sd_s
        )
