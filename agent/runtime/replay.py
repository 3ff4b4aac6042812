"""`deltak replay`: recordings through the live pipeline, as fast as it goes."""

import ctypes
import gc
import logging
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from agent import __version__
from agent.blocks.advisory.prognosis_alarms import PrognosisAlarms
from agent.blocks.graph import graph_of
from agent.clock import boot_id, wall_ns
from agent.config import RigConfig, driver_class, learnt_key, load
from agent.config.tables import Source
from agent.errors import AgentError, RecordingError
from agent.recording.source import is_own, own_recording, own_recordings, without_indexes
from agent.records import Baseline, CovariateMean, Record, RunInfo
from agent.runtime.assembly.source_faults import source_error
from agent.runtime.forecasts.replayed import ReplayedForecasts
from agent.runtime.pipeline import Pipeline, resolutions
from agent.runtime.playing import Playing, Track
from agent.runtime.results import RunSummary
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import Learnt
from drivers.port import Driver, DriverConfigError, DriverError, SourceRequest

SOURCE = "recording"
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_COMMIT_S = 0.05
"""Between commits: little is left to write when the last block is estimated."""
_SWITCH_S = 5e-4
"""Longest that reading and writing hold the interpreter while the estimation, which lets go of it in every
product of matrices, waits for it: a tenth of a replay at Python's 5 ms; below 0.2 ms switching costs more."""
_OBJECTS = 200_000
"""New objects between two searches for garbage, of which arrays make none: 20,000 cost a hundredth of all."""
CAN_LOGS = (".log", ".asc", ".blf", ".trc", ".mf4")

log = logging.getLogger(__name__)


def replay(*, config: Path, recordings: Sequence[Path], db: Path | None) -> dict[str, Any]:
    """Replay recordings one after the other as one run; return the document of CONTRACT section 8.

    Raises ConfigError, ModelError, RecordingError, StoreError.
    """
    rig = load(config)
    started = time.monotonic()
    keep_freed_memory()
    gc.set_threshold(_OBJECTS)
    sys.setswitchinterval(_SWITCH_S)
    with ExitStack() as stack:
        playing = begun(rig, recordings)
        stack.callback(playing.close)
        summary = RunSummary(rig, db=None if db is None else str(db))
        writer = None if db is None else writer_of([rig], db)
        kept = None
        if writer is not None and db is not None:
            stack.callback(writer.stop, timeout_s=600.0)
            summary.run_id = writer.run_ids[rig.rig.name]
            for words in adopted(playing.pipeline, known(rig, writer)):
                summary.advise(words)
            kept = Kept(writer, forecasts(rig, db, writer), playing.pipeline.prognosis_alarms)
        for records in playing.records():
            summary.take(records)
            if kept is not None:
                summary.take(kept.keep(records))
        faults = playing.assessed(str(recordings[0]))
    for fault in faults:
        log.warning("%s", fault)
        summary.advise(str(fault))
    return summary.document(time.monotonic() - started)


def keep_freed_memory() -> None:
    """Let glibc's heap keep what is freed: block sizes recur, and fresh pages cost a tenth of all.

    A long-lived agent gives it back instead, and so does what has no glibc.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        for option, size in ((_M_MMAP_THRESHOLD, 32 << 20), (_M_TRIM_THRESHOLD, 256 << 20)):
            set_option(option, size)


class Known(NamedTuple):
    """What a database has of a rig before a replay: what was learnt, means of covariates, baselines."""

    learnt: Learnt | None = None
    covariates: Sequence[CovariateMean] = ()
    baselines: tuple[Baseline, ...] = ()


def known(rig: RigConfig, writer: StoreWriter) -> Known:
    """Return what the database of a writer has of a rig."""
    name = rig.rig.name
    return Known(writer.learnt[name], writer.covariates[name], writer.baselines[name])


def adopted(pipeline: Pipeline, before: Known) -> list[str]:
    """Begin with what is known; return why some baselines are not used, in words."""
    pipeline.adopt(before.learnt, before.covariates)
    refused = pipeline.count_from(before.baselines)
    for words in refused:
        log.warning("%s", words)
    return refused


class Kept(NamedTuple):
    """Where records go: the store, and the forecasts that are made of what it holds, with their alarms."""

    writer: StoreWriter
    forecasts: ReplayedForecasts
    alarms: PrognosisAlarms

    def keep(self, records: Sequence[Record]) -> list[Record]:
        """Store records and the forecasts that are due; return the alarms of these."""
        self.writer.publish(records)
        found: list[Record] = []
        for made in self.forecasts.step(records):
            alarms: list[Record] = [change for look in made.outlooks for change in self.alarms.step(look)]
            self.writer.publish([*made.records, *alarms])
            found += alarms
        return found


def forecasts(rig: RigConfig, db: Path, writer: StoreWriter) -> ReplayedForecasts:
    """Return what makes the forecasts of a replay into a database."""
    return ReplayedForecasts(rig, db, lambda: writer.flush(600.0))


def begun(rig: RigConfig, recordings: Sequence[Path]) -> Playing:
    """Open recordings and make the pipeline that they are played to. Raises ConfigError, RecordingError."""
    tracks = _tracks(rig, recordings)
    try:
        return Playing(make_pipeline(rig, tracks), tracks)
    except AgentError:
        for track in tracks:
            track.driver.close()
        raise


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
        raise RecordingError.at(other, f"is no recording of the agent like {own[0]}", "replay each by itself")
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
        return Track(SOURCE, opened(rig, path), (), {})
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
        raise RecordingError.of(str(error), "mend or cut the recording") from error
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
        raise RecordingError.at(path, "is a folder, no recording", "give the files in it")
    if path.exists() and not path.is_file():
        advice = "write what comes from there to a file first"
        raise RecordingError.at(path, "is a pipe or a device, whose end may never come", advice)


def _open(driver: Driver) -> Driver:
    try:
        driver.open()
    except DriverError as error:
        raise RecordingError.of(str(error), "see that this is the file that was meant") from error
    for note in driver.take_notes():
        log.warning("%s", note)
    return driver


def _can_log(rig: RigConfig, path: Path) -> Driver:
    """The driver of a log of CAN frames, decoded as the configuration's CAN source says."""
    sources = [source for source in rig.source if source.driver == "can"]
    if len(sources) != 1:
        advice = 'describe the frames by one [[source]] with driver = "can"'
        raise RecordingError.at(path, "a CAN log needs the CAN source it was heard on", advice)
    source = sources[0]
    recording = driver_class("can-log")
    channels = [channel.name for channel in (*rig.inputs, *rig.outputs)]
    missing = [name for name in channels if name not in source.map]
    if missing:
        raise RecordingError.at(
            path, f"the CAN source does not carry {', '.join(missing)}", "map every channel"
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


def writer_of(rigs: Sequence[RigConfig], db: Path) -> StoreWriter:
    """Return a writer, started, of a replay of each rig. Raises StoreError."""
    runs = [
        RunInfo(
            rig.rig.name, "replay", wall_ns(), __version__, rig.sha256, boot_id=boot_id(),
            learnt_key=learnt_key(rig), site=rig.rig.site, labels=rig.rig.labels, graph=graph_of(rig),
        )
        for rig in rigs
    ]  # fmt: skip
    writer = StoreWriter(lambda: Store.open(db), runs, lossless=True, period_s=_COMMIT_S)
    writer.start()
    return writer
