"""A serial line as a source of samples. Only reads: nothing is ever written to the line."""

import re
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from drivers import clock, crc
from drivers.fields import FieldSpec, Layout, unique_names
from drivers.pipe import Pipe, serial_pipe
from drivers.port import Driver, DriverConfigError, DriverIOError, DriverSettings, SampleBlock, SourceRequest
from drivers.serial import patterns
from drivers.serial.codec import BinaryDecoder, Frame, SerialDecoder
from drivers.serial.delimited import EndedDecoder
from drivers.serial.framing import FRAMINGS
from drivers.serial.text import TextDecoder
from drivers.serial.tuning import FEW_BYTES, LINE_PERIOD_S
from drivers.serial_port import SerialKeys, port_hint
from drivers.tuning import RETRY_HERE_S

_DOLLAR_FIRST = re.compile(r"\^?\(?(?:\\\$|\[\$\]|\$)")
_NMEA = 'with checksum = "nmea" a line is $ADDRESS,cells*HH,'


def _known_crc(name: str | None) -> str | None:
    if name is not None:
        crc.by_name(name)
    return name


def _hex(text: str | None) -> str | None:
    if text is not None and not bytes.fromhex(text):
        raise ValueError("sync must name at least one byte, e.g. AA55")
    return text


def _expression(text: str | None) -> str | None:
    if text is not None and not patterns.check(text).groupindex:
        raise ValueError(r"names no groups; write e.g. (?P<force>\S+)")
    return text


class SerialSettings(SerialKeys):
    """Keys of a serial source: the line, and either the binary frame or the lines of text on it."""

    format: Literal["binary", "text"]
    framing: Literal["sync", "cobs", "slip"] = "sync"
    sync: Annotated[str | None, AfterValidator(_hex)] = None
    byte_order: Literal["little", "big"] = "little"
    fields: Annotated[tuple[FieldSpec, ...], AfterValidator(unique_names)] = ()
    crc: Annotated[str | None, AfterValidator(_known_crc)] = None
    delimiter: str | None = Field(default=None, min_length=1)
    columns: tuple[str, ...] = ()
    pattern: Annotated[str | None, AfterValidator(_expression)] = None
    checksum: Literal["nmea", "none"] = "none"
    counter_modulus: int | None = Field(default=None, ge=2)
    period_s: float = Field(default=LINE_PERIOD_S, gt=0, le=LINE_PERIOD_S)

    @model_validator(mode="after")
    def _binary_has_its_keys(self) -> Self:
        if self.format != "binary":
            return self
        has_ends = self.framing != "sync" or self.sync is not None
        if not has_ends or not self.fields:
            raise ValueError(
                'format "binary" needs sync and fields, or a framing "cobs" or "slip" and fields'
            )
        if self.framing != "sync" and self.sync is not None:
            raise ValueError(f'framing "{self.framing}" has no sync: its ends divide the frames')
        of_text = (self.columns, self.pattern, self.delimiter, self.counter_modulus, self.checksum != "none")
        if any(of_text):
            raise ValueError(
                'format "binary" has no delimiter, columns, pattern, checksum or counter_modulus; '
                'its check is "crc"'
            )
        if sum(field.size for field in self.fields) > 1024:
            raise ValueError("a frame may have up to 1024 bytes")
        return self

    @model_validator(mode="after")
    def _text_has_its_keys(self) -> Self:
        if self.format != "text":
            return self
        if bool(self.columns) == bool(self.pattern):
            raise ValueError('format "text" needs either columns or a pattern')
        if self.sync or self.fields or self.crc or self.framing != "sync":
            raise ValueError('format "text" has no framing, sync, fields or crc; its check is "checksum"')
        return self

    @model_validator(mode="after")
    def _nmea_leaves_out_its_dollar(self) -> Self:
        if self.checksum != "nmea":
            return self
        if any("$" in column for column in self.columns):
            raise ValueError(
                f"columns: {_NMEA} and columns are the cells behind the address; leave the address out"
            )
        if self.pattern and _DOLLAR_FIRST.match(self.pattern):
            raise ValueError(
                f"pattern: {_NMEA} and it is held against ADDRESS,cells; leave the dollar sign out"
            )
        return self


class SerialDriver(Driver):
    """Samples on a serial line, in binary frames or lines of text."""

    settings_model: ClassVar[type[DriverSettings]] = SerialSettings
    stamped: ClassVar[bool | None] = False

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self._settings: SerialSettings = request.settings
        self._decoder: SerialDecoder = self._text() if self._settings.format == "text" else self._binary()
        self.counter_modulus = self._settings.counter_modulus or self._decoder.modulus
        self._pipe: Pipe | None = None
        self._opened = False
        self._due = 0.0

    def _binary(self) -> SerialDecoder:
        settings = self._settings
        layout = Layout(settings.fields, settings.byte_order)
        check = crc.by_name(settings.crc) if settings.crc else None
        frame = Frame(layout, check, self.request.fields, self.request.counter, self.counts)
        if settings.framing != "sync":
            return EndedDecoder(FRAMINGS[settings.framing], frame)
        if settings.sync is None:
            raise DriverConfigError(f'{self.request.name}: format "binary" needs sync')
        return BinaryDecoder(bytes.fromhex(settings.sync), frame)

    def _text(self) -> TextDecoder:
        settings = self._settings
        columns, delimiter, pattern = settings.columns, settings.delimiter, None
        if settings.pattern:
            pattern = re.compile(settings.pattern)
            columns = columns or tuple(pattern.groupindex)
        if settings.columns:
            delimiter = delimiter or ","
        return TextDecoder(
            columns,
            delimiter,
            pattern,
            settings.checksum == "nmea",
            self.request.fields,
            self.request.counter,
            self.counts,
            self._note_line,
        )

    def _note_line(self, words: str) -> None:
        self.note(f"{self.request.name}: a line is {words}")

    @property
    def retry_s(self) -> float:
        return RETRY_HERE_S

    def open(self) -> None:
        self.close()
        self._pipe = serial_pipe(
            self._settings, str(self.request.folder / self._settings.port), read_only=True
        )
        self._decoder.restart()
        self.counts.reopened += self._opened
        self._opened = True

    def read(self, timeout_s: float) -> SampleBlock:
        if self._pipe is None:
            raise DriverIOError(f"{self.request.name}: read before open")
        deadline = clock.monotonic() + timeout_s
        clock.sleep(max(0.0, min(self._due, deadline) - clock.monotonic()))
        data = self._pipe.recv(deadline)
        self._due = clock.monotonic() + self._settings.period_s if 0 < len(data) < FEW_BYTES else 0.0
        values, counter = self._decoder.feed(data)
        return SampleBlock(values, clock.monotonic_ns(), counter)

    def close(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
        self._pipe = None

    def resolution(self) -> tuple[float, ...]:
        return self._decoder.resolution()

    def hints(self) -> tuple[str, ...]:
        hint = port_hint(self._settings.port)
        return () if hint is None else (hint,)
