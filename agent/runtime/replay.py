"""`deltak replay`: recordings through the live pipeline, as fast as it goes."""

import ctypes
import gc
import heapq
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from agent import __version__
from agent.blocks.covariates.readings import instants, readings
from agent.blocks.graph import graph_of
from agent.clock import SampleLabels, boot_id, wall_ns
from agent.config import RigConfig, driver_class, learnt_key, load
from agent.config.tables import Source
from agent.errors import RecordingError
from agent.recording.source import is_own, own_recording, own_recordings, without_indexes
from agent.runtime.assembly.source_faults import source_error
from agent.runtime.forecasts.replayed import ReplayedForecasts
from agent.runtime.ledger import Conservation
from agent.runtime.limits import HEALTH_PERIOD_NS
from agent.runtime.pipeline import Pipeline, Prepared, resolutions
from agent.runtime.results import RunSummary
from agent.runtime.sources import part
from agent.runtime.usability import Evidence, assess
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import ClockRecord, FloatArray, IntArray, Record, RunInfo
from drivers.port import Counts, Driver, DriverConfigError, DriverError, SampleBlock, SourceRequest

SOURCE = "recording"
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_COMMIT_S = 0.2
"""Between commits: little is left to write when the last block is estimated."""
_OBJECTS = 20_000
"""New objects between two searches for garbage, of which arrays make none: 700 cost a hundredth of all."""
CAN_LOGS = (".log", ".asc", ".blf", ".trc", ".mf4")

log = logging.getLogger(__name__)

Covariates = tuple[IntArray, Mapping[str, FloatArray]]
"""Instants (n,), ns, and the readings (n,) of each covariate."""


class Track(NamedTuple):
    """What is played: the source that it stands for, and its open driver."""

    source: str
    driver: Driver
    signals: tuple[int, ...] = ()
    """Columns of its blocks that are the model's, where others are covariates."""
    covariates: Mapping[str, int] = MappingProxyType({})


def replay(*, config: Path, recordings: Sequence[Path], db: Path | None) -> dict[str, Any]:
    """Replay recordings one after the other as one run; return the document of CONTRACT section 8.

    Raises ConfigError, ModelError, RecordingError, StoreError.
    """
    rig = load(config)
    started = time.monotonic()
    _keep_freed_memory()
    gc.set_threshold(_OBJECTS)
    with ExitStack() as stack:
        tracks = _tracks(rig, recordings)
        for track in tracks:
            stack.callback(track.driver.close)
        pipeline = make_pipeline(rig, tracks)
        summary = RunSummary(rig, db=None if db is None else str(db))
        writer = _writer(rig, db)
        if writer is not None:
            stack.callback(writer.stop, timeout_s=600.0)
            summary.run_id = writer.run_ids[rig.rig.name]
            _go_on(pipeline, writer, summary)
        evidence = Evidence(rig.rig.sample_rate_hz)
        kept = None if writer is None or db is None else _Kept(writer, _forecasts(rig, db, writer), pipeline)
        for records in _records(pipeline, tracks, evidence):
            summary.take(records)
            evidence.see(records)
            if kept is not None:
                summary.take(kept.keep(records))
        faults = assess(rig, str(recordings[0]), evidence, *_whole_counts(pipeline, tracks, evidence))
    for fault in faults:
        log.warning("%s", fault)
        summary.advise(str(fault))
    return summary.document(time.monotonic() - started)


