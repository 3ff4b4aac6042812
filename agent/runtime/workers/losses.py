"""What a worker's end cost its rigs: an alarm, and the count of the samples of which nothing is stored."""

from collections.abc import Sequence

from agent.blocks.rig_model import hop_plan
from agent.config import RigConfig
from agent.records import HealthEvent, Record
from agent.types import WORKER, AlarmTransition, EstimateBatch

ENDED, LOST = "ended", "samples lost"
"""What the events are called."""


class Losses:
    """The rigs of all workers: until when there are rows of each, and since when of none."""

    def __init__(self) -> None:
        self._newest: dict[str, int] = {}
        self._broken: dict[str, int] = {}

    def forget(self, rig: str) -> None:
        """Let a rig begin anew, without having lost anything."""
        self._newest.pop(rig, None)
        self._broken.pop(rig, None)

    def ended(self, rig: str, t_ns: int, words: str) -> list[Record]:
        """Note that a rig's worker ended; return what is told of it at t_ns."""
        if rig in self._newest:
            self._broken.setdefault(rig, self._newest[rig])
        message = f"{rig}: {words}; the rig begins anew"
        alarm = AlarmTransition.plain(rig, "source", WORKER, t_ns, message, stands=True)
        return [HealthEvent(rig, WORKER, t_ns, ENDED, message), alarm]

    def see(self, config: RigConfig, batch: EstimateBatch) -> list[Record]:
        """Take rows of a rig; the first after its worker ended say how many samples none was stored of."""
        rig = config.rig.name
        since = self._broken.pop(rig, None)
        self._newest[rig] = int(batch.t_ns[-1])
        if since is None:
            return []
        gone = _between(config, since, batch)
        words = (
            f"{rig}: {gone} samples, {gone / config.rig.sample_rate_hz:.3f} s, were lost as its worker ended"
        )
        return [HealthEvent(rig, WORKER, int(batch.t_ns[0]), LOST, words)]


def _between(config: RigConfig, since_ns: int, batch: EstimateBatch) -> int:
    """Return how many samples passed between a row and a run's first, whose first row ends a hop later."""
    instants = (int(batch.t_ns[0]) - since_ns) / 1e9 * config.rig.sample_rate_hz
    return max(0, round(instants) - hop_plan(config).hop)


def batches_of(records: Sequence[Record]) -> list[EstimateBatch]:
    """Return the rows among records."""
    return [record for record in records if isinstance(record, EstimateBatch)]
