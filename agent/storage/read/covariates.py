"""Read-only questions about covariates: the means of each, on the grid of minutes."""

from pathlib import Path

import numpy as np

from agent.records import CovariateMean
from agent.storage.read.selection import reading
from agent.storage.tables.covariates import means_of, newest_means
from agent.types import FloatArray, IntArray
from agent.units import DAY_NS, MINUTE_NS

_EARLIEST, _LATEST = -(2**62), 2**62  # fixed by 64 bits: before and after all


class Means:
    """The means of one covariate by time: number (n,) of each minute since the epoch, value (n,), unit."""

    def __init__(self, unit: str, table: dict[int, float]) -> None:
        self.unit = unit
        self.number: IntArray = np.array(sorted(table), dtype=np.int64)
        self.value: FloatArray = np.array([table[number] for number in self.number.tolist()])


def newest(db: Path | str, rig: str) -> list[CovariateMean]:
    """Return the newest mean of each covariate that was read in the newest day of any. Raises StoreError."""
    with reading(db) as connection:
        found = sorted(newest_means(connection, rig, DAY_NS), key=lambda mean: mean.t_ns)
    return list({mean.name: mean for mean in found}.values())


def means(db: Path | str, rig: str, first_ns: int = _EARLIEST, last_ns: int = _LATEST) -> dict[str, Means]:
    """Return the covariates of a rig by name; of a minute that several runs saw, what the newest says.

    An hour that is kept as one mean counts for each of its minutes. Raises StoreError.
    """
    tables: dict[str, tuple[str, dict[int, float]]] = {}
    with reading(db) as connection:
        for mean in means_of(connection, rig, first_ns, last_ns):
            unit, table = tables.get(mean.name, ("", {}))
            if unit != mean.unit:  # what was in another unit is of another sensor
                table = {}
                tables[mean.name] = (mean.unit, table)
            first = mean.t_ns // MINUTE_NS
            table.update(dict.fromkeys(range(first, first + mean.span_s // 60), mean.value))
    return {name: Means(unit, table) for name, (unit, table) in tables.items()}
