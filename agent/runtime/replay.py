"""`deltak replay`: recordings through the live pipeline, as fast as it goes."""

import logging
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from agent import __version__
from agent.config import RigConfig, driver_class, load
from agent.errors import RecordingError
from agent.runtime.clock import SampleLabels, boot_id, wall_ns
from agent.runtime.pipeline import Conservation, Pipeline, resolutions
from agent.runtime.raw_source import SUFFIX, RawDriver, RawSettings
from agent.runtime.results import RunSummary
from agent.storage.store import Store
from agent.storage.writer import StoreWriter
from agent.types import Record, RunInfo
from drivers.port import Counts, Driver, DriverError, SourceRequest

SOURCE = "recording"
CAN_LOGS = (".log", ".asc", ".blf", ".trc", ".mf4")

log = logging.getLogger(__name__)

HEALTH_PERIOD_NS = 10_000_000_000


def replay(*, config: Path, recordings: Sequence[Path], db: Path | None) -> dict[str, Any]:
    """Replay recordings one after the other as one run; return the document of CONTRACT section 8.

    Raises ConfigError, ModelError, RecordingError, StoreError.
    """
    rig = load(config)
    started = time.monotonic()
    with ExitStack() as stack:
        drivers = [_until_the_end(stack, opened(rig, path)) for path in recordings]
        pipeline = make_pipeline(rig, drivers)
        summary = RunSummary(rig, db=None if db is None else str(db))
        writer = _writer(rig, db)
        if writer is not None:
            stack.callback(writer.stop, timeout_s=600.0)
            summary.run_id = writer.run_ids[rig.rig.name]
        for records in _records(pipeline, drivers):
            summary.take(records)
            if writer is not None:
                writer.publish(records)
    return summary.document(time.monotonic() - started)


def _until_the_end(stack: ExitStack, driver: Driver) -> Driver:
    stack.callback(driver.close)
    return driver


def make_pipeline(rig: RigConfig, recordings: Sequence[Driver] = ()) -> Pipeline:
    """Build the pipeline that replays a rig's recordings, with the resolution of its sources' wires, else of the first.

    Raises RecordingError.
    """
    steps = []
    for source in rig.source:
        request = SourceRequest(source.name, source.settings, tuple(source.map.values()), source.counter, rig.folder)
        steps.append(driver_class(source.driver)(request).resolution())
    names = {channel.name: channel.name for channel in (*rig.inputs, *rig.outputs)}
    known = resolutions([source.map for source in rig.source], steps)
    if recordings and not rig.source:
        known = resolutions([names], [_seen_steps(recordings[0])])
    return Pipeline(rig, known, {SOURCE: names})


def _seen_steps(recording: Driver) -> tuple[float, ...]:
    try:
        return recording.resolution()
    except DriverError as error:
        raise RecordingError.at("", str(error), "mend or cut the recording") from error


def opened(rig: RigConfig, path: Path) -> Driver:
    """Return the driver of a recording, open. Raises RecordingError."""
    kinds = {SUFFIX: _raw} | dict.fromkeys(CAN_LOGS, _can_log)
    driver = kinds.get(path.suffix.lower(), _table)(rig, path)
    try:
        driver.open()
    except DriverError as error:
        raise RecordingError.at("", str(error), "give one with a column for each channel") from error
    for note in driver.take_notes():
        log.info("%s", note)
    return driver


def _raw(rig: RigConfig, path: Path) -> Driver:
    """The driver of one of the agent's own raw recordings, of a source that carries every channel."""
    channels = [channel.name for channel in (*rig.inputs, *rig.outputs)]
    sources = [source for source in rig.source if path.name.startswith(f"{source.name}-")]
    if not sources or any(name not in sources[0].map for name in channels):
        advice = "replay it with the configuration it was recorded with"
        raise RecordingError.at("", f"{path}: no source of the configuration was recorded there", advice)
    fields = tuple(sources[0].map[name] for name in channels)
    return RawDriver(SourceRequest(sources[0].name, RawSettings(path=path.absolute()), fields))


def _can_log(rig: RigConfig, path: Path) -> Driver:
    """The driver of a log of CAN frames, decoded as the configuration's CAN source says."""
    sources = [source for source in rig.source if source.driver == "can"]
    if len(sources) != 1:
        advice = "describe the frames by one [[source]] with driver = \"can\""
        raise RecordingError.at("", f"{path}: a CAN log needs the CAN source it was heard on", advice)
    source, recording = sources[0], driver_class("can-log")
    channels = [channel.name for channel in (*rig.inputs, *rig.outputs)]
    lacking = [name for name in channels if name not in source.map]
    if lacking:
        raise RecordingError.at("", f"{path}: the CAN source does not carry {', '.join(lacking)}", "map every channel")
    settings = recording.settings_model(path=path.absolute(), dbc=source.settings.dbc)  # type: ignore[call-arg]
    fields = tuple(source.map[name] for name in channels)
    return recording(SourceRequest(path.name, settings, fields, source.counter, rig.folder))


def _table(rig: RigConfig, path: Path) -> Driver:
    """The driver of a CSV or NPZ recording."""
    recording = driver_class(SOURCE)
    columns = dict(rig.columns.names)
    settings = recording.settings_model(
        path=path.absolute(), delimiter=rig.columns.delimiter, columns=columns,
        clock="uniform" if rig.rig.clock == "uniform" else "device",
    )  # type: ignore[call-arg]  # fmt: skip
    names = tuple(channel.name for channel in (*rig.inputs, *rig.outputs))
    return recording(SourceRequest(path.name, settings, names))


def _writer(rig: RigConfig, db: Path | None) -> StoreWriter | None:
    if db is None:
        return None
    run = RunInfo(rig.rig.name, "replay", wall_ns(), __version__, rig.sha256, None, boot_id())
    writer = StoreWriter(lambda: Store.open(db), [run], lossless=True)
    writer.start()
    return writer


def _records(pipeline: Pipeline, drivers: Sequence[Driver]) -> Iterator[list[Record]]:
    """Yield what each block of each recording leads to, with the ledger every 10 s of samples and at the end."""
    due: int | None = None
    labels = SampleLabels(pipeline.config.rig.sample_rate_hz)
    for driver in drivers:
        for records in _blocks(pipeline, driver, labels):
            yield records
            if due is None or pipeline.newest_ns >= due:
                due = pipeline.newest_ns + HEALTH_PERIOD_NS
                yield _ledger(pipeline, drivers)
    yield pipeline.finish()
    yield _ledger(pipeline, drivers)


def _ledger(pipeline: Pipeline, drivers: Sequence[Driver]) -> list[Record]:
    total = Counts()
    for driver in drivers:
        total.received += driver.counts.received
        total.rejected.update(driver.counts.rejected)
    return list(pipeline.health({SOURCE: Conservation(total, Counter())}, pipeline.newest_ns, None))


def _blocks(pipeline: Pipeline, driver: Driver, labels: SampleLabels) -> Iterator[list[Record]]:
    while True:
        try:
            block = driver.read(1.0)
        except EOFError:
            return
        except DriverError as error:
            raise RecordingError.at("", str(error), "mend or cut the recording") from error
        # blocks that were received live are labelled as they were then
        received = block.wall_offset_ns is not None
        label = partial(labels.label, arrival_ns=block.arrival_ns, offset_ns=block.wall_offset_ns or 0)
        yield pipeline.step(SOURCE, block, driver.counter_modulus, label if received else None)
