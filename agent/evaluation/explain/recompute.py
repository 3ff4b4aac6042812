"""The rounds of a record computed again by the pipeline as it was before them."""

import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from agent.config import RigConfig
from agent.recording.event_files import Labels, Taken, state_name
from agent.recording.states import Rounds, StateError, thawed
from agent.records import Record
from agent.runtime.pipeline import Pipeline
from agent.types import AlarmTransition, EstimateBatch, FloatArray, IntArray, Verdict
from drivers.port import SampleBlock


@dataclass(frozen=True, slots=True)
class Kept:
    """A record's samples: numbers and time stamps (n,), readings (n, c) by channel, the state before them.

    Of several sources there are none beside the state.
    """

    number: IntArray
    t_ns: IntArray
    values: FloatArray
    channels: tuple[str, ...]
    state: bytes


@dataclass(frozen=True, slots=True)
class Recomputed:
    """What the samples lead to: the configuration that was used, and records by kind in the order of time."""

    config: RigConfig
    steps: list[AlarmTransition]
    batches: list[EstimateBatch]
    verdicts: list[Verdict]


def read_kept(path: Path) -> Kept:
    """Return what a record's file holds. Raises StateError where it is not there or holds no state."""
    if "*" in path.name:
        path = path.with_name(state_name(path.name))
    try:
        with path.open("rb") as octets, np.load(octets, allow_pickle=False) as file:
            own = {name: f"deltak.{name}" if f"deltak.{name}" in file.files else name for name in OWN}
            if own["state"] not in file.files:
                raise StateError("it holds no state of the estimation from before its samples")
            names = tuple(name for name in file.files if name != "t" and name not in own.values())
            state = file[own["state"]].tobytes()
            if "t" not in file.files:  # of several sources: the samples are in the state
                return Kept(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 0)), (), state)
            values = np.stack([file[name] for name in names], axis=1)
            return Kept(file[own["index"]], file["t"].astype(np.int64), values, names, state)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise StateError(f"it cannot be read: {error}") from error


OWN = ("index", "counter", "meta", "state")


def recomputed(kept: Kept) -> Recomputed:
    """Compute a record again. Raises StateError where this program cannot."""
    rounds = thawed(kept.state)
    pipeline = rounds.pipeline
    if not isinstance(pipeline, Pipeline):
        raise StateError("its state is of no pipeline")
    try:
        records = list(_records(pipeline, rounds, kept))
    except Exception as error:  # a state of another program may lack whatever this one's classes have
        raise StateError(f"{type(error).__name__}: {error}") from error
    return Recomputed(
        pipeline.config,
        [record for record in records if isinstance(record, AlarmTransition)],
        [record for record in records if isinstance(record, EstimateBatch)],
        [record for record in records if isinstance(record, Verdict)],
    )


def _records(pipeline: Pipeline, rounds: Rounds, kept: Kept) -> Iterator[Record]:
    """Yield what the rounds lead to: what was computed at once is computed at once again."""
    stamps = _Stamps(rounds.labels)
    for _, items in groupby(rounds.items, key=lambda item: item.round):
        for item in items:
            pipeline.take(item.source, _filled(item, kept), rounds.moduli.get(item.source), stamps.of)
        yield from pipeline.compute()


class _Stamps:
    """The time stamps that samples had in the live run."""

    def __init__(self, labels: Sequence[Labels]) -> None:
        parts = labels
        self._number = np.concatenate([np.zeros(0, np.int64), *(part.number for part in parts)])
        self._t_ns = np.concatenate([np.zeros(0, np.int64), *(part.t_ns for part in parts)])

    def of(self, index: IntArray) -> IntArray:
        """Return the stamps (n,) of sample numbers (n,)."""
        found: IntArray = self._t_ns[np.searchsorted(self._number, index)]
        return found


def _filled(item: Taken, kept: Kept) -> SampleBlock:
    """Return a block with the readings that the record has of it."""
    if not len(kept.number):
        return item.block
    values = item.block.values.copy()
    rows = np.flatnonzero(item.kept)
    rows = rows[np.isin(item.number[rows], kept.number)]
    values[rows] = kept.values[np.searchsorted(kept.number, item.number[rows])]
    return replace(item.block, values=values)
