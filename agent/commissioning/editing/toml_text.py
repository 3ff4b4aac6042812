"""Places in the text of a TOML file, and files replaced whole or not at all."""

import os
import re
import tempfile
from pathlib import Path
from typing import Any

from agent.config.reading.toml_file import parse_toml
from agent.errors import ConfigError, UsageError

NUMBER = r"[-+]?[\w.]+(?:[-+]\d+)?"
"""Pattern of a number as TOML writes it."""


def reads_as(text: str, wanted: dict[str, Any], file: Path) -> bool:
    """Tell whether the text of a configuration holds what is wanted."""
    try:
        return parse_toml(text.encode("utf-8"), file) == wanted
    except ConfigError:
        return False


def table_around(text: str, start: int, end: int) -> tuple[int, int]:
    """Return where the table around a place begins and ends: braces, or the lines up to the next header."""
    opening = text.rfind("{", 0, start)
    closing = text.find("}", end)
    if opening > text.rfind("}", 0, start) and closing >= 0:
        return opening, closing + 1
    header = re.search(r"(?m)^[ \t]*\[", text[end:])
    first = text.rfind("\n[", 0, start) + 1
    return first, end + header.start() if header else len(text)


def replace_file(file: Path, text: str) -> None:
    """Put a new text in a file's place, whole or not at all. Raises UsageError where it cannot be written."""
    try:
        _replace(Path(os.path.realpath(file)), text)
    except OSError as error:
        words = f"{file} cannot be written: {error.strerror or error}"
        raise UsageError.at(
            "--write", words, "nothing was changed; make it writable, or copy the values"
        ) from error


def shown(value: float) -> str:
    """Return a number of six digits as TOML writes a float."""
    text = f"{value:.6g}"
    return text if re.search(r"[.e]", text) else f"{text}.0"


def _replace(target: Path, text: str) -> None:
    if not os.access(target, os.W_OK):
        raise PermissionError(13, "it is read-only")
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    new = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        new.chmod(target.stat().st_mode & 0o7777)
        new.replace(target)
    except OSError:
        new.unlink(missing_ok=True)
        raise
