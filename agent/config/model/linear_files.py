"""Matrices of a linear model in files: { file = "plant.mat", name = "A" } becomes lists of numbers."""

import hashlib
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from agent.config.model.linear import MATRICES
from agent.config.reading.fields import shown
from agent.config.reading.messages import join, listing, nearest
from agent.config.reading.parse import Faults
from agent.config.tuning import MATRIX_BYTES

KEYS: Final = ("file", "name")
DERIVATIVES: Final = tuple(f"d{matrix}" for matrix in MATRICES)


class _UnreadableError(ValueError):
    """A file that holds no such matrix; what is wrong, and after a semicolon what to do."""


def with_matrices(raw: Mapping[str, Any], folder: Path, faults: Faults) -> tuple[dict[str, Any], list[str]]:
    """Return a raw [model] with numbers in the place of files, and the SHA-256 of each file that was read.

    A matrix that cannot be read is empty in what is returned, and noted with its key path.
    """
    reader = _Reader(folder, faults)
    read = reader.table(raw, "model", MATRICES)
    rows = read.get("parameter")
    if isinstance(rows, list):
        paths = [join("model.parameter", i) for i in range(len(rows))]
        read["parameter"] = [
            reader.table(row, path, DERIVATIVES) if isinstance(row, dict) else row
            for row, path in zip(rows, paths, strict=True)
        ]
    return read, reader.digests


class _Reader:
    """Reads the files that one configuration names."""

    def __init__(self, folder: Path, faults: Faults) -> None:
        self._folder = folder
        self._faults = faults
        self.digests: list[str] = []

    def table(self, raw: Mapping[str, Any], path: str, keys: tuple[str, ...]) -> dict[str, Any]:
        """Return a table with those of its keys read that name a file; empty where it cannot be read."""
        wanted = {key: raw[key] for key in keys if isinstance(raw.get(key), dict)}
        read = {key: self._matrix(table, f"{path}.{key}", key) for key, table in wanted.items()}
        return {**raw, **read}

    def _matrix(self, table: Mapping[str, Any], path: str, key: str) -> list[list[float]]:
        strange = [name for name in table if name not in KEYS]
        for unknown in strange:
            what = f'the nearest known key is "{nearest(unknown, KEYS)}" of {listing(KEYS)}'
            self._faults.add(join(path, unknown), "unknown key", what)
        texts = [table.get("file"), table.get("name", key)]
        if strange:
            return []
        if not all(isinstance(text, str) and text for text in texts):
            self._faults.add(path, "must name a file", f'write {{ file = "plant.mat", name = "{key}" }}')
            return []
        file = self._folder / str(texts[0])
        try:
            return self._read(file, str(texts[1]), stated="name" in table)
        except _UnreadableError as error:
            what, _, advice = str(error).partition("; ")
            self._faults.add(f"{path}.file", f"{file}: {what}", advice)
            return []

    def _read(self, file: Path, name: str, *, stated: bool) -> list[list[float]]:
        read = _READERS.get(file.suffix.lower())
        if read is None:
            raise _UnreadableError(
                f"{shown(file.suffix)} is no kind of file that is read; {listing(_READERS)} are"
            )
        if file.exists() and not file.is_file():
            raise _UnreadableError("is no file, its end may never come; name a file there is")
        try:
            data = file.read_bytes() if file.stat().st_size <= MATRIX_BYTES else None
        except OSError as error:
            raise _UnreadableError(
                f"cannot be read: {error.strerror or error}; name a file there is"
            ) from error
        if data is None:
            raise _UnreadableError(
                f"is larger than {MATRIX_BYTES // 1_000_000} MB; a plant's matrices are small"
            )
        matrix = _chosen(read(file), name, stated=stated)
        self.digests.append(hashlib.sha256(data).hexdigest())
        return matrix


def _chosen(matrices: Mapping[str, Any], name: str, *, stated: bool) -> list[list[float]]:
    """Return the matrix of that name; the only one there is where no name was stated."""
    if name not in matrices and not stated and len(matrices) == 1:
        name = next(iter(matrices))
    if name not in matrices:
        raise _UnreadableError(f"has no matrix {shown(name)}; it has {listing(matrices)}")
    return _rows(matrices[name], name)


def _rows(matrix: Any, name: str) -> list[list[float]]:
    import numpy as np

    found = np.asarray(matrix.toarray() if hasattr(matrix, "toarray") else matrix)
    if found.ndim != 2:
        raise _UnreadableError(f"{shown(name)} has {found.ndim} dimensions; a matrix has rows and columns")
    if found.dtype.kind not in "iufb":
        raise _UnreadableError(f"{shown(name)} does not hold real numbers; save it as a real matrix")
    rows: list[list[float]] = found.astype(float).tolist()
    return rows


def _npz(file: Path) -> Mapping[str, Any]:
    import numpy as np

    if _unpacked_bytes(file) > MATRIX_BYTES:
        raise _UnreadableError(
            f"unpacks to more than {MATRIX_BYTES // 1_000_000} MB; a plant's matrices are small"
        )
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return {str(name): arrays[name] for name in arrays.files}
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise _UnreadableError("is no NPZ file of matrices; write it with numpy.savez") from error


def _unpacked_bytes(file: Path) -> int:
    """Return what an archive says that it unpacks to; 0 for none."""
    try:
        with zipfile.ZipFile(file) as packed:
            return sum(member.file_size for member in packed.infolist())
    except (OSError, zipfile.BadZipFile):
        return 0


def _mat(file: Path) -> Mapping[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(file)
    except (NotImplementedError, MatReadError, ValueError, TypeError, OSError, EOFError) as error:
        raise _UnreadableError("is no MAT file that can be read; save it with -v7, not -v7.3") from error
    return {name: matrix for name, matrix in found.items() if not name.startswith("__")}


def _csv(file: Path) -> Mapping[str, Any]:
    import numpy as np

    try:
        return {file.stem: np.loadtxt(file, delimiter=",", ndmin=2)}
    except (ValueError, OSError) as error:
        raise _UnreadableError("is not numbers with commas between; a row a line, no header") from error


_READERS: Final[Mapping[str, Callable[[Path], Mapping[str, Any]]]] = {
    ".mat": _mat,
    ".npz": _npz,
    ".csv": _csv,
}
