"""One frame of the state of rigs, drawn by rich: values with their bars against limits, alarms, sources."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from agent.cli.tuning import BAR_LIMITS, BAR_WIDTH, LEAST_BAR
from agent.text import number, printable, short_time, with_sd

Row = Mapping[str, Any]
_WRAPPED = ("what", "status", "")
_STYLES = {"valid": "green", "warming": "cyan", "unexcited": "yellow", "invalid": "red"}
_STATE_STYLES = {"UNACK": "bold white on red", "ACKED": "red", "RTNUN": "yellow"}


def frame(overview: Mapping[str, Any], clock: str) -> RenderableType:
    """Return the picture of `state.overview`; clock: the time to show at its top."""
    parts: list[RenderableType] = [_line(f"deltak  {clock}", "bold")]
    for rig in overview["rigs"]:
        parts += _rig(rig)
    if not overview["rigs"]:
        parts.append(_line("no rig has rows yet", "yellow"))
    if overview["refused"]:
        parts.append(_line(f"{overview['refused']} rows are not shown, their checksums are wrong", "red"))
    return Group(*parts)


def _line(text: str, style: str = "") -> Text:
    return Text(printable(text), style=style)


def _rig(rig: Mapping[str, Any]) -> Iterable[RenderableType]:
    lag = "no rows yet" if rig["lag_s"] is None else f"newest row {_age(rig['lag_s'])} ago"
    yield _line(f"\n{rig['rig']}: {rig['words']}, {lag}", "bold")
    yield _table(
        ("parameter", "value ± sd", "", "of limit", "status", "alarm"), map(_parameter, rig["parameters"])
    )
    if rig["parameters"]:
        yield _line(rig["known"])
    if rig["alarms"]:
        yield _table(("alarm", "priority", "state", "raised", "what"), map(_alarm, rig["alarms"]))
    if rig["sources"]:
        yield _table(
            ("source", "samples/s", "lag", "rejected", "dropped", "gaps", ""), map(_source, rig["sources"])
        )
    if rig["covariates"]:
        yield _table(("covariate", "value", "read", "what"), map(_covariate, rig["covariates"]))


def _table(columns: Iterable[str], rows: Iterable[Sequence[RenderableType]]) -> Table:
    """Return a table that gives its width to figures: bars get narrow first, then words are wrapped."""
    cells = [[_line(cell) if isinstance(cell, str) else cell for cell in row] for row in rows]
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for place, column in enumerate(columns):
        least = max((getattr(row[place], "cell_len", 0) for row in cells), default=0)
        words = column in _WRAPPED
        table.add_column(column, no_wrap=not words, min_width=None if words else max(least, len(column)))
    for row in cells:
        table.add_row(*row)
    return table


def _parameter(row: Row) -> tuple[RenderableType, ...]:
    status = row["status"] + (f": {row['reason']}" if row["reason"] else "")
    used = "" if row["used"] is None else f"{100.0 * row['used']:.0f} %"
    alarm = _line(row["alarm"] or "", _STATE_STYLES.get(row["alarm"], ""))
    style = _STYLES.get(row["status"], "")
    value = f"{with_sd(row['value'], row['sd'])} {row['unit'] or ''}".rstrip()
    return row["parameter"], value, _Bar(row, style), used, _line(status, style), alarm


@dataclass(frozen=True, slots=True)
class _Bar:
    """A bar as wide as there is room for."""

    row: Row
    style: str

    def __rich_measure__(self, _console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(LEAST_BAR, min(options.max_width, BAR_WIDTH))

    def __rich_console__(self, _console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        yield _line(bar(self.row, min(options.max_width, BAR_WIDTH)), self.style)


def bar(row: Row, width: int = BAR_WIDTH) -> str:
    """Draw an interval on a scale: `│` at the limits and the reference, `━` what may be, `●` the estimate.

    row: of `overview`. Without a limit the scale is what the interval needs; without an estimate it is empty.
    """
    reference = row["reference"]
    values = [row[key] for key in ("lower", "upper", "value")]
    if reference is None or any(value is None for value in values):
        return "·" * width
    limit = row["limit"]
    reach = BAR_LIMITS * limit if limit else 1.1 * max(abs(value - reference) for value in values) or 1.0
    first, last, middle = (_cell((value - reference) / reach, width) for value in values)
    cells = ["·"] * width
    for mark in [0.0, *((-limit / reach, limit / reach) if limit else ())]:
        cells[_cell(mark, width)] = "│"
    cells[first : last + 1] = "━" * (last + 1 - first)
    cells[middle] = "●"
    return "".join(cells)


def _cell(share: float, width: int) -> int:
    return round((min(max(share, -1.0), 1.0) + 1.0) / 2.0 * (width - 1))


def _alarm(row: Row) -> tuple[RenderableType, ...]:
    state = _line(row["state"], _STATE_STYLES.get(row["state"], ""))
    return str(row["id"]), row["priority"], state, short_time(row["raised_at"]), row["message"]


def _source(row: Row) -> tuple[RenderableType, ...]:
    silent = _line("silent", "red") if row["stale"] else ""
    counts = (str(row[key]) for key in ("rejected", "dropped", "gaps"))
    lag = "-" if row["lag_s"] is None else f"{row['lag_s']:.3g} s"
    return row["source"], number(row["rate_hz"], 4), lag, *counts, silent


def _covariate(row: Row) -> "tuple[RenderableType, ...]":
    value = "-" if row["value"] is None else f"{number(row['value'], 4)} {row['unit']}"
    read = "never" if row["age_s"] is None else f"{_age(row['age_s'])} ago"
    return row["covariate"], value, _line(read, "red" if row["stale"] else ""), row["words"]


def _age(seconds: float) -> str:
    """Write an age in the unit that shows it in few digits."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.1f} s"
