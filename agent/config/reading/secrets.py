"""Secrets never stand in a configuration: they are named by file or environment variable."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from agent.config.reading.fields import FilePath, Table, Text
from agent.config.reading.messages import join
from agent.config.reading.parse import Faults

_SECRET: Final = re.compile(r"(^|_)(password|passwd|passphrase|secret|token|api_?key|private_key)$", re.IGNORECASE)


def is_secret(key: str) -> bool:
    """Tell by a key's name whether its value is a secret."""
    return _SECRET.search(key) is not None


class Secret(Table):
    """Where a secret is: in a file or in an environment variable, never in the configuration."""

    file: FilePath | None = None
    env: Text | None = None

    def read(self, folder: Path, environment: Mapping[str, str] | None = None) -> str:
        """Return the secret; paths start at the folder. Raises OSError, KeyError where it is not there."""
        if self.file is not None:
            return (folder / self.file).read_text(encoding="utf-8").strip()
        return (environment or {})[self.env or ""]


def check_no_plain_secrets(raw: object, path: str, faults: Faults) -> None:
    """Note every secret, at any depth, that is not of the form { file = "..." } or { env = "..." }."""
    if isinstance(raw, list):
        for i, item in enumerate(raw):
            check_no_plain_secrets(item, join(path, i), faults)
    if not isinstance(raw, dict):
        return
    for key, value in raw.items():
        if not is_secret(key):
            check_no_plain_secrets(value, join(path, key), faults)
        elif not _is_reference(value):
            what = "a secret must not stand in a configuration"
            faults.add(join(path, key), what, 'name where it is: { file = "..." } or { env = "..." }')


def _is_reference(value: object) -> bool:
    return (
        isinstance(value, Mapping)
        and len(value) == 1
        and all(key in ("file", "env") and isinstance(where, str) and where for key, where in value.items())
    )
