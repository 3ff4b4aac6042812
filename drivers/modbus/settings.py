"""The configuration keys of a Modbus source and what must hold among them."""

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, Strict, model_validator

from drivers.fields import FieldSpec, Order, unique_names
from drivers.modbus.frames import FIFO_REGISTERS
from drivers.modbus.tuning import LONGEST_PERIOD_S, POLL_S, RING_S
from drivers.port import DriverSettings

BYTE_ORDERS: Mapping[str, tuple[Order, Order]] = {
    "ABCD": ("big", "big"),
    "CDAB": ("big", "little"),
    "BADC": ("little", "little"),
    "DCBA": ("little", "big"),
}
"""Byte and word order of a layout, by what instruments call it."""
Address = Annotated[int, Field(ge=0, le=65535)]


class ModbusField(FieldSpec):
    """A number in a slot or queue entry, or, in mode poll, at an address of its own."""

    address: Address | None = None


class IndexKeys(DriverSettings):
    """Where the device counts the samples written so far."""

    address: Address
    type: Literal["uint16", "uint32"] = "uint32"


class RingKeys(DriverSettings):
    """Where the slots of the ring lie."""

    address: Address
    slots: int = Field(ge=2, le=65536)


class ModbusSettings(DriverSettings):
    """Keys of a Modbus source (addresses are zero-based, as on the wire)."""

    transport: Literal["tcp", "rtu"] = "tcp"
    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    port: Annotated[int, Strict()] | str = 502
    baudrate: int = Field(default=19200, gt=0)
    parity: Literal["N", "E", "O", "M", "S"] = "N"
    stopbits: int = Field(default=1, ge=1, le=2)
    device_id: int = Field(default=1, ge=0, le=255)
    function: Literal[3, 4] = 4
    word_order: Order = "big"
    byte_order: Literal["ABCD", "CDAB", "BADC", "DCBA"] | None = None
    timeout_s: float = Field(default=0.5, gt=0, le=60)
    mode: Literal["ring", "poll", "fifo"]
    index: IndexKeys | None = None
    ring: RingKeys | None = None
    address: Address | None = None
    period_s: float = Field(
        default_factory=lambda keys: RING_S if keys.get("mode") == "ring" else POLL_S,
        gt=0,
        le=LONGEST_PERIOD_S,
    )
    gap: int = Field(default=8, ge=0, le=120)
    share: bool = True
    fields: Annotated[tuple[ModbusField, ...], AfterValidator(unique_names), Field(min_length=1)]

    @property
    def orders(self) -> tuple[Order, Order]:
        """The byte and the word order of a layout."""
        return BYTE_ORDERS[self.byte_order] if self.byte_order is not None else ("big", self.word_order)

    @model_validator(mode="after")
    def _one_key_says_the_order(self) -> Self:
        if self.byte_order is not None and "word_order" in self.model_fields_set:
            raise ValueError("byte_order says the order of words too; leave word_order out")
        return self

    @model_validator(mode="after")
    def _tcp_has_its_port(self) -> Self:
        if self.transport != "tcp":
            return self
        number = self.port if isinstance(self.port, int) else None
        if number is None:
            raise ValueError(f'transport "tcp" needs a port number, not "{self.port}"')
        if not 0 < number < 65536:
            raise ValueError(f"port {self.port} is no TCP port; 1 to 65535 are")
        return self

    @model_validator(mode="after")
    def _rtu_has_its_line(self) -> Self:
        if self.transport != "rtu":
            return self
        is_path = isinstance(self.port, str)
        if not is_path:
            raise ValueError(
                'transport "rtu" needs the path of its serial port, e.g. port = "/dev/serial/by-id/..."'
            )
        if self.device_id == 0:
            raise ValueError(
                "device_id 0 calls all units of a serial line at once, and none of them answers; 1 to 247"
            )
        if not self.share:
            raise ValueError("share: a serial line is one connection; false is for TCP")
        return self

    @model_validator(mode="after")
    def _mode_has_its_keys(self) -> Self:
        needed = {"ring": ("index", "ring"), "poll": (), "fifo": ("address",)}[self.mode]
        missing = [key for key in needed if getattr(self, key) is None]
        if missing:
            raise ValueError(f'mode "{self.mode}" needs {" and ".join(missing)}')
        foreign = {"ring": ("address",), "poll": ("index", "ring", "address"), "fifo": ("index", "ring")}[
            self.mode
        ]
        given = [key for key in foreign if getattr(self, key) is not None]
        if given:
            raise ValueError(f'mode "{self.mode}" has no {" and no ".join(given)}')
        return self

    @model_validator(mode="after")
    def _fields_have_addresses(self) -> Self:
        wants = self.mode == "poll"
        absent = [field.name for field in self.fields if (field.address is None) == wants]
        if absent and self.mode == "poll":
            raise ValueError(f'mode "poll" needs an address for every field; {", ".join(absent)} have none')
        if absent:
            raise ValueError(
                f'mode "{self.mode}" packs its fields; {", ".join(absent)} must not have an address'
            )
        return self

    @model_validator(mode="after")
    def _fields_fit(self) -> Self:
        size = sum(field.size for field in self.fields)
        limit = {"ring": 250, "poll": size, "fifo": 2 * FIFO_REGISTERS}[self.mode]
        if size > limit:
            raise ValueError(f"fields take {size} bytes; one request of mode {self.mode} carries {limit}")
        if self.mode != "poll" and size % 2:
            raise ValueError(f"fields take {size} bytes; registers have two, so the sum must be even")
        return self
