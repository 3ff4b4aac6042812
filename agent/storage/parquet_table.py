"""Rows as a Parquet file, however many there are."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import pyarrow as arrow  # noqa: ICN001 - a word
from pyarrow import ipc, parquet

from agent.storage.tuning import ROWS_READ


def write(columns: Sequence[str], rows: Iterable[Sequence[Any]], target: Path) -> int:
    """Write rows of some columns; return how many there were.

    What a column is made of is known after its last row only, since it may be NULL until then: batches go to
    a file of their own first.
    """
    schemas = []
    count = 0
    with TemporaryFile(dir=target.parent) as kept:
        for batch in _batches(columns, rows):
            schemas.append(batch.schema)
            count += batch.num_rows
            with ipc.new_stream(kept, batch.schema) as stream:
                stream.write_batch(batch)
        kept.seek(0)
        schema = arrow.unify_schemas(schemas, promote_options="permissive")
        with parquet.ParquetWriter(target, schema) as file:
            for _ in schemas:
                file.write_table(_read(kept).cast(schema))
    return count


def _batches(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> "Iterator[arrow.RecordBatch]":
    """Give rows in batches; one without rows where there are none, for the names of the columns."""
    left = iter(rows)
    cells = list(zip(*islice(left, ROWS_READ), strict=True)) or [()] * len(columns)
    while cells:
        yield arrow.record_batch([arrow.array(column) for column in cells], names=list(columns))
        cells = list(zip(*islice(left, ROWS_READ), strict=True))


def _read(kept: IO[bytes]) -> "arrow.Table":
    with ipc.open_stream(kept) as stream:
        return stream.read_all()
