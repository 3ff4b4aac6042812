"""What the running agent records: which sources raw, and around the alarms of which rigs."""

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from agent import __version__
from agent.clock import wall_ns
from agent.config import RigConfig
from agent.errors import AgentError
from agent.recording.event_writer import EventWriter, Facts
from agent.recording.header import RawHeader
from agent.recording.recorder import Limits, Recorder
from agent.records import EventRecord, HealthEvent, Record
from agent.storage.read import queries
from drivers.port import Driver

FOLDER = ".raw"
_COLUMNS = (
    "rig", "t_ns", "kind", "parameter", "alarms", "file", "state", "from_ns", "to_ns", "samples", "bytes",
    "baseline_id", "message",
)  # fmt: skip
Publish = Callable[[Sequence[Record]], None]

log = logging.getLogger(__name__)


def recorder(config: RigConfig, db: Path, source: str, publish: Publish, driver: Driver) -> Recorder:
    """Return the recorder of a source, in the folder "DB.raw" beside the database; its driver is open."""
    rig, limits = config.rig.name, config.store.recordings
    header = RawHeader(
        source, driver.request.fields, driver.counter_modulus, config.sha256, __version__, wall_ns(), rig=rig
    )

    def tell(cause: str, message: str) -> None:
        log.warning("%s", message)
        publish([HealthEvent(rig, source, wall_ns(), cause, message)])

    bounds = Limits(limits.max_mb * 1e6, limits.keep)
    return Recorder(db.with_name(db.name + FOLDER), header, driver.capture_suffix, bounds, tell=tell)


def event_writer(config: RigConfig, db: Path, publish: Publish) -> EventWriter:
    """Return what writes a rig's event records, in the folder "DB.events" beside the database."""
    facts = Facts(
        rig=config.rig.name,
        channels={source.name: tuple(source.map) for source in config.source},
        fields={source.name: tuple(source.map.values()) for source in config.source},
        config_sha256=config.sha256,
        code_version=__version__,
    )
    return EventWriter(db, facts, config.store.events, publish, lambda: _rows(db, config.rig.name))


def _rows(db: Path, rig: str) -> list[EventRecord]:
    """Return the index's rows of a rig; none where the file cannot be read now."""
    try:
        return [
            EventRecord(**{name: row[name] for name in _COLUMNS}) for row in queries.event_records(db, rig)
        ]
    except AgentError as error:
        log.info("%s: the event records of earlier runs are not known: %s", rig, error)
        return []
