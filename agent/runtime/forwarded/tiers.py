"""Rows that were forwarded, thinned to points of a trend as a database thins its own: to minutes, then hours.

Rows come in pieces of whole days in order of time, so that years need no more memory than their minutes do.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from agent.storage.read.points import Points
from agent.storage.tables.estimates import repeat_cells
from agent.storage.write.rollups import Groups, grouped
from agent.types import BoolArray, FloatArray, IntArray, Status
from agent.units import HOUR_S, MINUTE_S, SECOND_NS

TextArray = NDArray[Any]
_VALID: Final = int(Status.VALID) << 8
_DTYPES: Final = {
    "seq": np.int64, "run_id": np.int64, "t_ns": np.int64, "parameter": object, "unit": object,
    "status": object,
}  # fmt: skip
COLUMNS: Final = (
    "seq", "run_id", "t_ns", "parameter", "unit", "status", "value", "reference", "sd", "sd_repeat",
    "window_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Piece:
    """Rows of one rig, (n,) each, as `COLUMNS` names them; NaN for none."""

    seq: IntArray
    run_id: IntArray
    t_ns: IntArray
    parameter: TextArray
    unit: TextArray
    status: TextArray
    value: FloatArray
    reference: FloatArray
    sd: FloatArray
    sd_repeat: FloatArray
    window_s: FloatArray

    def __len__(self) -> int:
        return len(self.seq)

    def at(self, rows: NDArray[Any]) -> "Piece":
        """Return the rows that a mask or an array of places names."""
        return Piece(*(getattr(self, one.name)[rows] for one in fields(self)))


def piece_of(columns: Iterable[Iterable[Any]]) -> Piece:
    """Return rows of columns, in the order of `COLUMNS`."""
    return Piece(
        *(
            np.array(column, dtype=_DTYPES.get(name, np.float64))
            for name, column in zip(COLUMNS, columns, strict=True)
        )
    )


def joined(pieces: Iterable[Piece]) -> Piece:
    """Return pieces as one; at least one must be given."""
    every = list(pieces)
    return Piece(*(np.concatenate([getattr(one, part.name) for one in every]) for part in fields(Piece)))


class History:
    """What is gathered of a rig, piece by piece.

    most: rows that a trend is read from at most; of longer histories minutes or hours are.
    """

    def __init__(self, rig: str, most: int) -> None:
        self.rig, self._most = rig, most
        self._rows: list[Piece] = []
        self._minutes: list[Piece] = []
        self._last: Piece | None = None
        self._instants = 0
        self._newest: dict[str, tuple[int, str, float]] = {}
        self._spans: dict[int, tuple[int, int]] = {}
        self.window_s = 0.0
        """The longest window that a row rests on."""

    def take(self, piece: Piece) -> None:
        """Take the rows of whole days, all of them."""
        if not len(piece):
            return
        piece = _ordered(piece)
        self._instants += len(np.unique(np.stack([piece.run_id, piece.t_ns]), axis=1).T)
        self.window_s = max(self.window_s, float(np.nanmax(np.append(piece.window_s, 0.0))))
        self._note(piece)
        self._rows = [] if self._instants > self._most else [*self._rows, piece]
        self._minutes.append(_minutes(piece, self._last))
        self._last = _newest(piece)

    def _note(self, piece: Piece) -> None:
        """Keep what the newest row of each parameter counts from, and from when to when each run goes."""
        for name in set(piece.parameter.tolist()):
            own = piece.at(piece.parameter == name)
            last = int(np.argmax(own.seq))
            newest = int(own.seq[last]), str(own.unit[last]), float(own.reference[last])
            self._newest[name] = max(self._newest.get(name, newest), newest, key=lambda found: found[0])
        for run in np.unique(piece.run_id).tolist():
            times = piece.t_ns[piece.run_id == run]
            first, last_ns = self._spans.get(run, (int(times.min()), int(times.max())))
            self._spans[run] = min(first, int(times.min())), max(last_ns, int(times.max()))

    def points(self) -> list[Points]:
        """Return the points of every parameter, in the order of their names."""
        if not self._minutes:
            return []
        found, span = self._tier()
        found = found.at(self._shown(found))
        found = found.at(np.argsort(found.t_ns, kind="stable"))
        return [self._points(found.at(found.parameter == name), name, span) for name in sorted(self._newest)]

    def _points(self, own: Piece, name: str, span: int) -> Points:
        _, unit, reference = self._newest[name]
        steady = tuple(dict.fromkeys(own.reference[np.isfinite(own.reference)].tolist()))
        return Points(
            self.rig, name, unit, own.t_ns + span * SECOND_NS // 2, own.value, own.sd, own.sd_repeat,
            np.full(len(own), span), None, None, None if np.isnan(reference) else reference, 0, steady,
        )  # fmt: skip

    def _tier(self) -> tuple[Piece, int]:
        """Return the valid rows, minutes or hours, whichever are few enough, and what each covers, s."""
        if self._rows:
            rows = joined(self._rows)
            return rows.at(_valid(rows)), 0
        minutes = joined(self._minutes)
        if len(np.unique(minutes.t_ns)) <= self._most:
            return minutes, MINUTE_S
        hours = _aggregated(_ordered(minutes), HOUR_S, MINUTE_S, int(minutes.t_ns.min()))
        each = -(-len(np.unique(hours.t_ns)) // self._most)
        return hours.at(hours.t_ns // (HOUR_S * SECOND_NS) % each == 0), HOUR_S

    def _shown(self, found: Piece) -> BoolArray:
        """Tell which rows no newer run covers, as a database shows the newest run of an instant."""
        shown = np.ones(len(found), dtype=np.bool_)
        for run, (first, last) in self._spans.items():
            shown &= (found.run_id >= run) | (found.t_ns < first) | (found.t_ns > last)
        return shown


def _ordered(rows: Piece) -> Piece:
    """Return rows in the order of runs, parameters, references, time."""
    return rows.at(np.lexsort((rows.t_ns, rows.reference, rows.parameter.astype(str), rows.run_id)))


def _valid(rows: Piece) -> BoolArray:
    found: BoolArray = (rows.status == "valid") & np.isfinite(rows.value)
    return found


def _newest(rows: Piece) -> Piece:
    """Return the newest row of each run, parameter and reference; rows are in their order."""
    series = _numbered(rows)
    return rows.at(np.append(series[1:] != series[:-1], True))


def _minutes(piece: Piece, before: Piece | None) -> Piece:
    """Return a day's rows as minutes; before: the newest of the day before, which windows reach back to."""
    rows = piece if before is None else _ordered(joined([before, piece]))
    return _aggregated(rows, MINUTE_S, 0, int(piece.t_ns.min()))


