"""Time stamps to integer nanoseconds, exactly, half to even: decimal text, ISO 8601, float seconds."""

import re
from datetime import datetime
from decimal import ROUND_HALF_EVEN, Decimal

import numpy as np
from numpy.typing import NDArray

from drivers.port import BoolArray, IntArray

_ISO = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d)[T ](?P<clock>\d\d:\d\d(?::\d\d)?)"
    r"(?:[.,](?P<part>\d+))?(?P<zone>Z|[+-]\d\d:?\d\d)?"
)
_WIDEST = 40  # fixed by 64 bits of nanoseconds and as many digits behind the point: more are no time stamp
_MOST_SECONDS = 9_000_000_000  # fixed by 64 bits of nanoseconds
_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")


def text_to_ns(text: str) -> int | None:
    """Return the nanoseconds of decimal seconds or of an ISO 8601 time (UTC unless it says), or None."""
    text = text.strip()
    if _PLAIN.fullmatch(text):
        return _decimal_ns(text)
    match = _ISO.fullmatch(text)
    return _iso_ns(match) if match else None


def _decimal_ns(text: str) -> int | None:
    try:
        nanoseconds = int((Decimal(text) * 10**9).to_integral_value(ROUND_HALF_EVEN))
    except ArithmeticError:  # no number, or one of a million digits
        return None
    return nanoseconds if abs(nanoseconds) < 1 << 63 else None


def _iso_ns(match: re.Match[str]) -> int | None:
    zone = (match["zone"] or "Z").replace("Z", "+00:00")
    try:
        whole = datetime.fromisoformat(f"{match['date']}T{match['clock']}{zone}")
    except ValueError:
        return None
    part = _decimal_ns(f"0.{match['part']}") if match["part"] else 0
    return int(whole.timestamp()) * 10**9 + (part or 0)


def column_to_ns(text: NDArray[np.uint8], start: IntArray, end: IntArray) -> IntArray | None:
    """Return nanoseconds of the plain decimal cells text[start:end], (n,); None when any is something else.

    Each decimal place is one step over all cells: digits before the point build the seconds, the nine after
    it the nanoseconds, and those beyond decide the rounding.
    """
    width = int((end - start).max(initial=0))
    if not 0 < width <= _WIDEST:
        return None
    place = np.arange(width)[:, None]
    cells = text[np.minimum(start + place, len(text) - 1)]
    inside = start + place < end
    negative = cells[0] == ord("-")
    digit = (cells >= ord("0")) & (cells <= ord("9")) & inside
    point = (cells == ord(".")) & inside
    sign = ((cells == ord("-")) | (cells == ord("+"))) & (place == 0)
    points = point.sum(axis=0)
    if not (digit | point | sign)[inside].all() or points.max() > 1 or not digit.any(axis=0).all():
        return None
    digits_before = np.where(points > 0, point.argmax(axis=0), end - start)
    return _accumulate(
        np.where(digit, cells - ord("0"), 0).astype(np.int64), digit, place - digits_before, negative
    )


def _accumulate(
    digits: IntArray, digit: BoolArray, after_point: IntArray, negative: BoolArray
) -> IntArray | None:
    seconds = np.zeros(digits.shape[1], np.int64)
    nanoseconds = np.zeros_like(seconds)
    tenth = np.zeros_like(seconds)
    rest = np.zeros(len(seconds), bool)
    for row, is_digit, position in zip(digits, digit, after_point, strict=True):
        before = is_digit & (position < 0)
        seconds = np.where(before, seconds * 10 + row, seconds)
        if seconds.max() > _MOST_SECONDS:
            return None
        within = (position > 0) & (position <= 9)
        nanoseconds = np.where(within, nanoseconds * 10 + row, nanoseconds)
        tenth = np.where(position == 10, row, tenth)
        rest |= (position > 10) & (row > 0)
    nanoseconds *= 10 ** np.clip(9 - after_point[-1], 0, 9)
    up = (tenth > 5) | ((tenth == 5) & (rest | (nanoseconds % 2 == 1)))
    total = seconds * 10**9 + nanoseconds + up
    signed: IntArray = np.where(negative, -total, total)
    return signed


def seconds_to_ns(seconds: NDArray[np.generic]) -> IntArray:
    """Return seconds (or datetime64) as integer nanoseconds, half to even; the least integer if not finite.

    Whole seconds and their fraction are taken apart first: their product with 1e9 would be rounded twice.
    """
    if seconds.dtype.kind == "M":
        return seconds.astype("datetime64[ns]").astype(np.int64)
    values = seconds.astype(np.float64)
    usable = np.isfinite(values) & (np.abs(values) < 9e9)
    values = np.where(usable, values, 0.0)
    whole = np.floor(values)
    nanoseconds = whole.astype(np.int64) * 10**9 + np.rint((values - whole) * 1e9).astype(np.int64)
    return np.where(usable, nanoseconds, np.iinfo(np.int64).min)
