"""Numbers and instants as people read them; used by messages and tables."""

import math
import sys
from datetime import UTC, datetime, timedelta

from agent.units import DAY_S

_ORDERS = {code: f"\\x{code:02x}" for code in (*range(0x20), *range(0x7F, 0xA0)) if code not in (0x09, 0x0A)}
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_AHEAD = (
    (2 * 365.25 * DAY_S, 365.25 * DAY_S, "years"), (2 * DAY_S, DAY_S, "days"), (7200.0, 3600.0, "hours"),
    (120.0, 60.0, "minutes"), (0.0, 1.0, "seconds"),
)  # fmt: skip


def behind(unit: str) -> str:
    """Return a unit as it stands behind a number; nothing of none, or of 1."""
    return "" if unit in {"", "1"} else f" {unit}"


def with_sd(value: float | None, sd: float | None) -> str:
    """Write a value beside its standard deviation, both to the digits the deviation allows: `25.1 ± 0.9`.

    The deviation keeps two digits where it begins with 1 or 2, else one. Very small and very large pairs
    share a power of ten: `(7.49 ± 0.12)e-07`. A value without a usable deviation is written alone, as is one
    whose deviation lies past its own last digit; a dash stands for none.
    """
    if value is None or sd is None:
        return number(value)
    if not (math.isfinite(value) and math.isfinite(sd) and sd > abs(value) * sys.float_info.epsilon):
        return number(value)
    power = math.floor(math.log10(sd))
    decimals = (1 if sd / 10.0**power < 2.95 else 0) - power
    size = math.floor(math.log10(max(abs(value), sd)))
    if -4 <= size < 7:
        return f"{_fixed(value, decimals)} ± {_fixed(sd, decimals)}"
    scale = 10.0**size
    return f"({_fixed(value / scale, decimals + size)} ± {_fixed(sd / scale, decimals + size)})e{size:+03d}"


def interval(lower: float | None, upper: float | None) -> str:
    """Write an interval to the digits that its width allows: `24.8 … 25.3`."""
    if (
        lower is None
        or upper is None
        or not (math.isfinite(lower) and math.isfinite(upper) and upper > lower)
    ):
        return f"{number(lower)} … {number(upper)}"
    decimals = 1 - math.floor(math.log10(upper - lower))
    if not -4 <= math.floor(math.log10(max(abs(lower), abs(upper)))) < 7:
        return f"{number(lower, 4)} … {number(upper, 4)}"
    return f"{_fixed(lower, decimals)} … {_fixed(upper, decimals)}"


def number(value: float | None, digits: int = 6) -> str:
    """Write a number alone, or a dash for none."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.{digits}g}"


def percent(share: float) -> str:
    """Write the size of a share in percent, to two digits where they say something: `12 %`, `100 %`."""
    size = 100.0 * abs(share)
    return f"{size:.0f} %" if size >= 10.0 else f"{size:.2g} %"


def iso_time(t_ns: int) -> str:
    """Write nanoseconds since the epoch as ISO 8601 in UTC with nine decimals and Z."""
    seconds, fraction = divmod(int(t_ns), 1_000_000_000)
    instant = _EPOCH + timedelta(seconds=seconds)
    return f"{instant:%Y-%m-%dT%H:%M:%S}.{fraction:09d}Z"


def local_time(t_ns: int) -> str:
    """Write an instant in UTC to milliseconds and, where they differ, as clocks on the wall show it here."""
    return with_local(iso_time(t_ns))


def with_local(text: str | None) -> str:
    """Shorten ISO 8601 in UTC like `short_time`, beside local time: `2026-07-01 10:00:00.000Z (12:00:00)`."""
    if text is None:
        return ""
    try:
        instant = datetime.fromisoformat(f"{text[:19]}+00:00")
        local = instant.astimezone()
    except (OverflowError, ValueError, OSError):  # years that no time zone knows
        return short_time(text)
    if not local.utcoffset():
        return short_time(text)
    day = "" if local.date() == instant.date() else f"{local:%Y-%m-%d} "
    return f"{short_time(text)} ({day}{local:%H:%M:%S})"


def printable(text: str) -> str:
    """Write control characters as code does: what came from a bus or a file may hold orders to a terminal.

    Tabs and ends of lines stay.
    """
    return text.translate(_ORDERS)


def short_time(text: str | None) -> str:
    """Shorten ISO 8601 with nine decimals to milliseconds for a table; empty for none. Still a valid time."""
    return "" if text is None else text[:23].replace("T", " ") + "Z"


def _fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"


def ahead(seconds: float) -> str:
    """Write a length of time in the unit that suits it."""
    for least, unit, word in _AHEAD:
        if seconds >= least:
            return f"{number(seconds / unit, 3)} {word}"
    return f"{number(seconds, 3)} seconds"


def counted(count: int, one: str, many: str = "") -> str:
    """Write how many there are of what `one` names: `1 window`, `12 windows`; many: where no s makes it."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"
