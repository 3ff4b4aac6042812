"""Limits put into a configuration's file with the smallest edit of its text."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from agent.commissioning.editing.toml_text import NUMBER, reads_as, replace_file, shown, table_around
from agent.config import parse
from agent.config.reading.toml_file import parse_toml, read_bytes
from agent.errors import ConfigError, UsageError

Values = Mapping[str, float]
"""Of one alarm: limit and on_delay_s."""


def write_limits(file: Path, limits: Mapping[str, Values]) -> None:
    """Write limits and on-delays by parameter to a file; comments and all else stay, absent alarms are added.

    Raises UsageError where the file cannot be written, the text has no place for one, or what comes out is
    faulty; nothing is changed then.
    """
    text = with_limits(read_bytes(file).decode("utf-8"), limits, file)
    try:
        parse(text.encode("utf-8"), file)
    except ConfigError as error:
        words = f"with these limits {file} would be faulty: {error}"
        raise UsageError.at("--write", words, "nothing was changed; mend that first") from error
    replace_file(file, text)


def with_limits(text: str, limits: Mapping[str, Values], file: Path) -> str:
    """Return the text of a configuration with these limits in it. Raises UsageError."""
    for parameter, values in limits.items():
        wanted = _wanted(parse_toml(text.encode("utf-8"), file), parameter, values)
        found = next(
            (new for new in _candidates(text, parameter, values) if reads_as(new, wanted, file)), None
        )
        if found is None:
            what = f'no place for the limit of "{parameter}" is found in {file}'
            raise UsageError.at(
                "--write", what, f"nothing was changed; enter {values['limit']:g} there yourself"
            )
        text = found
    return text


def _wanted(raw: dict[str, Any], parameter: str, values: Values) -> dict[str, Any]:
    alarms = raw.setdefault("alarm", [])
    level = [
        row for row in alarms if row.get("parameter") == parameter and row.get("kind", "level") == "level"
    ]
    if not level:
        level = [{"parameter": parameter}]
        alarms += level
    level[0].pop("limit_percent", None)
    level[0].update(values)
    return raw


def _candidates(text: str, parameter: str, values: Values) -> Iterator[str]:
    """Yield the text with the values in each table of the parameter, and in one of their own at its end."""
    for place in re.finditer(rf"""\bparameter[ \t]*=[ \t]*["']{re.escape(parameter)}["']""", text):
        start, end = table_around(text, place.start(), place.end())
        inline = text[start] == "{"
        table = re.sub(r"(?m)\blimit_percent([ \t]*=)", r"limit\g<1>", text[start:end], count=1)
        for key, value in values.items():
            table = _set(table, key, value, inline=inline)
        yield text[:start] + table + text[end:]
    lines = [f'parameter = "{parameter}"', *(f"{key} = {shown(value)}" for key, value in values.items())]
    yield text.rstrip("\n") + "\n\n[[alarm]]\n" + "\n".join(lines) + "\n"


def _set(table: str, key: str, value: float, *, inline: bool) -> str:
    """Return a table's text with a key set: in its place, else before the limit."""
    text, count = re.subn(rf"(?m)(\b{key}[ \t]*=[ \t]*){NUMBER}", rf"\g<1>{shown(value)}", table, count=1)
    if count:
        return text
    if inline:
        return re.sub(r"\blimit[ \t]*=", f"{key} = {shown(value)}, limit =", table, count=1)
    return re.sub(r"(?m)^([ \t]*)(limit[ \t]*=)", rf"\g<1>{key} = {shown(value)}\n\g<1>\g<2>", table, count=1)
