"""Where rows estimated again go: nowhere, into one database or one a rig; and what was found of each rig."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agent.blocks.advisory.prognosis_alarms import PrognosisAlarms
from agent.config import RigConfig
from agent.runtime.reestimation.parts import Part
from agent.runtime.replay import Kept, Known, forecasts, known, writer_of
from agent.runtime.results import RunSummary
from agent.runtime.tuning import WRITER_STOP_S
from agent.storage.write.writer import StoreWriter


class Databases:
    """The databases of a re-estimation, each with the one that writes to it.

    Args:
        place: a file for all rigs, a folder (that is there, or ends with a slash) for a file each, or None.
        rigs: whose rows will come.

    Raises StoreError.
    """

    def __init__(self, place: str | None, rigs: Sequence[RigConfig]) -> None:
        self._folder = Path(place) if place is not None and _is_folder(place) else None
        self._file = Path(place) if place is not None and self._folder is None else None
        self._writers: dict[str, StoreWriter] = {}
        if self._file is not None:
            self._writers[""] = writer_of(rigs, self._file)
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)

    def open(self, rig: RigConfig) -> tuple[Path, StoreWriter] | None:
        """Return the file of a rig and its writer; None where nothing is kept."""
        if self._file is not None:
            return self._file, self._writers[""]
        if self._folder is None:
            return None
        path = self._folder / f"{rig.rig.name}.db"
        self._writers[rig.rig.name] = writer_of([rig], path)
        return path, self._writers[rig.rig.name]

    def done(self, rig: RigConfig) -> None:
        """Close the file that is this rig's alone. Raises StoreError where it could not be written."""
        writer = self._writers.pop(rig.rig.name, None)
        if writer is not None:
            writer.stop(WRITER_STOP_S)

    def close(self) -> None:
        """Write what waits and close all. Raises StoreError where one could not be written."""
        while self._writers:
            self._writers.popitem()[1].stop(WRITER_STOP_S)


def _is_folder(place: str) -> bool:
    return place.endswith("/") or Path(place).is_dir()


class Merge:
    """The parts of one rig put together, in order, as a replay would have made them in one go."""

    def __init__(self, rig: RigConfig, databases: Databases) -> None:
        self._databases, self.rig = databases, rig
        self._begun_s = time.monotonic()
        self._kept: Kept | None = None
        self.known = Known()
        place = databases.open(rig)
        self.summary = RunSummary(rig, db=None if place is None else str(place[0]))
        if place is not None:
            path, writer = place
            self.summary.run_id = writer.run_ids[rig.rig.name]
            self.known = known(rig, writer)
            self._kept = Kept(writer, forecasts(rig, path, writer), PrognosisAlarms(rig.rig.name, rig.alarm))

    def take(self, part: Part) -> None:
        """Take the next part. Raises StoreError."""
        for words in part.advice:
            self.summary.advise(words)
        for records in part.records:
            self.summary.take(records)
            if self._kept is not None:
                self.summary.take(self._kept.keep(records))
        if part.rest is None:
            self.end()

    def end(self) -> None:
        """Note that no part will come any more."""
        self._databases.done(self.rig)

    def document(self) -> dict[str, Any]:
        """Return what was found, as a replay's document."""
        return self.summary.document(time.monotonic() - self._begun_s)
