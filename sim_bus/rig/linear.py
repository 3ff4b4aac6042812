"""True motion of a linear system x' = F x + G u, y = C x + D u, any entry of which may change at any sample.

In discrete time F x + G u is the next state. What drives it are the channels of quantity "input", in the
file's order.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.io import loadmat

from sim_bus.arrays import FloatArray
from sim_bus.errors import SimUsageError
from sim_bus.rig.domains.built import Between, LinearMotion
from sim_bus.rig.plant import PlantError

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


MATRICES = "ABCD"
Matrix = tuple[tuple[float, ...], ...]
Values = Mapping[str, float]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class Parameter(_Part):
    """A parameter and what one unit of it adds to each matrix."""

    name: str
    nominal: float
    dA: Matrix = ()  # noqa: N815 - the key of the configuration file
    dB: Matrix = ()  # noqa: N815 - the key of the configuration file
    dC: Matrix = ()  # noqa: N815 - the key of the configuration file
    dD: Matrix = ()  # noqa: N815 - the key of the configuration file


class State(_Part):
    """The name of a state."""

    name: str


class Linear(_Part):
    """The [model] of a linear rig; files that hold matrices have been read."""

    kind: Literal["linear"]
    time: Literal["continuous", "discrete"] = "continuous"
    A: Matrix = Field(min_length=1)
    B: Matrix = ()
    C: Matrix = Field(min_length=1)
    D: Matrix = ()
    state: tuple[State, ...] = ()
    parameter: tuple[Parameter, ...] = ()
    uncertain: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _rows_are_even(self) -> Self:
        parts = {name: getattr(self, name) for name in MATRICES}
        parts |= {f"{p.name}: d{name}": getattr(p, f"d{name}") for p in self.parameter for name in MATRICES}
        uneven = [name for name, rows in parts.items() if len({len(row) for row in rows}) > 1]
        if uneven:
            raise ValueError(f"rows of different length: {', '.join(uneven)}")
        return self


@dataclass(frozen=True)
class LinearSystem(Between):
    """A linear rig; table: its matrices."""

    table: Linear

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states; "state 1" and so on where they have none."""
        given = tuple(state.name for state in self.table.state)
        return given or tuple(f"state {i + 1}" for i in range(len(self.table.A)))

    @property
    def shapes(self) -> dict[str, tuple[int, int]]:
        """Rows and columns of each matrix."""
        n, m, p = len(self.table.A), len(self.inputs), len(self.outputs)
        return {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}

    @cached_property
    def nominal(self) -> dict[str, float]:
        """Every parameter by name, and every entry of every matrix: any of them may change."""
        entries = {
            f"{name}[{i},{j}]": float(self._matrix(name, getattr(self.table, name))[i, j])
            for name, shape in self.shapes.items()
            for i, j in np.ndindex(shape)
        }
        return {parameter.name: parameter.nominal for parameter in self.table.parameter} | entries

    def _matrix(self, name: str, rows: Matrix) -> FloatArray:
        shape = self.shapes[name[-1]]
        found = np.array(rows, dtype=float) if rows else np.zeros(shape)
        if found.shape != shape:
            raise PlantError(
                f"{name} has {found.shape[0]} rows of {found.size // len(found)}; {shape} fit the channels"
            )
        return found

    def matrices(self, values: Values) -> dict[str, FloatArray]:
        """Return A, B, C, D with the parameters and entries put in."""
        found = {name: self._matrix(name, getattr(self.table, name)).copy() for name in MATRICES}
        for name, matrix in found.items():
            for i, j in np.ndindex(matrix.shape):
                matrix[i, j] = values.get(f"{name}[{i},{j}]", matrix[i, j])
        for parameter in self.table.parameter:
            change = values[parameter.name] - parameter.nominal
            for name in MATRICES:
                found[name] += change * self._matrix(f"d{name}", getattr(parameter, f"d{name}"))
        return found

    def equations(self, values: Values) -> LinearMotion:
        """Return the motion for one set of parameters and entries."""
        found = self.matrices(values)
        sampled = self.table.time == "discrete"
        return LinearMotion(self, found["A"], found["B"], found["C"], found["D"], is_sampled=sampled)
