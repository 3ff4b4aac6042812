# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Rows on their way into the file: growing numbers, names by number, and the plan of one transaction."""

import math
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.storage.database.checksum import Cell, with_crc
from agent.storage.database.columns import TABLES
from agent.storage.tuning import MOST_FITS
from agent.types import Reason, Status

Row = tuple[Any, ...]

VERDICTS = {
    (int(status) << 8) | int(reason): (
        status.name.lower(),
        None if reason is Reason.NONE else reason.name.lower().replace("_", " "),
    )
    for status in Status
    for reason in Reason
}
"""verdicts.seq -> the texts of status and reason."""


@dataclass(slots=True)
class Plan:
    """The rows of one transaction by table; applying a plan twice leaves what applying it once leaves.

    Attributes:
        rows: by table.
        estimates: those of chosen windows as `estimates.ROW` has them, with the run that they are of.
    """

    rows: dict[str, list[Row]] = field(default_factory=dict)
    estimates: list[tuple[int, NDArray[np.void]]] = field(default_factory=list)

    def add(self, table: str, *rows: Row) -> None:
        self.rows.setdefault(table, []).extend(rows)

    def sealed(self, table: str, *cells: Cell) -> None:
        """Add one row of mixed types with its checksum."""
        self.add(table, with_crc(cells))


class Numbers:
    """The next seq of every table; never goes back, whatever a purge or a failed commit did."""

    def __init__(self) -> None:
        self._next: dict[str, int] = {}

    def load(self, connection: sqlite3.Connection) -> None:
        """Go on from the file; numbers already given out in this process stay given out."""
        high = dict(connection.execute("SELECT name, high FROM sequences"))
        for table in TABLES:
            newest = connection.execute(f"SELECT max(seq) FROM {table}").fetchone()[0] or 0
            self._next[table] = max(self._next.get(table, 1), newest + 1, high.get(table, 0) + 1)

    def take(self, table: str, count: int = 1) -> int:
        """Return the first of `count` new numbers."""
        first = self._next[table]
        self._next[table] = first + count
        return first

    def leap(self, highs: Mapping[str, int]) -> None:
        """Give out no number up to these again, by table, though no row has them any more."""
        for table, high in highs.items():
            self._next[table] = max(self._next[table], high + 1)

    def high(self, table: str) -> int:
        """Return the highest number given out so far."""
        return self._next[table] - 1


SeriesKey = tuple[int, str, str, str, float | None, int | None]
FitKey = tuple[float | None, int, int, float | None, bool, int]


class Names:
    """What rows name by number: rigs, series, fits, verdicts. New ones wait here until committed."""

    def __init__(self, numbers: Numbers) -> None:
        self._numbers = numbers
        self._rigs: dict[str, int] = {}
        self._series: dict[SeriesKey, int] = {}
        self._fits: dict[FitKey, int] = {}
        self._verdicts: set[int] = set()
        self.fresh = Plan()

    def load(self, connection: sqlite3.Connection) -> None:
        """Learn what the file already names; what was not committed yet stays waiting."""
        self._rigs.update({name: seq for seq, name in connection.execute("SELECT seq, name FROM rigs")})
        self._verdicts.update(seq for (seq,) in connection.execute("SELECT seq FROM verdicts"))
        columns = "seq, window_s, n_used, n_missing, dof, t95 IS NOT NULL, chosen"
        newest = connection.execute(
            f"SELECT {columns} FROM fits ORDER BY seq DESC LIMIT ?", (MOST_FITS,)
        ).fetchall()
        for seq, window, used, missing, dof, symmetric, chosen in reversed(newest):
            self._remember((window, used, missing, dof, bool(symmetric), chosen), seq)

    def saved(self) -> None:
        """Note that a commit took the waiting rows along."""
        self.fresh = Plan()

    def rig(self, name: str) -> int:
        seq = self._rigs.get(name)
        if seq is None:
            seq = self._rigs[name] = self._numbers.take("rigs")
            self.fresh.sealed("rigs", seq, name)
        return seq

    def series(self, key: SeriesKey) -> int:
        """Return the number of (run, parameter, unit, method, reference, baseline)."""
        seq = self._series.get(key)
        if seq is None:
            seq = self._series[key] = self._numbers.take("series")
            self.fresh.sealed("series", seq, *key)
        return seq

    def fit(self, key: FitKey) -> int:
        """Return the number of (window, used, missing, degrees of freedom, symmetric, chosen).

        symmetric: lower and upper are value -+ t95 sd, so the row itself need not carry them.
        """
        seq = self._fits.pop(key, None)
        if seq is None:
            window, used, missing, dof, symmetric, chosen = key
            seq = self._numbers.take("fits")
            self.fresh.sealed(
                "fits", seq, window, used, missing, dof, student_95(dof) if symmetric else None, chosen
            )
        self._remember(key, seq)
        return seq

    def _remember(self, key: FitKey, seq: int) -> None:
        """Keep the number of a fit as that of the one used last; the one used longest ago makes room."""
        self._fits[key] = seq
        if len(self._fits) > MOST_FITS:
            del self._fits[next(iter(self._fits))]

    def verdicts(self, codes: set[int]) -> None:
        """See that the file has the texts of these verdicts."""
        for code in sorted(codes - self._verdicts):
            self._verdicts.add(code)
            self.fresh.sealed("verdicts", code, *VERDICTS[code])


def finite(figure: float | None) -> float | None:
    """Return a figure as a cell: None, which is NULL, where it is no number."""
    return None if figure is None or not math.isfinite(figure) else float(figure)


def student_95(dof: float | None) -> float | None:
    """Return the half-width of the 95 % interval in standard deviations; None without degrees of freedom."""
    if dof is None or not dof > 0:
        return None
    from scipy.special import stdtrit

    return float(stdtrit(dof, 0.975))
