"""The keys of a source that say how samples lie in CAN frames, the same live and from a log."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from drivers import crc
from drivers.port import DriverSettings

XOR, SUM = "xor", "sum"


def _method(name: str) -> str:
    if name not in (XOR, SUM):
        try:
            crc.by_name(name)
        except ValueError as error:
            raise ValueError(f'{error}; "{XOR}" and "{SUM}" are known too') from None
    return name


def _hex(text: str) -> str:
    bytes.fromhex(text)
    return text


class ChecksumKeys(DriverSettings):
    """How frames are checked.

    Attributes:
        signal: the signal of that name in every message that is read.
        method: "xor" or "sum" of bytes (the sum's lowest bits), or a CRC's catalogue name.
        over: "others": all bytes but the checksum's own; "zeroed": all, the checksum's bits taken as 0.
        data_id: bytes in hexadecimal that stand before the frame's own in the calculation.
    """

    signal: str = Field(min_length=1)
    method: Annotated[str, AfterValidator(_method)]
    over: Literal["others", "zeroed"] = "others"
    data_id: Annotated[str, AfterValidator(_hex)] = ""


class FrameKeys(DriverSettings):
    """The DBC file, and what it does not say.

    Attributes:
        j1939: "auto": messages that the DBC file calls J1939 are known by their parameter group, whatever
            priority, source and destination; "group": all extended ones are; "exact": none.
        source_address: of those known by their group only the frames of this sender.
        samples_per_frame: a frame carries so many samples: the mapped signals are the first one's and end in
            a number ("Force_0"), the next ones' end in the numbers that follow.
        counter_counts: whether the counter is the number of a frame's first sample or the frame's own.
        counter_modulus: the counter begins anew after so many; by default after 2 to the power of its bits.
        sample_period_s: between the samples of a frame, for their time stamps; the frame's own is the last
            one's.
    """

    dbc: Path
    j1939: Literal["auto", "group", "exact"] = "auto"
    source_address: int | None = Field(default=None, ge=0, le=255)
    samples_per_frame: int = Field(default=1, ge=1, le=64)
    counter_counts: Literal["samples", "frames"] = "samples"
    counter_modulus: int | None = Field(default=None, ge=2)
    sample_period_s: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    checksum: ChecksumKeys | None = None

    @model_validator(mode="after")
    def _several_have_their_keys(self) -> Self:
        if self.samples_per_frame == 1 and (
            self.counter_counts == "frames" or self.sample_period_s is not None
        ):
            raise ValueError("counter_counts and sample_period_s are for samples_per_frame above 1")
        return self
