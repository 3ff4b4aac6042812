"""Recordings while they are played: whose block comes next, and what each leads to."""

import logging
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

from agent.blocks.covariates.readings import instants, readings
from agent.clock import SampleLabels
from agent.errors import Fault, RecordingError
from agent.recording.source import OwnRecording
from agent.records import ClockRecord, Record
from agent.runtime.ledger import Conservation
from agent.runtime.pipeline import Pipeline, Prepared
from agent.runtime.sources import part
from agent.runtime.tuning import HEALTH_PERIOD_NS, MOST_BLOCKS
from agent.runtime.usability import Evidence, assess
from agent.types import FloatArray, IntArray
from drivers.port import Counts, Driver, DriverError, SampleBlock

log = logging.getLogger(__name__)


Covariates = tuple[IntArray, Mapping[str, FloatArray]]
"""Instants (n,), ns, and the readings (n,) of each covariate."""


class Track(NamedTuple):
    """What is played: the source that it stands for, and its open driver.

    Attributes:
        signals: columns of its blocks that are the model's, where others are covariates.
        covariates: the columns of those.
    """

    source: str
    driver: Driver
    signals: tuple[int, ...]
    covariates: Mapping[str, int]


class _Piece(NamedTuple):
    """What a block leads to before anything is estimated; a block of covariates only leads to no samples."""

    settings: list[ClockRecord]
    covariates: Covariates | None
    prepared: Prepared | None


class _Pieces:
    """Where a part ends: with the first block of another hour, or the last of MOST_BLOCKS; None: nowhere."""

    def __init__(self, hour_ns: int | None) -> None:
        self._hour_ns = hour_ns
        self._hour: int | None = None
        self._taken = 0

    def end_with(self, prepared: Prepared | None) -> bool:
        """Tell whether a part ends with a block."""
        if self._hour_ns is None or prepared is None:
            return False
        hour = prepared.newest_ns // self._hour_ns
        self._hour = hour if self._hour is None else self._hour
        self._taken += 1
        return hour != self._hour or self._taken >= MOST_BLOCKS


