"""A configuration file's bytes as nested tables; what is not TOML is said with its line."""

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from agent.config.tuning import FILE_BYTES
from agent.errors import ConfigError

_PLACE: Final = re.compile(
    r"^(?P<what>.*?) \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)$", re.DOTALL
)


# tomllib takes time with the square of a dotted key's parts; possessive, so that the search itself is linear.
_LONG_KEY: Final = re.compile(r"""(?<![\w.-])(?:(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\.[ \t]*+){64}""")


def files_of(paths: Iterable[str | Path]) -> list[Path]:
    """Return the files that paths name: a file stands for itself, a folder (a conf.d) for its *.toml, sorted.

    Raises ConfigError for a folder without any, or one that cannot be read.
    """
    return [file for path in paths for file in _files(Path(path))]


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    try:
        found = sorted(
            entry for entry in path.iterdir() if entry.suffix == ".toml" and not entry.name.startswith(".")
        )
    except OSError as error:
        raise ConfigError.at(
            path, f"cannot be read: {error.strerror}", "let the agent's user read it"
        ) from error
    if not found:
        raise ConfigError.at(path, "holds no *.toml", "put the configuration of a rig there")
    for file in found:
        if file.exists() and not file.is_file():
            raise ConfigError.at(file, "is no file, its end may never come", "take it out of the folder")
    return found


def read_bytes(file: Path) -> bytes:
    """Return the file's bytes; ConfigError when it cannot be read or is larger than any configuration is."""
    try:
        with file.open("rb") as stream:
            data = stream.read(FILE_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ConfigError.at(file, f"cannot be read: {reason}", "name a configuration file") from error
    if len(data) > FILE_BYTES:
        raise ConfigError.at(
            file, f"is larger than {FILE_BYTES // 1_000_000} MB", "a configuration is a short TOML text"
        )
    return data


def parse_toml(data: bytes, file: Path) -> dict[str, Any]:
    """Return the tables of a TOML text (a BOM and CR LF are taken); ConfigError names file and line."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError.at(f"{file}:{line}", "is not UTF-8 text", "save the file as UTF-8") from error
    endless = _LONG_KEY.search(text)
    if endless:
        line = text.count("\n", 0, endless.start()) + 1
        raise ConfigError.at(
            f"{file}:{line}", "is a key of more than 64 parts", "no key of a configuration is"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _not_toml(str(error), text, file) from error
    except (RecursionError, ValueError) as error:
        raise ConfigError.at(file, "is not TOML that can be read", f"{_reason(error)}") from error


def _not_toml(words: str, text: str, file: Path) -> ConfigError:
    place = _PLACE.match(words)
    found: dict[str, str | None] = place.groupdict() if place else {}
    line = found.get("line") or str(text.rstrip().count("\n") + 1)
    what = found.get("what", words) or ""
    column = f", column {found['column']}" if found.get("column") else ""
    return ConfigError.at(f"{file}:{line}", f"is not TOML{column}: {_printable(what)}", "mend the line")


def _reason(error: Exception) -> str:
    return "its lists are nested too deep" if isinstance(error, RecursionError) else _printable(str(error))


def _printable(text: str) -> str:
    kept = "".join(letter if letter.isprintable() else "?" for letter in text)
    return kept[:1].lower() + kept[1:200]
