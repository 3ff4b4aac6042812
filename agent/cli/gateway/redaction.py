"""Secrets out of texts: what is under a secret's key, what a reference leads to, passwords in addresses."""

import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from agent.config.reading.secrets import is_secret

REMOVED: Final = "REMOVED"
_SHORTEST: Final = 4  # what is shorter is found everywhere by chance
_KEY: Final = re.compile(
    r"""(?imx) ([\w.-]*(?:password|passwd|passphrase|secret|token|api_?key|private_key)["']? \s* [=:] \s*)
        ( \"{3}.*?\"{3} | '{3}.*?'{3} | "(?:[^"\\\n]|\\.)*" | '[^'\n]*' | [^\s{,}\]]+ )""",
    re.DOTALL,
)
_ADDRESS: Final = re.compile(r"(\w://)[^\s/@\"']+:[^\s/@\"']+@")


class Redaction:
    """Removes the secrets of configurations, wherever in a text they stand.

    Args:
        configs: files that hold or name secrets; a file that is not TOML is searched by its keys.
    """

    def __init__(self, configs: Sequence[Path]) -> None:
        found = {value for file in configs for value in _secrets_of(file)}
        self._values = sorted((v for v in found if len(v) >= _SHORTEST), key=len, reverse=True)

    def cleaned(self, content: bytes) -> bytes:
        """Return a text without secrets."""
        text = content.decode("utf-8", "replace")
        for value in self._values:
            text = text.replace(value, REMOVED)
        text = _KEY.sub(lambda match: f'{match[1]}"{REMOVED}"', text)
        return _ADDRESS.sub(rf"\1{REMOVED}@", text).encode()


def _secrets_of(file: Path) -> Iterator[str]:
    with suppress(OSError, ValueError, RecursionError):
        yield from _values(tomllib.loads(file.read_text(encoding="utf-8-sig")), file.parent)


def _values(raw: Any, folder: Path) -> Iterator[str]:
    """Yield every secret at any depth: the text itself, or what its file or variable holds."""
    if isinstance(raw, list):
        for item in raw:
            yield from _values(item, folder)
    if not isinstance(raw, dict):
        return
    for key, value in raw.items():
        if not is_secret(key):
            yield from _values(value, folder)
        elif isinstance(value, dict):
            yield from _referred(value, folder)
        else:
            yield str(value)


def _referred(reference: dict[str, Any], folder: Path) -> Iterator[str]:
    for where, name in reference.items():
        if where == "env":
            yield os.environ.get(str(name), "")
        elif where == "file":
            with suppress(OSError, ValueError):
                yield (folder / str(name)).read_text(encoding="utf-8").strip()
        else:
            yield str(name)
