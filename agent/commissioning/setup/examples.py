"""`deltak examples`: complete configurations that come along, each copied with the files that it needs."""

import shutil
import tomllib
from collections.abc import Iterator
from importlib.resources import as_file, files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from agent.errors import Fault, UsageError


def listed() -> dict[str, Any]:
    """Return the examples: name, what it is in a sentence, its files."""
    rows = [
        {
            "name": _name(file),
            "words": _words(file.read_text(encoding="utf-8")),
            "files": [f.name for f in _set(file)],
        }
        for file in _configurations()
    ]
    return {"examples": rows}


def copied(name: str, folder: Path) -> dict[str, Any]:
    """Copy an example and the files it needs into a folder, made if missing; nothing is overwritten.

    Raises UsageError for a name that is none, and where a file is there already or cannot be written.
    """
    wanted = _set(_configuration(name))
    there = [folder / file.name for file in wanted if (folder / file.name).exists()]
    if there:
        advice = "name another folder, or move it away; nothing was copied"
        raise UsageError([Fault(str(path), "is there already", advice) for path in there])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in wanted:
            with as_file(file) as source:
                shutil.copyfile(source, folder / file.name)
    except OSError as error:
        advice = "name a folder that can be written"
        raise UsageError.at(
            "DIR", f"{folder} cannot be written: {error.strerror or error}", advice
        ) from error
    return {"name": name, "files": [str(folder / file.name) for file in wanted]}


def _folder() -> Traversable:
    return files("agent") / "examples"


def _configurations() -> list[Traversable]:
    found = [file for file in _folder().iterdir() if file.name.endswith(".toml")]
    return sorted(found, key=lambda file: file.name)


def _name(file: Traversable) -> str:
    return file.name.removesuffix(".toml")


def _configuration(name: str) -> Traversable:
    known = {_name(file): file for file in _configurations()}
    if name.removesuffix(".toml") not in known:
        raise UsageError.at("NAME", f'no example is called "{name}"', f"examples are {', '.join(known)}")
    return known[name.removesuffix(".toml")]


def _words(text: str) -> str:
    """Return the first sentence of a file's opening comment."""
    lines = [line.removeprefix("#").strip() for line in text.splitlines()[:4] if line.startswith("#")]
    return " ".join(lines).split(". ")[0].rstrip(".")


def _set(file: Traversable) -> list[Traversable]:
    """Return an example's file and those beside it that its sources name."""
    beside = {other.name: other for other in _folder().iterdir() if other.name != file.name}
    values = _values(tomllib.loads(file.read_text(encoding="utf-8")).get("source", []))
    return [file, *(beside[value] for value in values if value in beside)]


def _values(raw: object) -> Iterator[str]:
    """Yield every text in tables and lists, at any depth."""
    if isinstance(raw, str):
        yield raw
    elif isinstance(raw, dict | list):
        for value in raw.values() if isinstance(raw, dict) else raw:
            yield from _values(value)
