"""Nominal values in a configuration: put into it, and written to its file with the smallest text edit."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from agent.commissioning.editing.toml_text import NUMBER, reads_as, replace_file, shown, table_around
from agent.config import MechanicsModel, RigConfig
from agent.config.reading.toml_file import parse_toml, read_bytes
from agent.errors import UsageError

KEYS = {"mass": "value", "spring": "nominal", "damper": "nominal", "friction": "nominal"}


def with_nominals(config: RigConfig, values: Mapping[str, float]) -> RigConfig:
    """Return a configuration whose elements and masses have these values; names of others are passed over."""
    model = config.model
    if not isinstance(model, MechanicsModel):
        raise TypeError("not a mass-spring-damper model")
    tables = {
        kind: tuple(
            row.model_copy(update={key: values[row.name]}) if row.name in values else row
            for row in getattr(model, kind)
        )
        for kind, key in KEYS.items()
    }
    return config.model_copy(update={"model": model.model_copy(update=tables)})


def write_nominals(file: Path, values: Mapping[str, float]) -> None:
    """Write the values of elements and masses into a file; comments and all else stay as they are.

    Raises UsageError where the file cannot be written, or its text is not one in which the values can be
    placed.
    """
    replace_file(file, edited(read_bytes(file).decode("utf-8"), values, file))


def edited(text: str, values: Mapping[str, float], file: Path) -> str:
    """Return the text of a configuration with these values in it. Raises UsageError."""
    for name, value in values.items():
        wanted = _wanted(parse_toml(text.encode("utf-8"), file), name, value)
        found = next((new for new in _candidates(text, name, value) if reads_as(new, wanted, file)), None)
        if found is None:
            what = f'no place for the value of "{name}" is found in {file}'
            raise UsageError.at("--write", what, f"nothing was changed; enter {value:.6g} there yourself")
        text = found
    return text


def _wanted(raw: dict[str, Any], name: str, value: float) -> dict[str, Any]:
    for kind, key in KEYS.items():
        for row in raw["model"].get(kind, []):
            if row["name"] == name:
                row[key] = float(f"{value:.6g}")
    return raw


def _candidates(text: str, name: str, value: float) -> Iterator[str]:
    """Yield the text with the value put beside each place where the name stands."""
    number = shown(value)
    for place in re.finditer(rf"""\bname[ \t]*=[ \t]*["']{re.escape(name)}["']""", text):
        start, end = table_around(text, place.start(), place.end())
        table = text[start:end]
        for new in _replaced(table, number):
            yield text[:start] + new + text[end:]
        inline = text[start] == "{"
        at = start + len(table.rstrip("}").rstrip()) if inline else place.end()
        yield text[:at] + (", " if inline else "\n") + f"nominal = {number}" + text[at:]


def _replaced(table: str, number: str) -> Iterator[str]:
    """Yield a table's text with the number in the place of each that may be the nominal."""
    for key in ("nominal", "value"):
        new, count = re.subn(rf"(?m)(\b{key}[ \t]*=[ \t]*){NUMBER}", rf"\g<1>{number}", table, count=1)
        if count:
            yield new
