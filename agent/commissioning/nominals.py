"""Nominal values in a configuration: put into it, and written to its file with the smallest text edit."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from agent.commissioning.editing.places import ELEMENTS, Place, moved, numbers_in, put
from agent.commissioning.editing.toml_text import NUMBER, reads_as, replace_file, shown, table_around
from agent.config import MechanicsModel, RigConfig
from agent.config.reading.toml_file import parse_toml, read_bytes
from agent.errors import UsageError


def with_nominals(config: RigConfig, values: Mapping[str, float]) -> RigConfig:
    """Return a configuration whose parameters and masses have these values; others' names are passed over."""
    model: Any = config.model
    for place, value in moved(model, values).items():
        model = put(model, place, value)
    return config.model_copy(update={"model": model})


def write_nominals(config: RigConfig, values: Mapping[str, float]) -> None:
    """Write the values of parameters and masses into a rig's file; comments and all else stay as they are.

    Raises UsageError where the file cannot be written, or its text is not one in which the values can be
    placed.
    """
    text = read_bytes(config.file).decode("utf-8")
    if isinstance(config.model, MechanicsModel):
        replace_file(config.file, edited(text, values, config.file))
    else:
        replace_file(config.file, with_numbers(text, moved(config.model, values), config.file))


def with_numbers(text: str, numbers: Mapping[Place, float], file: Path) -> str:
    """Return a configuration's text with other numbers at places under its [model]. Raises UsageError."""
    for place, value in numbers.items():
        raw = parse_toml(text.encode("utf-8"), file)
        try:
            spans = list(numbers_in(text, place, raw["model"]))
            _set(raw["model"], place, value)
        except (KeyError, IndexError, TypeError) as error:
            raise _no_place(_named(place), value, file) from error
        tried = (text[:start] + repr(value) + text[end:] for start, end in spans)
        found = next((new for new in tried if reads_as(new, raw, file)), None)
        if found is None:
            raise _no_place(_named(place), value, file)
        text = found
    return text


def _set(table: Any, place: Place, value: float) -> None:
    for key in place[:-1]:
        table = table[key]
    _ = table[place[-1]]  # a number that is there already
    table[place[-1]] = value


def _named(place: Place) -> str:
    return "model." + str(place[0]) + "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in place[1:])


def _no_place(what: str, value: float, file: Path) -> UsageError:
    words = f'no place for the value of "{what}" is found in {file}'
    return UsageError.at("--write", words, f"nothing was changed; enter {value:.6g} there yourself")


def edited(text: str, values: Mapping[str, float], file: Path) -> str:
    """Return the text of a configuration with these values in it. Raises UsageError."""
    for name, value in values.items():
        wanted = _wanted(parse_toml(text.encode("utf-8"), file), name, value)
        found = next((new for new in _candidates(text, name, value) if reads_as(new, wanted, file)), None)
        if found is None:
            raise _no_place(name, value, file)
        text = found
    return text


def _wanted(raw: dict[str, Any], name: str, value: float) -> dict[str, Any]:
    for kind, key in ELEMENTS.items():
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
