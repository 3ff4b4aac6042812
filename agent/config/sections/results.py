"""The tables of what becomes of results as frozen models; attribute names are the file's keys."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import Field, Strict, ValidationInfo, field_validator

from agent.config.reading.fields import (
    Duration,
    FilePath,
    Hours,
    Name,
    NotNegative,
    Positive,
    Table,
    Text,
    Texts,
)
from agent.config.reading.secrets import Secret
from agent.types import AlarmKind

Setting = TypeVar("Setting", str, Path)
Priority = Literal["low", "medium", "high", "critical"]
PRIORITIES: tuple[Priority, ...] = ("low", "medium", "high", "critical")


class Keep(Table):
    """For how long rows are kept, seconds; infinite for "forever"."""

    full: Duration = 7 * 86400.0
    minute: Duration = 90 * 86400.0
    hour: Duration = float("inf")


class Recordings(Table):
    """Limits of each source's raw recordings (`record = true`): megabytes and age, the oldest go first."""

    max_mb: Positive = 1024.0
    keep: Duration = float("inf")


class Events(Table):
    """The raw samples that are kept around alarms; the oldest records go first.

    per_hour bounds what a restless alarm writes; max_count = 0 keeps none.
    """

    before_s: NotNegative = 10.0
    after_s: NotNegative = 10.0
    max_count: int = Field(default=100, ge=0, le=10_000)
    max_mb: Positive = 100.0
    keep: Duration = float("inf")
    per_hour: int = Field(default=12, ge=1, le=3600)


class Store(Table):
    """Where and how densely results are kept; path is absolute, by default <rig>.db beside the file."""

    path: FilePath = Path()
    every_s: NotNegative = 1.0
    commit_s: Annotated[float, Field(ge=0.02, le=60.0, description="seconds from 0.02 to 60")] = 1.0
    keep: Keep = Keep()
    max_mb: Positive = 1024.0
    recordings: Recordings = Recordings()
    events: Events = Events()


class Forecast(Table):
    """When forecasts are made and how far ahead; like names histories of like machines, or a learnt prior.

    every: from one forecast of a parameter to the next; infinite makes them at alarms only. horizon: what the
    chance is of; None for as long again as the history is.
    """

    every: Duration = 3600.0
    horizon: Duration | None = None
    like: Annotated[tuple[FilePath, ...], Strict(False)] = ()

    def beside(self, folder: Path) -> "Forecast":
        """Return the same with paths that start at a folder."""
        return self.model_copy(update={"like": tuple(folder / path for path in self.like)})


class Metrics(Table):
    """Where the agent's figures can be read, in Prometheus text form; they are those of the whole agent."""

    unprotected: bool = False
    listen: Text | None = None
    textfile: FilePath | None = None

    @field_validator("listen")
    @classmethod
    def _check_listen(cls, listen: str, info: ValidationInfo) -> str:
        host, _, port = listen.rpartition(":")
        if not host or not port.isdigit() or not 0 <= int(port) <= 65535:
            raise ValueError(f'must be "ADDRESS:PORT" such as "127.0.0.1:9464", not "{listen}"')
        is_local = host in {"localhost", "[::1]"} or host.startswith("127.")
        if not is_local and not info.data.get("unprotected"):
            raise ValueError(
                f'"{listen}" is open to other machines, without a password; '
                "say unprotected = true, or use 127.0.0.1"
            )
        return _with_library(listen)

    @field_validator("textfile")
    @classmethod
    def _check_textfile(cls, file: Path) -> Path:
        if file.suffix != ".prom":
            raise ValueError(f'must end in .prom, which is what node_exporter reads, not "{file}"')
        return _with_library(file)


def _with_library(value: Setting) -> Setting:
    if find_spec("prometheus_client") is None:
        raise ValueError("needs prometheus_client, which is not installed; pip install 'deltak[metrics]'")
    return value


class Notify(Table):
    """One target. What a kind needs beside name and kind: command; url; host, sender and recipients."""

    name: Name = Field(description='a name such as "shift"')
    kind: Literal["command", "webhook", "smtp", "apprise"]
    priority: Priority = "low"
    kinds: Annotated[tuple[AlarmKind, ...], Strict(False), Field(min_length=1)] | None = None
    quiet: Hours | None = None
    timeout_s: Positive = 30.0
    attempts: int = Field(default=400, ge=1, le=100_000)
    command: Texts | None = Field(
        default=None, description='a list such as ["/usr/local/bin/page", "--shift"]'
    )
    url: Text | Secret | None = None
    token: Secret | None = None
    host: Text | None = None
    port: int | None = Field(default=None, ge=1, le=65535)
    tls: Literal["starttls", "tls", "none"] = "starttls"
    sender: Text | None = None
    recipients: Texts | None = None
    user: Text | None = None
    password: Secret | None = None
