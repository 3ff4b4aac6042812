"""Times that people type: ISO 8601, or an age counted back from the newest row."""

import re
from datetime import UTC, datetime
from decimal import Decimal

from agent.errors import UsageError

_AGE = re.compile(r"(\d+(?:\.\d+)?)\s*(ms|s|m|min|h|d|w)")
_UNIT_NS = {
    "ms": 10**6, "s": 10**9, "m": 60 * 10**9, "min": 60 * 10**9, "h": 3600 * 10**9, "d": 86400 * 10**9,
    "w": 604800 * 10**9,
}  # fmt: skip
_ISO = re.compile(r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9}))?)?\s*(Z|[+-]\d\d:?\d\d)?")


def age_ns(text: str) -> int | None:
    """Return an age such as "30d", "12h", "90s" in ns; None when the text is none."""
    match = _AGE.fullmatch(text.strip().lower())
    return int(Decimal(match[1]) * _UNIT_NS[match[2]]) if match else None


def parse_time(text: str, newest_ns: int | None, place: str = "time") -> int:
    """Return nanoseconds since the epoch.

    Args:
        text: ISO 8601 (UTC unless it says otherwise; up to nine decimals) or an age counted back from
            `newest_ns`.
        newest_ns: the newest row there is; None when there is none (an age then reaches back from time zero).
        place: where it was typed.

    Raises:
        UsageError: the text is neither.
    """
    age = age_ns(text)
    if age is not None:
        return (newest_ns or 0) - age
    match = _ISO.fullmatch(text.strip())
    if match is None:
        raise UsageError.at(
            place, f'"{text}" is no time', 'write 2026-03-01T12:00:00Z, or an age such as "30d" or "12h"'
        )
    return _iso_ns(text, match, place)


def _iso_ns(text: str, match: "re.Match[str]", place: str) -> int:
    day, clock, fraction, zone = match.groups()
    zone = "+00:00" if zone in {None, "Z"} else zone
    try:
        moment = datetime.fromisoformat(f"{day}T{clock or '00:00'}{zone}")
    except ValueError as error:
        raise UsageError.at(place, f'"{text}" is no time ({error})', "write 2026-03-01T12:00:00Z") from error
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86400 + since.seconds) * 10**9 + int((fraction or "").ljust(9, "0"))
