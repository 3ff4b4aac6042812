"""The table of one consumer: what it gets of the database's rows, and how it is reached."""

from typing import Annotated, Literal

from pydantic import Field, Strict, field_validator

from agent.config.reading.fields import Duration, FilePath, Name, Names, Positive, Table, Text
from agent.config.reading.secrets import Secret
from agent.config.tuning import ARCHIVE_ROWS

Kind = Literal["mqtt", "sparkplug", "postgres", "parquet"]
Topic = Literal["alarms", "estimates", "events", "health"]
TOPICS: tuple[Topic, ...] = ("alarms", "estimates", "events", "health")
"""In the order in which what is new of them is sent."""


class North(Table):
    """One consumer. What a kind needs beside name and kind: url; folder of parquet."""

    name: Name = Field(description='a name such as "plant-broker"')
    kind: Kind
    topics: Annotated[tuple[Topic, ...], Strict(False), Field(min_length=1)] = TOPICS
    parameters: Names | None = None
    backfill: bool = True
    batch: int = Field(default=200, ge=1, le=100_000, description="instants or rows that are sent together")
    timeout_s: Positive = Field(default=10.0, le=60.0)
    url: Text | None = Field(default=None, description='an address such as "mqtts://broker.example.org"')
    prefix: Text = "deltak"
    client_id: Text | None = None
    user: Text | None = None
    password: Secret | None = None
    ca: FilePath | None = None
    cert: FilePath | None = None
    key: FilePath | None = None
    discovery: Text | None = None
    node: Text | None = None
    primary_host: Text | None = None
    folder: FilePath | None = None
    every: Duration = 86400.0

    @field_validator("kind", mode="before")
    @classmethod
    def _is_in_this_version(cls, kind: object) -> object:
        if kind == "opcua":
            raise ValueError("is not in this version; deltak opcua serves it")
        return kind

    @property
    def is_periodic(self) -> bool:
        """Whether it gets its rows by schedule rather than as they come."""
        return self.kind == "parquet"

    @property
    def at_once(self) -> int:
        """Instants or rows of a batch: by default many for an archive, whose files are not to be small."""
        is_stated = "batch" in self.model_fields_set
        return ARCHIVE_ROWS if self.is_periodic and not is_stated else self.batch