class Playing:
    """Recordings of one rig on their way through its pipeline, from the first block on.

    Where `can_pause`, it can be pickled between two calls of `records`: what is unpickled, in another process
    too, goes on as this one would, to the last bit.
    """

    def __init__(self, pipeline: Pipeline, tracks: Sequence[Track]) -> None:
        self.pipeline, self.tracks = pipeline, tracks
        self.evidence = Evidence(pipeline.config.rig.sample_rate_hz)
        self.over = False
        self._labels = SampleLabels(pipeline.config.rig.sample_rate_hz)
        self._played = Counter[str]()
        self._due: int | None = None
        self._track = 0
        self._ahead: dict[int, SampleBlock | None] = {}

    @property
    def can_pause(self) -> bool:
        """Tell whether the drivers know how far they have come: of tables and other logs nobody does."""
        return all(isinstance(track.driver, OwnRecording) for track in self.tracks)

    def close(self) -> None:
        """Close the drivers."""
        for track in self.tracks:
            track.driver.close()

    def records(self, hour_ns: int | None = None) -> Iterator[list[Record]]:
        """Yield what each block leads to, with the ledger every 10 s of samples and at the end.

        While one is estimated, another thread reads and prepares the next.

        hour_ns: pause where the samples reach the next multiple of this, at the latest after MOST_BLOCKS; the
            next call goes on from there.
        """
        for records in filter(None, self._records(hour_ns)):
            self.evidence.see(records)
            yield records

    def _records(self, hour_ns: int | None) -> Iterator[list[Record]]:
        with ThreadPoolExecutor(1) as ahead:
            pieces = _Pieces(hour_ns if self.can_pause else None)
            coming = ahead.submit(self._piece)
            while (piece := coming.result()) is not None:
                ledger = self._due_ledger(piece.prepared)  # before the next is counted
                pausing = pieces.end_with(piece.prepared)
                if not pausing:
                    coming = ahead.submit(self._piece)
                yield from self._led_to(piece)
                yield ledger
                if pausing:
                    return
        yield self.pipeline.finish()
        yield self.ledger()
        self.over = True

    def _led_to(self, piece: "_Piece") -> Iterator[list[Record]]:
        if piece.covariates is not None:
            self.pipeline.take_covariates(*piece.covariates)
        if piece.prepared is not None:
            yield [*piece.settings, *self.pipeline.estimate(piece.prepared)]

    def _due_ledger(self, prepared: Prepared | None) -> list[Record]:
        """Return the ledger where the samples prepared have come to the next one."""
        if prepared is None:
            return []
        if self._due is not None and self._due - HEALTH_PERIOD_NS <= prepared.newest_ns < self._due:
            return []
        self._due = prepared.newest_ns + HEALTH_PERIOD_NS
        return self.ledger(prepared.waiting)

    def _piece(self) -> "_Piece | None":
        """Return the next block, prepared; None after the last."""
        delivery = self._next()
        if delivery is None:
            return None
        track, block = delivery
        self.evidence.watch(block)
        covariates = self._covariates(track, block)
        if track.covariates and not track.signals:
            return _Piece([], covariates, None)
        # blocks that were received live are labelled as they were then
        received = block.wall_offset_ns is not None
        label = partial(self._labels.label, arrival_ns=block.arrival_ns, offset_ns=block.wall_offset_ns or 0)
        signals = part(block, track.signals) if track.covariates else block
        modulus = track.driver.counter_modulus
        self.pipeline.take(track.source, signals, modulus, label if received else None)
        prepared = self.pipeline.prepare()
        return _Piece(self._settings(), covariates, prepared)

    def _covariates(self, track: Track, block: SampleBlock) -> Covariates | None:
        """Return the instants and readings of a block's covariates; None where it has none."""
        if not track.covariates:
            return None
        stamps = instants(block, self.pipeline.config.rig.sample_rate_hz, self._played[track.source])
        self._played[track.source] += len(block)
        return stamps, readings(block, track.covariates)

    def _settings(self) -> list[ClockRecord]:
        """Return what stamps mean from now on: how the wall clock was set as the samples were received."""
        rig, labels = self.pipeline.config.rig.name, self._labels
        found = [
            ClockRecord(rig, anchor.label_ns, anchor.first, anchor.offset_ns) for anchor in labels.anchors
        ]
        labels.anchors.clear()
        labels.steps.clear()
        return found

    def ledger(self, prepared: int = 0) -> list[Record]:
        """Return what became of samples, by source; prepared: those that wait for the estimation alone."""
        counts = {track.source: Counts() for track in self.tracks}
        for source, driver in ((track.source, track.driver) for track in self.tracks):
            counts[source].received += driver.counts.received
            counts[source].rejected.update(driver.counts.rejected)
            counts[source].dropped.update(driver.counts.dropped)
            counts[source].faults.update(driver.counts.faults)
        conservation = {source: Conservation(total, Counter()) for source, total in counts.items()}
        return list(self.pipeline.ledger.health(conservation, self.pipeline.newest_ns, None, prepared))

    def assessed(self, name: str) -> list[Fault]:
        """Return what to tell the user of what was played; RecordingError where nothing of it is of use."""
        total = Counts()
        refused = Counter[str]()
        for driver in (track.driver for track in self.tracks if track.signals or not track.covariates):
            total.received += driver.counts.received
            total.rejected.update(driver.counts.rejected)
            notes = driver.take_notes()
            self.evidence.notes += notes
            for note in notes:
                log.info("%s", note)
        for state in self.pipeline.acquisition.sources.values():
            refused.update(state.refusals())
        return assess(self.pipeline.config, name, self.evidence, total, refused)

    def _next(self) -> tuple[Track, SampleBlock] | None:
        """Return the next block: of several sources in the order of arrival, of one track after track."""
        if len({track.source for track in self.tracks}) < 2:
            return self._in_turn()
        for number, track in enumerate(self.tracks):
            if number not in self._ahead:
                self._ahead[number] = _block(track)
        waiting = [(block.arrival_ns, number) for number, block in self._ahead.items() if block is not None]
        if not waiting:
            return None
        _, number = min(waiting)
        block = self._ahead.pop(number)
        return None if block is None else (self.tracks[number], block)

    def _in_turn(self) -> tuple[Track, SampleBlock] | None:
        for track in self.tracks[self._track :]:
            block = _block(track)
            if block is not None:
                return track, block
            self._track += 1
        return None


def _block(track: Track) -> SampleBlock | None:
    """Return the next block of a track; None at its end."""
    try:
        return track.driver.read(1.0)
    except EOFError:
        return None
    except DriverError as error:
        raise RecordingError.of(str(error), "mend or cut the recording") from error
