"""`deltak replay`: recordings through the live pipeline, as fast as it goes."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from agent import __version__
from agent.config import RigConfig, driver_class, load
from agent.errors import RecordingError
from agent.runtime.clock import boot_id, wall_ns
from agent.runtime.pipeline import Conservation, Pipeline, resolutions
from agent.runtime.results import RunSummary
from agent.storage.store import Store
from agent.storage.writer import StoreWriter
from agent.types import Record, RunInfo
from drivers.port import Counts, Driver, DriverError, SourceRequest

SOURCE = "recording"
HEALTH_PERIOD_NS = 10_000_000_000


def replay(*, config: Path, recordings: Sequence[Path], db: Path | None) -> dict[str, Any]:
    """Replay recordings one after the other as one run; return the document of CONTRACT section 8.

    Raises ConfigError, ModelError, RecordingError, StoreError.
    """
    rig = load(config)
    started = time.monotonic()
    drivers = [opened(rig, path) for path in recordings]
    pipeline = make_pipeline(rig)
    summary = RunSummary(rig, db=None if db is None else str(db))
    writer = _writer(rig, db)
    try:
        if writer is not None:
            summary.run_id = writer.run_ids[rig.rig.name]
        for records in _records(pipeline, drivers):
            summary.take(records)
            if writer is not None:
                writer.publish(records)
    finally:
        if writer is not None:
            writer.stop(timeout_s=600.0)
        for driver in drivers:
            driver.close()
    return summary.document(time.monotonic() - started)


def make_pipeline(rig: RigConfig) -> Pipeline:
    """Build the pipeline that replays a rig's recordings, with the resolution that its sources' wires have."""
    steps = []
    for source in rig.source:
        request = SourceRequest(source.name, source.settings, tuple(source.map.values()), source.counter, rig.folder)
        steps.append(driver_class(source.driver)(request).resolution())
    known = resolutions([source.map for source in rig.source], steps)
    names = {channel.name: channel.name for channel in (*rig.inputs, *rig.outputs)}
    return Pipeline(rig, known, {SOURCE: names})


def opened(rig: RigConfig, path: Path) -> Driver:
    """Return the driver of a recording, open. Raises RecordingError."""
    recording = driver_class(SOURCE)
    columns = dict(rig.columns.names)
    settings = recording.settings_model(
        path=path.absolute(), delimiter=rig.columns.delimiter, columns=columns,
        clock="uniform" if rig.rig.clock == "uniform" else "device",
    )  # type: ignore[call-arg]  # fmt: skip
    names = tuple(channel.name for channel in (*rig.inputs, *rig.outputs))
    driver = recording(SourceRequest(path.name, settings, names))
    try:
        driver.open()
    except DriverError as error:
        raise RecordingError.at("", str(error), "give a CSV or NPZ recording with a column for each channel") from error
    return driver


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
    for driver in drivers:
        for records in _blocks(pipeline, driver):
            yield records
            if due is None or pipeline.newest_ns >= due:
                due = pipeline.newest_ns + HEALTH_PERIOD_NS
                yield _ledger(pipeline, drivers)
    yield _ledger(pipeline, drivers)


def _ledger(pipeline: Pipeline, drivers: Sequence[Driver]) -> list[Record]:
    total = Counts()
    for driver in drivers:
        total.received += driver.counts.received
        total.rejected.update(driver.counts.rejected)
    return list(pipeline.health({SOURCE: Conservation(total, Counter())}, pipeline.newest_ns, None))


def _blocks(pipeline: Pipeline, driver: Driver) -> Iterator[list[Record]]:
    while True:
        try:
            block = driver.read(1.0)
        except EOFError:
            return
        except DriverError as error:
            raise RecordingError.at("", str(error), "mend or cut the recording") from error
        yield pipeline.step(SOURCE, block, None, None)
