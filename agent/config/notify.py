"""[[notify]]: whom steps of alarms are sent to, which of them, and when not."""

import re
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, PlainValidator, Strict

from agent.config.fields import FilePath, Name, Positive, Table, Text, shown

Priority = Literal["low", "medium", "high", "critical"]
PRIORITIES: Final[tuple[Priority, ...]] = ("low", "medium", "high", "critical")
Kind = Literal["level", "rate", "forecast", "sensor", "source", "blind", "mismatch"]
_HOURS: Final = re.compile(r"([01]\d|2[0-3]):([0-5]\d)-([01]\d|2[0-3]):([0-5]\d)")


class Secret(Table):
    """Where a secret is: in a file or in an environment variable, never in the configuration."""

    file: FilePath | None = None
    env: Text | None = None

    def read(self, folder: Path, environment: "dict[str, str] | None" = None) -> str:
        """Return the secret; paths start at the folder. Raises OSError, KeyError where it is not there."""
        if self.file is not None:
            return (folder / self.file).read_text(encoding="utf-8").strip()
        return (environment or {})[self.env or ""]


def _quiet(value: object) -> tuple[int, int]:
    """Read "22:00-06:00" as minutes of the day; a pair is one already read."""
    if isinstance(value, tuple):
        return value
    match = _HOURS.fullmatch(value) if isinstance(value, str) else None
    if not match:
        raise ValueError(f'must be hours of the local day such as "22:00-06:00", not {shown(value)}')
    first, last = 60 * int(match[1]) + int(match[2]), 60 * int(match[3]) + int(match[4])
    if first == last:
        raise ValueError(f"must begin and end at different times, not {shown(value)}")
    return first, last


Hours = Annotated[tuple[int, int], PlainValidator(_quiet)]
Texts = Annotated[tuple[Text, ...], Strict(False), Field(min_length=1)]


class Notify(Table):
    """One target. What a kind needs beside name and kind: command; url; host, sender and recipients."""

    name: Name = Field(description='a name such as "shift"')
    kind: Literal["command", "webhook", "smtp"]
    priority: Priority = "low"
    kinds: Annotated[tuple[Kind, ...], Strict(False), Field(min_length=1)] | None = None
    quiet: Hours | None = None
    timeout_s: Positive = 30.0
    attempts: int = Field(default=400, ge=1, le=100_000)
    command: Texts | None = Field(default=None, description='a list such as ["/usr/local/bin/page", "--shift"]')
    url: Text | Secret | None = None
    token: Secret | None = None
    host: Text | None = None
    port: int | None = Field(default=None, ge=1, le=65535)
    tls: Literal["starttls", "tls", "none"] = "starttls"
    sender: Text | None = None
    recipients: Texts | None = None
    user: Text | None = None
    password: Secret | None = None


NEEDED: Final = {"command": ("command",), "webhook": ("url",), "smtp": ("host", "sender", "recipients")}
"""Keys that a kind cannot do without."""
OWN: Final = {
    "command": ("command",),
    "webhook": ("url", "token"),
    "smtp": ("host", "port", "tls", "sender", "recipients", "user", "password"),
}
"""Keys that belong to one kind."""
