"""Health assessment of sources: of all counted about one, an event an episode, with the most telling cause.

A source that fails does so in several ways at once: a broken frame is refused, and leaves a gap. What is
counted within a moment of the first sign is one episode, reported once, and over when nothing was counted
for a while. What a driver reports by itself (lost, stale, bus-off ...) begins an episode too, in which the
counts add nothing.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from agent.blocks.tuning import QUIET_NS, SETTLE_NS
from agent.types import Reason

RESTART, GAP = "restart", "gap"


_ORDERED = frozenset({"duplicate", "backwards", "missing value", "not finite", "too large", "spike"})
"""Reasons of whoever orders and tests samples: a broken frame explains them, not the other way round."""
_NOT_ITS_OWN = frozenset({"unpaired", "failure", *(reason.name.lower() for reason in Reason)})
"""Another source's fault, or a channel's, which has an alarm of its own."""


@dataclass(frozen=True, slots=True)
class Signs:
    """What is counted about a source since its run began.

    Attributes:
        restarts: how often the device began anew.
        lost: samples refused, or lost on their way, by reason.
        faults: of the line, by name.
        gaps: places where samples are missing.
    """

    restarts: int
    lost: Mapping[str, int]
    faults: Mapping[str, int]
    gaps: int

    def ranked(self) -> list[Counter[str]]:
        """Return the counts in groups, the most telling first."""
        lost = {reason: count for reason, count in self.lost.items() if reason not in _NOT_ITS_OWN}
        broken = {reason: count for reason, count in lost.items() if reason not in _ORDERED}
        ordered = {reason: count for reason, count in lost.items() if reason in _ORDERED}
        groups = ({RESTART: self.restarts}, broken, self.faults, ordered, {GAP: self.gaps})
        return [Counter(dict(group)) for group in groups]


@dataclass(slots=True)
class _Episode:
    """What is going on with one source."""

    counted: list[Counter[str]]
    begun_ns: int | None = None
    newest_ns: int = 0
    said: bool = False
    away: bool = False
    fresh: list[Counter[str]] = field(default_factory=list)


class SourceEvents:
    """The episodes of a rig's sources. Times are monotonic ns."""

    def __init__(self) -> None:
        self._episodes: dict[str, _Episode] = {}

    def reported(self, source: str, now_ns: int, *, away: bool) -> None:
        """Note that the driver reported by itself what is wrong, or (not away) that its source is back."""
        episode = self._episodes.setdefault(source, _Episode(Signs(0, {}, {}, 0).ranked()))
        episode.begun_ns = now_ns if episode.begun_ns is None else episode.begun_ns
        episode.newest_ns, episode.said, episode.away = now_ns, True, away

    def step(self, source: str, signs: Signs, now_ns: int) -> tuple[str, int] | None:
        """Take the counts after a block; return a cause and how often it was counted, where it is due."""
        ranked = signs.ranked()
        episode = self._episodes.get(source)
        if episode is None:
            # what is met when the line is first opened, amid a frame, is nobody's fault
            self._episodes[source] = _Episode(ranked)
            return None
        fresh = [now - before for now, before in zip(ranked, episode.counted, strict=True)]
        episode.counted = ranked
        self._follow(episode, fresh, now_ns)
        return self._due(episode, now_ns)

    def _follow(self, episode: _Episode, fresh: list[Counter[str]], now_ns: int) -> None:
        over = episode.said and not episode.away and now_ns - episode.newest_ns > QUIET_NS
        if over:
            episode.begun_ns = None
            episode.said = False
            episode.fresh = []
        if not any(fresh):
            return
        episode.newest_ns = now_ns
        if episode.begun_ns is None:
            episode.begun_ns, episode.fresh = now_ns, fresh
        elif not episode.said:
            episode.fresh = [old + new for old, new in zip(episode.fresh, fresh, strict=True)]

    def _due(self, episode: _Episode, now_ns: int) -> tuple[str, int] | None:
        waits = episode.begun_ns is None or now_ns - episode.begun_ns < SETTLE_NS
        return None if waits or episode.said else self._say(episode)

    def _say(self, episode: _Episode) -> tuple[str, int]:
        episode.said = True
        telling = next(group for group in episode.fresh if group)
        return max(telling.items(), key=lambda item: item[1])

    def finish(self) -> dict[str, tuple[str, int]]:
        """Return what has not been reported yet, by source."""
        unsaid = {name: e for name, e in self._episodes.items() if e.begun_ns is not None and not e.said}
        return {name: self._say(episode) for name, episode in unsaid.items()}