def _aggregated(rows: Piece, span: int, source: int, first_ns: int) -> Piece:
    """Return periods, those with a valid row, of rows from first_ns on, sorted by series and time."""
    series = _numbered(rows)
    valid = _valid(rows)
    none = np.zeros(len(rows), dtype=np.int64)
    verdict = np.where(valid, _VALID, 0)
    window = np.nan_to_num(rows.window_s)
    repeat = np.where(np.isnan(rows.sd_repeat), rows.sd, rows.sd_repeat)
    groups = grouped(
        [rows.t_ns, series, verdict, rows.value, rows.sd, window, none, none, repeat, none + 1, valid,
         rows.value, rows.value, verdict], span, source, first_ns,
    )  # fmt: skip
    assert groups is not None  # noqa: S101 - at least one row is not before the first
    return _periods(rows, groups, series)


def _numbered(rows: Piece) -> IntArray:
    """Number series: a run's rows of one parameter with one reference; rows are in that order."""
    fresh = np.ones(len(rows), dtype=np.bool_)
    same = np.nan_to_num(rows.reference)
    fresh[1:] = (
        (rows.run_id[1:] != rows.run_id[:-1])
        | (rows.parameter[1:] != rows.parameter[:-1])
        | (same[1:] != same[:-1])
    )
    found: IntArray = np.cumsum(fresh)
    return found


def _periods(rows: Piece, groups: Groups, series: IntArray) -> Piece:
    """Return aggregates as rows; what is the same all over a series is its first row's."""
    whole = groups.n_valid > 0
    first = np.searchsorted(series, groups.series[whole])
    sd = groups.sd[whole]
    share = repeat_cells(sd, groups.sd_repeat[whole])
    repeat = np.where(np.isnan(share), sd, 1e-4 * sd * share)
    like = rows.at(first)
    return Piece(
        like.seq, like.run_id, groups.period_ns[whole], like.parameter, like.unit,
        np.full(len(sd), "valid", object),
        groups.value[whole], like.reference, sd, repeat, groups.window_s[whole],
    )  # fmt: skip