def _keep_freed_memory() -> None:
    """Let glibc's heap keep what is freed: block sizes recur, and fresh pages cost a tenth of all.

    A long-lived agent gives it back instead, and so does what has no glibc.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        for option, size in ((_M_MMAP_THRESHOLD, 32 << 20), (_M_TRIM_THRESHOLD, 256 << 20)):
            set_option(option, size)


def _go_on(pipeline: Pipeline, writer: StoreWriter, summary: RunSummary) -> None:
    """Begin with what the database has of the rig: what was learnt, and its baselines."""
    name = pipeline.config.rig.name
    pipeline.adopt(writer.learnt[name], writer.covariates[name])
    for words in pipeline.count_from(writer.baselines[name]):
        log.warning("%s", words)
        summary.advise(words)


class _Kept(NamedTuple):
    """Where records go: the store, and the forecasts that are made of what it holds."""

    writer: StoreWriter
    forecasts: ReplayedForecasts
    pipeline: Pipeline

    def keep(self, records: list[Record]) -> list[Record]:
        """Store records and the forecasts that are due; return the alarms of these."""
        self.writer.publish(records)
        found: list[Record] = []
        for made in self.forecasts.step(records):
            alarms = self.pipeline.foreseen(made.outlooks)
            self.writer.publish([*made.records, *alarms])
            found += alarms
        return found


def _forecasts(rig: RigConfig, db: Path, writer: StoreWriter) -> ReplayedForecasts:
    return ReplayedForecasts(rig, db, lambda: writer.flush(600.0))


def _tracks(rig: RigConfig, recordings: Sequence[Path]) -> list[Track]:
    """Return the open drivers of recordings: the agent's own by source, played together, others in turn.

    Raises RecordingError.
    """
    for path in recordings:
        _must_be_a_file(path)
    recordings = without_indexes(recordings)
    own = [path for path in recordings if is_own(path)]
    if not own:
        return [_track(rig, path) for path in recordings]
    if len(own) < len(recordings):
        other = next(path for path in recordings if not is_own(path))
        raise RecordingError.at(
            str(other), f"is no recording of the agent like {own[0]}", "replay each by itself"
        )
    sources = {source.name: source for source in (*rig.source, *rig.covariate_source)}
    return [_divided(name, _open(driver), sources[name]) for name, driver in own_recordings(rig, own).items()]


def _divided(name: str, driver: Driver, source: Source) -> Track:
    """Return the recording of a source, whose columns are its signals, then its covariates."""
    own = len(source.map)
    return Track(
        name, driver, tuple(range(own)), {c: own + place for place, c in enumerate(source.covariates)}
    )


def _track(rig: RigConfig, path: Path) -> Track:
    """Return one recording of all channels, with those covariates that it holds."""
    beside = [one.name for one in rig.covariate]
    if is_own(path) or not beside or path.suffix.lower() in CAN_LOGS:
        return Track(SOURCE, opened(rig, path))
    _must_be_a_file(path)
    own = len(rig.channel)
    places = {name: own + place for place, name in enumerate(beside)}
    return Track(SOURCE, _open(_table(rig, path, beside)), tuple(range(own)), places)


def make_pipeline(rig: RigConfig, tracks: Sequence[Track] = ()) -> Pipeline:
    """Build the pipeline that replays a rig, with the resolution of its sources' wires, else of the first.

    Raises ConfigError, RecordingError.
    """
    steps = []
    for source in rig.source:
        request = SourceRequest(
            source.name, source.settings, tuple(source.map.values()), source.counter, rig.folder
        )
        try:
            steps.append(driver_class(source.driver)(request).resolution())
        except DriverConfigError as error:
            raise source_error([rig], error) from error
    names = {channel.name: channel.name for channel in (*rig.inputs, *rig.outputs)}
    known = resolutions([source.map for source in rig.source], steps)
    if tracks and not rig.source:
        known = resolutions([names], [_seen_steps(rig, tracks[0].driver)[: len(names)]])
    if tracks and tracks[0].source != SOURCE:
        return Pipeline(rig, known, {source.name: source.map for source in rig.source})
    return Pipeline(rig, known, {SOURCE: names})


def _seen_steps(rig: RigConfig, recording: Driver) -> tuple[float, ...]:
    """Return the steps of a recording's inputs and outputs; a switched input is known as well as it is."""
    try:
        steps = recording.resolution()
    except DriverError as error:
        raise RecordingError.at("", str(error), "mend or cut the recording") from error
    inputs = {channel.name for channel in rig.inputs}
    switched = zip(recording.request.fields, steps, recording.switched(), strict=True)
    return tuple(0.0 if held and name in inputs else step for name, step, held in switched)


def opened(rig: RigConfig, path: Path) -> Driver:
    """Return the driver of a recording, open. Raises RecordingError."""
    _must_be_a_file(path)
    kind = (
        own_recording if is_own(path) else dict.fromkeys(CAN_LOGS, _can_log).get(path.suffix.lower(), _table)
    )
    return _open(kind(rig, path))


def _must_be_a_file(path: Path) -> None:
    if path.is_dir():
        raise RecordingError.at(str(path), "is a folder, no recording", "give the files in it")
    if path.exists() and not path.is_file():
        advice = "write what comes from there to a file first"
        raise RecordingError.at(str(path), "is a pipe or a device, whose end may never come", advice)


