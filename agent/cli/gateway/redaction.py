"""Secrets out of texts: what is under a secret's key, what a reference leads to, passwords in addresses."""

import json
import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from agent.cli.tuning import SECRET_LETTERS
from agent.config.reading.secrets import is_secret

REMOVED: Final = "REMOVED"
_KEY: Final = re.compile(
    r"""(?imx)
        ([\w.-]*(?:pass(?:word|wort|wd|phrase|code)|\bpass|_pass|pwd|secret|token|api_?key|private_?key)["']?
        \s* [=:] \s*)
        ( \"{3}.*?\"{3} | '{3}.*?'{3} | "(?:[^"\\\n]|\\.)*" | '[^'\n]*' | [^\s{,}\]]+ )""",
    re.DOTALL,
)
"""Also keys that no configuration has: what is under a key that is misspelt is a secret all the same."""
_ADDRESS: Final = re.compile(r"(\w://)[^\s\"']*@")
_BEARER: Final = re.compile(r"(?i)\b(authorization[\"']?\s*[:=]\s*[\"']?\w+|bearer)(\s+)[\w.~+/=-]{4,}")
_PEM: Final = re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*-----|\Z)", re.DOTALL)
_CREDENTIALS: Final = Path("/run/credentials")


class Redaction:
    """Removes the secrets of configurations, wherever in a text they stand.

    Args:
        configs: files that hold or name secrets; a file that is not TOML is searched by its keys.
    """

    def __init__(self, configs: Sequence[Path]) -> None:
        found = {form for file in configs for value in _secrets_of(file) for form in _forms(value)}
        self._values = sorted((v for v in found if len(v) >= SECRET_LETTERS), key=len, reverse=True)

    def cleaned(self, content: bytes) -> bytes:
        """Return a text without secrets."""
        text = content.decode("utf-8", "replace")
        for value in self._values:
            text = text.replace(value, REMOVED)
        text = _PEM.sub(REMOVED, text)
        text = _BEARER.sub(rf"\1\2{REMOVED}", text)
        text = _KEY.sub(lambda match: f'{match[1]}"{REMOVED}"', text)
        return _ADDRESS.sub(rf"\1{REMOVED}@", text).encode()


def _forms(value: str) -> Iterator[str]:
    """Yield a secret as it may be written: as it is, a line of it, in JSON, by Python, in an address."""
    yield value
    yield from value.split("\n")
    yield json.dumps(value)[1:-1]
    yield json.dumps(value, ensure_ascii=False)[1:-1]
    yield repr(value)[1:-1]
    yield quote(value, safe="")


def _secrets_of(file: Path) -> Iterator[str]:
    with suppress(OSError, ValueError, RecursionError):
        raw = tomllib.loads(file.read_text(encoding="utf-8-sig"))
        yield from _values(raw, file.parent)
        yield from _addresses(raw.get("notify"))


def _addresses(targets: Any) -> Iterator[str]:
    """Yield what follows the scheme in addresses of targets: who knows it may send there."""
    for target in targets if isinstance(targets, list) else ():
        url = target.get("url") if isinstance(target, dict) else None
        if isinstance(url, str):
            yield url.partition("://")[2]


def _values(raw: Any, folder: Path) -> Iterator[str]:
    """Yield every secret at any depth: the text itself, or what its file, variable or credential holds."""
    for item in raw if isinstance(raw, list) else ():
        yield from _values(item, folder)
    for key, value in raw.items() if isinstance(raw, dict) else ():
        yield from _value(key, value, folder)


def _value(key: str, value: Any, folder: Path) -> Iterator[str]:
    is_known = is_secret(key)
    if isinstance(value, dict) and (is_known or key == "url"):
        yield from _referred(value, folder)
    elif is_known:
        yield str(value)
    else:
        yield from _values(value, folder)


def _referred(reference: dict[str, Any], folder: Path) -> Iterator[str]:
    for where, name in reference.items():
        if where == "env":
            yield os.environ.get(str(name), "")
        elif where == "file":
            yield from _held(folder / str(name))
        elif where == "credential":
            own = Path(os.environ.get("CREDENTIALS_DIRECTORY", os.devnull))
            for place in (own, *_CREDENTIALS.glob("*")):
                yield from _held(place / Path(str(name)).name)
        else:
            yield str(name)


def _held(file: Path) -> Iterator[str]:
    with suppress(OSError, ValueError):
        yield file.read_text(encoding="utf-8").strip()
