"""Joining and grouping estimate batches as whole arrays; no row is touched one by one."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from agent.types import PER_HOP, EstimateBatch


def join(batches: Sequence[EstimateBatch]) -> EstimateBatch:
    """Return one batch of all rows; the batches must share their header (see `header_of`)."""
    if len(batches) == 1:
        return batches[0]
    parts: dict[str, Any] = {name: np.concatenate([getattr(b, name) for b in batches]) for name in PER_HOP}
    others = tuple(join(same) for same in zip(*(b.others for b in batches), strict=True))
    return replace(batches[0], **parts, others=others)


def header_of(batch: EstimateBatch) -> tuple[object, ...]:
    """Return what is the same for every row of a batch, as something that can be compared."""
    plain = tuple(
        getattr(batch, f.name) for f in fields(batch) if f.name not in (*PER_HOP, "reference", "others")
    )
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
