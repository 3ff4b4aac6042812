"""Matrices that a configuration names by file: { file = "plant.mat", name = "A" }."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from sim_bus.errors import SimUsageError

_KEYS = ("A", "B", "C", "D", "dA", "dB", "dC", "dD")


def with_numbers(content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a configuration with the numbers in place of files; SimUsageError where one cannot be read."""
    model = content.get("model")
    if not isinstance(model, dict):
        return dict(content)
    read = _filled(model, folder, "model")
    rows = model.get("parameter")
    if isinstance(rows, list):
        places = enumerate(rows)
        read["parameter"] = [
            _filled(row, folder, f"model.parameter[{i}]") for i, row in places if isinstance(row, dict)
        ]
    return {**content, "model": read}


def _filled(table: Mapping[str, Any], folder: Path, path: str) -> dict[str, Any]:
    named = {key: table[key] for key in _KEYS if isinstance(table.get(key), dict)}
    return {**table, **{key: _matrix(where, key, folder, f"{path}.{key}") for key, where in named.items()}}


def _matrix(where: Mapping[str, Any], key: str, folder: Path, path: str) -> list[list[float]]:
    file = folder / str(where.get("file", ""))
    name = str(where.get("name", key))
    try:
        arrays = _arrays(file)
        alone = len(arrays) == 1 and "name" not in where
        found = np.asarray(next(iter(arrays.values())) if alone else arrays[name], dtype=float)
    except (OSError, ValueError, KeyError, NotImplementedError) as error:
        raise SimUsageError(f"{path}: {file}: matrix {name} cannot be read: {error}") from error
    rows: list[list[float]] = found.tolist()
    return rows


def _arrays(file: Path) -> dict[str, Any]:
    if file.suffix == ".npz":
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    if file.suffix == ".mat":
        return {name: matrix for name, matrix in loadmat(file).items() if not name.startswith("__")}
    return {file.stem: np.loadtxt(file, delimiter=",", ndmin=2)}
