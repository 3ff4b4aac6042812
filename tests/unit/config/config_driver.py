"""A driver that the configuration tests can name: a few keys, no bus."""

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.port import Driver, DriverSettings, SampleBlock


class WireField(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str
    type: Literal["int16", "int32"]


class FakeSettings(DriverSettings):
    interface: Literal["socketcan", "socketcand"]
    channel: str = "can0"
    bitrate: int | None = Field(default=None, gt=0)
    port: int | str = 28600
    dbc: str | None = None
    fields: tuple[WireField, ...] = ()

    @model_validator(mode="after")
    def _has_names(self) -> Self:
        if self.dbc is None and not self.fields:
            raise ValueError("names of signals are missing; give dbc or fields")
        return self


class FakeDriver(Driver):
    settings_model = FakeSettings

    def open(self) -> None: ...

    def read(self, timeout_s: float) -> SampleBlock:
        raise EOFError

    def close(self) -> None: ...

    def resolution(self) -> tuple[float, ...]:
        return tuple(0.0 for _ in self.request.fields)
