"""Kinds of values that configuration tables hold; each says in words what it wants."""

import math
import re
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator, Strict

from agent.config.tuning import GREATEST, LEAST, LONGEST_SKEW_S

NAME: Final = r"^[A-Za-z][A-Za-z0-9_.-]{0,63}$"
_DURATION: Final = re.compile(r"(\d+(?:\.\d+)?)\s*([smhdwy])")
_HOURS: Final = re.compile(r"([01]\d|2[0-3]):([0-5]\d)-([01]\d|2[0-3]):([0-5]\d)")
_SECONDS: Final = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0, "y": 365.25 * 86400.0}


class Table(BaseModel):
    """A table of the configuration: frozen, no unknown keys, text is never taken for a number."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def shown(value: object) -> str:
    """Write a value of the file in a message, short and on one line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, int) and value.bit_length() > 64:
        return "a number of more than 64 bits"
    return str(value)


def _quoted(value: str) -> str:
    text = value if value.isprintable() else value.encode("unicode_escape").decode("ascii")
    return f'"{text[:40]}..."' if len(text) > 43 else f'"{text}"'


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _positive(value: object, wanted: str) -> float:
    if not _is_number(value):
        raise ValueError(f"must be {wanted}, not {shown(value)}")
    number = _as_float(value)
    if not (math.isfinite(number) and number > 0):
        raise ValueError(f"must be greater than 0, not {shown(value)}")
    return within_reach(number)


def _as_float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _window(value: object) -> float | tuple[float, ...] | Literal["auto"]:
    if value == "auto":
        return "auto"
    wanted = 'a number of seconds, a list of them, or "auto"'
    if not isinstance(value, list):
        return _positive(value, wanted)
    lengths = tuple(_positive(item, wanted) for item in value)
    if not lengths or len(set(lengths)) < len(lengths):
        raise ValueError("must list different lengths, at least one")
    return lengths


def _skew(value: object) -> float | Literal["auto"]:
    if value == "auto":
        return "auto"
    if not _is_number(value) or not math.isfinite(number := _as_float(value)):
        raise ValueError(f'must be a number of seconds or "auto", not {shown(value)}')
    if abs(number) > LONGEST_SKEW_S:
        raise ValueError(f"must be at most {LONGEST_SKEW_S:g} s, not {shown(value)}")
    return number


def _intensities(value: object) -> float | tuple[float, ...]:
    wanted = "a number or a list with one number a mass"
    if not isinstance(value, list):
        is_zero = _is_number(value) and value == 0
        return 0.0 if is_zero else _positive(value, wanted)
    numbers = tuple(_as_float(item) if _is_number(item) else math.nan for item in value)
    are_good = all(0 <= number < math.inf for number in numbers)
    if not numbers or not are_good:
        raise ValueError(f"must be {wanted}, none negative")
    return tuple(within_reach(number) for number in numbers)


def _duration(value: object) -> float:
    """Read "7d" or "forever" as seconds."""
    if value == "forever":
        return math.inf
    match = _DURATION.fullmatch(value) if isinstance(value, str) else None
    if not match or not (seconds := float(match[1]) * _SECONDS[match[2]]):
        raise ValueError(
            f'must be a duration such as "7d", not {shown(value)}; '
            'units are s, m, h, d, w, y, or write "forever"'
        )
    return seconds


def _hours(value: object) -> tuple[int, int]:
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


def _one_line(value: str) -> str:
    if not value.strip() or not value.isprintable():
        raise ValueError("must be a text of printable characters, not empty")
    return value


def _path(value: object) -> Path:
    if isinstance(value, Path):
        return value
    if not isinstance(value, str):
        raise ValueError(f"must be a path in quotes, not {shown(value)}")  # noqa: TRY004 - pydantic collects it
    return Path(_one_line(value))


def within_reach(number: float) -> float:
    """Return a number that can be computed with: squares and products of a few of these stay numbers."""
    if number and not LEAST <= abs(number) <= GREATEST:
        raise ValueError(f"must be 0 or between {LEAST:g} and {GREATEST:g} in size, not {shown(number)}")
    return number


Name = Annotated[str, Field(pattern=NAME)]
Text = Annotated[str, AfterValidator(_one_line)]
Number = Annotated[float, AfterValidator(within_reach)]
Positive = Annotated[float, Field(gt=0), AfterValidator(within_reach)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(within_reach)]
Window = Annotated[float | tuple[float, ...] | Literal["auto"], PlainValidator(_window)]
Skew = Annotated[float | Literal["auto"], PlainValidator(_skew)]
Intensities = Annotated[float | tuple[float, ...], PlainValidator(_intensities)]
Duration = Annotated[float, PlainValidator(_duration)]
Hours = Annotated[tuple[int, int], PlainValidator(_hours)]
Texts = Annotated[tuple[Text, ...], Strict(False), Field(min_length=1)]
FilePath = Annotated[Path, PlainValidator(_path)]
Row = Annotated[tuple[Number, ...], Strict(False)]
Matrix = Annotated[tuple[Row, ...], Strict(False)]
Asked = Annotated[str, Field(pattern=rf"{NAME}|^[ABCD]\[[0-9]+, ?[0-9]+\]$")]
"""A parameter by its name, or as the entry of a linear model's matrix that it is, such as "A[0,1]"."""
Names = Annotated[tuple[Asked, ...], Strict(False), Field(min_length=1)]
