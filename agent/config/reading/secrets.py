"""Secrets never stand in a configuration: they are named by file or environment variable."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from agent.config.reading.fields import FilePath, Table, Text
from agent.config.reading.messages import join
from agent.config.reading.parse import Faults

_SECRET: Final = re.compile(
    r"(^|_)(password|passwd|passphrase|secret|token|api_?key|private_key)$", re.IGNORECASE
)


def is_secret(key: str) -> bool:
    """Tell by a key's name whether its value is a secret."""
    return _SECRET.search(key) is not None


_PLACES: Final = ("file", "env", "credential")


class Secret(Table):
    """Where a secret is: a file, an environment variable or a systemd credential, never the configuration."""

    file: FilePath | None = None
    env: Text | None = None
    credential: Text | None = None

    def read(self, folder: Path, environment: Mapping[str, str] | None = None) -> str:
        """Return the secret; paths start at the folder. Raises OSError, KeyError where it is not there."""
        if self.file is not None:
            return (folder / self.file).read_text(encoding="utf-8").strip()
        if self.credential is not None:
            place = Path((environment or {})["CREDENTIALS_DIRECTORY"])
            return (place / Path(self.credential).name).read_text(encoding="utf-8").strip()
        return (environment or {})[self.env or ""]


def is_vague(secret: object) -> bool:
    """Tell whether a secret names no place, or several."""
    places = () if not isinstance(secret, Secret) else (secret.file, secret.env, secret.credential)
    return isinstance(secret, Secret) and sum(place is not None for place in places) != 1


def without_plain_secrets(raw: object, path: str, faults: Faults) -> object:
    """Return what was read without the secrets that stand in it, and note each, at any depth.

    Only places of secrets may: { file = "..." }, or the same with env or credential. No other fault quotes
    one then.
    """
    if isinstance(raw, list):
        return [without_plain_secrets(item, join(path, i), faults) for i, item in enumerate(raw)]
    if not isinstance(raw, dict):
        return raw
    kept = {}
    for key, value in raw.items():
        if not is_secret(key):
            kept[key] = without_plain_secrets(value, join(path, key), faults)
            continue
        if _names_places(value):
            kept[key] = value
        if not _is_reference(value):
            what = "a secret must not stand in a configuration"
            faults.add(join(path, key), what, 'name where it is: { file = "..." } or { env = "..." }')
    return kept


def _names_places(value: object) -> bool:
    return isinstance(value, dict) and not {*value} - {*_PLACES}


def _is_reference(value: object) -> bool:
    return (
        isinstance(value, Mapping)
        and len(value) == 1
        and all(key in _PLACES and isinstance(where, str) and where for key, where in value.items())
    )
