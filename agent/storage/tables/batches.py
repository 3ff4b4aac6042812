"""Taking, joining and grouping estimate batches as whole arrays; no row is touched one by one."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.types import EstimateBatch

_PER_HOP = (
    "index", "t_ns", "value", "sd", "lower", "upper", "sd_repeat", "status", "reason", "held", "held_age_s", "window_s",
    "n_used", "n_missing", "dof",
)  # fmt: skip


def take(batch: EstimateBatch, rows: NDArray[Any]) -> EstimateBatch:
    """Return the rows that a mask or an index array names."""
    parts: dict[str, Any] = {name: getattr(batch, name)[rows] for name in _PER_HOP}
    return replace(batch, **parts, others=tuple(take(other, rows) for other in batch.others))


def join(batches: Sequence[EstimateBatch]) -> EstimateBatch:
    """Return one batch of all rows; the batches must share their header (see `header_of`)."""
    if len(batches) == 1:
        return batches[0]
    parts: dict[str, Any] = {name: np.concatenate([getattr(b, name) for b in batches]) for name in _PER_HOP}
    others = tuple(join(same) for same in zip(*(b.others for b in batches), strict=True))
    return replace(batches[0], **parts, others=others)


def header_of(batch: EstimateBatch) -> tuple[object, ...]:
    """Return what is the same for every row of a batch, as something that can be compared."""
    plain = tuple(getattr(batch, f.name) for f in fields(batch) if f.name not in (*_PER_HOP, "reference", "others"))
    return (*plain, len(batch.others), np.asarray(batch.reference, dtype=np.float64).tobytes())


def joined_runs(batches: Sequence[EstimateBatch]) -> Iterator[EstimateBatch]:
    """Yield the batches with consecutive ones of one header joined; their order stays."""
    group: list[EstimateBatch] = []
    for batch in batches:
        if group and header_of(group[0]) != header_of(batch):
            yield join(group)
            group = []
        group.append(batch)
    if group:
        yield join(group)