def _open(driver: Driver) -> Driver:
    try:
        driver.open()
    except DriverError as error:
        what, _, advice = str(error).partition("; ")
        raise RecordingError.at("", what, advice or "give one with a column for each channel") from error
    for note in driver.take_notes():
        log.info("%s", note)
    return driver


def _can_log(rig: RigConfig, path: Path) -> Driver:
    """The driver of a log of CAN frames, decoded as the configuration's CAN source says."""
    sources = [source for source in rig.source if source.driver == "can"]
    if len(sources) != 1:
        advice = 'describe the frames by one [[source]] with driver = "can"'
        raise RecordingError.at(str(path), "a CAN log needs the CAN source it was heard on", advice)
    source = sources[0]
    recording = driver_class("can-log")
    channels = [channel.name for channel in (*rig.inputs, *rig.outputs)]
    missing = [name for name in channels if name not in source.map]
    if missing:
        raise RecordingError.at(
            str(path), f"the CAN source does not carry {', '.join(missing)}", "map every channel"
        )
    keys = recording.settings_model.model_fields.keys() & source.settings.model_fields_set
    layout = {key: getattr(source.settings, key) for key in keys}
    settings = recording.settings_model(path=path.absolute(), **layout)  # type: ignore[call-arg]
    fields = tuple(source.map[name] for name in channels)
    return recording(SourceRequest(path.name, settings, fields, source.counter, rig.folder))


def _table(rig: RigConfig, path: Path, beside: Sequence[str] = ()) -> Driver:
    """The driver of a CSV or NPZ recording; beside: covariates, which it may be without."""
    recording = driver_class(SOURCE)
    columns = dict(rig.columns.names)
    settings = recording.settings_model(
        path=path.absolute(), delimiter=rig.columns.delimiter, columns=columns,
        clock="uniform" if rig.rig.clock == "uniform" else "device", optional=tuple(beside),
    )  # type: ignore[call-arg]  # fmt: skip
    names = (*(channel.name for channel in (*rig.inputs, *rig.outputs)), *beside)
    return recording(SourceRequest(path.name, settings, names))


def _writer(rig: RigConfig, db: Path | None) -> StoreWriter | None:
    if db is None:
        return None
    run = RunInfo(
        rig.rig.name, "replay", wall_ns(), __version__, rig.sha256, boot_id=boot_id(),
        learnt_key=learnt_key(rig),
        site=rig.rig.site, labels=rig.rig.labels, graph=graph_of(rig),
    )  # fmt: skip
    writer = StoreWriter(lambda: Store.open(db), [run], lossless=True, period_s=_COMMIT_S)
    writer.start()
    return writer


def _whole_counts(
    pipeline: Pipeline, tracks: Sequence[Track], evidence: Evidence
) -> tuple[Counts, Counter[str]]:
    """Return what all drivers counted and acquisition refused; the drivers' remarks go to the evidence."""
    total = Counts()
    refused = Counter[str]()
    for driver in (track.driver for track in tracks if track.signals or not track.covariates):
        total.received += driver.counts.received
        total.rejected.update(driver.counts.rejected)
        notes = driver.take_notes()
        evidence.notes += notes
        for note in notes:
            log.info("%s", note)
    for state in pipeline.acquisition.sources.values():
        refused.update(state.refusals())
    return total, refused


class _Piece(NamedTuple):
    """What a block leads to before anything is estimated; a block of covariates only leads to no samples."""

    settings: list[ClockRecord]
    covariates: Covariates | None
    prepared: Prepared | None


def _records(pipeline: Pipeline, tracks: Sequence[Track], evidence: Evidence) -> Iterator[list[Record]]:
    """Yield what each block leads to, with the ledger every 10 s of samples and at the end."""
    ledgers = _Ledgers(pipeline, tracks)
    for piece, ledger in _ahead(_pieces(pipeline, tracks, evidence), ledgers.due):
        if piece.covariates is not None:
            pipeline.take_covariates(*piece.covariates)
        if piece.prepared is not None:
            yield [*piece.settings, *pipeline.estimate(piece.prepared)]
        if ledger:
            yield ledger
    yield pipeline.finish()
    yield ledgers.now()


