"""How old files are: by the time that agents ran since, which no wall clock can make longer."""

import json
import logging
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from agent.recording.tuning import SAVE_S
from agent.storage.database.files import opened

log = logging.getLogger(__name__)


class Ages:
    """Since when files have been complete, in seconds that agents ran; kept in a small file beside them.

    A file that it does not know, and all where its own file is lost or damaged, are new: they stay longer,
    not shorter. The time between two runs is not counted, since only the wall clock knows it.

    Args:
        path: of its file; in a folder that may not be there yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ran_s, self._ended = _read(path)
        self._begun_s = self._saved_s = time.monotonic()

    def of(self, name: str) -> float:
        """Return a file's age, s; 0 of one that is not known."""
        now = self._now()
        return now - self._ended.get(name, now)

    def note(self, name: str) -> None:
        """Note, and write down, that a file is complete from now on."""
        self._ended[name] = self._now()
        self._save()

    def keep(self, names: Iterable[str]) -> None:
        """Forget all other files, take up new ones, and save what is known where it is due or changed."""
        now = self._now()
        before = self._ended
        self._ended = {name: before.get(name, now) for name in names}
        due = time.monotonic() - self._saved_s >= SAVE_S
        if self._path.parent.is_dir() and (due or self._ended.keys() != before.keys()):
            self._save()

    def _now(self) -> float:
        return self._ran_s + time.monotonic() - self._begun_s

    def _save(self) -> None:
        part = self._path.with_name(self._path.name + ".part")
        content = {"ran_s": self._now(), "ended": self._ended}
        try:
            with open(part, "w", encoding="utf-8", opener=_truncated) as file:
                json.dump(content, file)
            part.replace(self._path)
        except OSError as error:
            log.info("%s: cannot be written, files may stay longer: %s", self._path, error)
        self._saved_s = time.monotonic()


def _truncated(path: str, _flags: int) -> int:
    return opened(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)


def _read(path: Path) -> tuple[float, dict[str, float]]:
    """Return seconds that ran and when files ended; nothing where the file says nothing credible."""
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        ran_s = float(found["ran_s"])
        ended = {str(name): float(at) for name, at in found["ended"].items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return 0.0, {}
    # what ended later than all that ran is a lie, and so is what is no number
    return (
        (ran_s, {name: at for name, at in ended.items() if 0.0 <= at <= ran_s}) if ran_s >= 0.0 else (0.0, {})
    )
