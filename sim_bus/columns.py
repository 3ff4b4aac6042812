"""Columns of numbers from files of others."""

from pathlib import Path

import numpy as np

from sim_bus.arrays import FloatArray
from sim_bus.errors import SimUsageError


def read_column(path: Path, column: str) -> FloatArray:
    """Return a column of an NPZ file or of a CSV file with a header.

    Raises SimUsageError where it cannot be read, has no rows, or has gaps.
    """
    rows = _read(path, column)
    if not len(rows) or not np.isfinite(rows).all():
        raise SimUsageError(f'{path}: column "{column}" has no numbers, or gaps')
    return rows


def _read(path: Path, column: str) -> FloatArray:
    try:
        if path.suffix == ".npz":
            with np.load(path) as arrays:
                return np.asarray(arrays[column], dtype=np.float64)
        with path.open(encoding="utf-8") as lines:
            place = [name.strip() for name in lines.readline().split(",")].index(column)
            return np.loadtxt(lines, delimiter=",", usecols=place, ndmin=1)
    except (OSError, KeyError, ValueError) as error:
        words = error.strerror if isinstance(error, OSError) else error
        raise SimUsageError(f'{path}: column "{column}" cannot be read: {words}') from error