def _ahead(
    pieces: Iterator[_Piece], note: Callable[[_Piece], list[Record]]
) -> Iterator[tuple[_Piece, list[Record]]]:
    """Yield pieces, each noted before another thread makes the next while this one is used."""
    with ThreadPoolExecutor(1) as other:
        coming = other.submit(next, pieces, None)
        while (piece := coming.result()) is not None:
            noted = note(piece)
            coming = other.submit(next, pieces, None)
            yield piece, noted


def _pieces(pipeline: Pipeline, tracks: Sequence[Track], evidence: Evidence) -> Iterator[_Piece]:
    """Yield the blocks, prepared."""
    labels = SampleLabels(pipeline.config.rig.sample_rate_hz)
    played = Counter[str]()
    for track, block in _played(tracks):
        # blocks that were received live are labelled as they were then
        evidence.watch(block)
        received = block.wall_offset_ns is not None
        label = partial(labels.label, arrival_ns=block.arrival_ns, offset_ns=block.wall_offset_ns or 0)
        covariates = _covariates(pipeline, track, block, played)
        if track.covariates and not track.signals:
            yield _Piece([], covariates, None)
            continue
        signals = part(block, track.signals) if track.covariates else block
        pipeline.take(track.source, signals, track.driver.counter_modulus, label if received else None)
        prepared = pipeline.prepare()
        yield _Piece(_settings(pipeline.config.rig.name, labels), covariates, prepared)


def _covariates(
    pipeline: Pipeline, track: Track, block: SampleBlock, played: Counter[str]
) -> Covariates | None:
    """Return the instants and readings of a block's covariates; None where it has none."""
    if not track.covariates:
        return None
    stamps = instants(block, pipeline.config.rig.sample_rate_hz, played[track.source])
    played[track.source] += len(block)
    return stamps, readings(block, track.covariates)


def _settings(rig: str, labels: SampleLabels) -> list[ClockRecord]:
    """Return what stamps mean from now on: how the wall clock was set as the samples were received."""
    found = [ClockRecord(rig, anchor.label_ns, anchor.first, anchor.offset_ns) for anchor in labels.anchors]
    labels.anchors.clear()
    labels.steps.clear()
    return found


class _Ledgers:
    """The ledgers of a replay, which are due every 10 s of samples."""

    def __init__(self, pipeline: Pipeline, tracks: Sequence[Track]) -> None:
        self._pipeline, self._tracks = pipeline, tracks
        self._next: int | None = None

    def due(self, piece: _Piece) -> list[Record]:
        """Return the ledger as of a piece that is prepared and not estimated yet, where it is due."""
        if piece.prepared is None:
            return []
        newest_ns = piece.prepared.newest_ns
        if self._next is not None and self._next - HEALTH_PERIOD_NS <= newest_ns < self._next:
            return []
        self._next = newest_ns + HEALTH_PERIOD_NS
        return self.now(piece.prepared.waiting)

    def now(self, prepared: int = 0) -> list[Record]:
        """Return the ledger; prepared: samples that wait for the estimation alone."""
        counts = {track.source: Counts() for track in self._tracks}
        for source, driver in ((track.source, track.driver) for track in self._tracks):
            counts[source].received += driver.counts.received
            counts[source].rejected.update(driver.counts.rejected)
            counts[source].dropped.update(driver.counts.dropped)
            counts[source].faults.update(driver.counts.faults)
        conservation = {source: Conservation(total, Counter()) for source, total in counts.items()}
        return list(self._pipeline.ledger.health(conservation, self._pipeline.newest_ns, None, prepared))


def _played(tracks: Sequence[Track]) -> Iterator[tuple[Track, SampleBlock]]:
    """Yield the blocks: of several sources in the order of their arrival, of one source track after track."""
    streams = [_blocks(track) for track in tracks]
    if len({track.source for track in tracks}) < 2:
        yield from chain.from_iterable(streams)
    else:
        yield from heapq.merge(*streams, key=lambda delivery: delivery[1].arrival_ns)


def _blocks(track: Track) -> Iterator[tuple[Track, SampleBlock]]:
    while True:
        try:
            yield track, track.driver.read(1.0)
        except EOFError:
            return
        except DriverError as error:
            raise RecordingError.at("", str(error), "mend or cut the recording") from error
