"""Data manipulation: what of the readings can be believed.

Short gaps and missing readings are filled and marked, spikes are refused and treated alike; channels that are
stuck, clipped or silent are named, and while one is nothing is estimated. Everything is decided by sample
numbers and values, never by how the stream was cut.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from agent.blocks.sensor_labels import Labelled, Piece, SensorLabels
from agent.numerics.preprocessing.cleaning import Clean, Cleaner
from agent.numerics.preprocessing.rows import rows_with
from agent.numerics.preprocessing.sensor_watch import SensorWatch
from agent.numerics.preprocessing.wire import Wire
from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class QualitySettings:
    """Settings of `Quality`.

    Attributes:
        channels: (c,) names, inputs first.
        inputs: how many of them are inputs.
        step: (c,) the wire's smallest step of each, SI; 0 where it has none.
        window: samples of the estimator's window.
        bridge: samples of the longest gap that is bridged.
        quantities: (c,) what each shows; none for what is not known to be alike.
        commanded: whether inputs are what was commanded, and no readings of it.
        wire: what channels come in, SI if not said.
    """

    channels: tuple[str, ...]
    inputs: int
    step: FloatArray
    window: int
    bridge: int
    quantities: tuple[str, ...] = ()
    commanded: bool = False
    wire: Wire | None = None


class Quality:
    """The quality of one rig's samples.

    rejected counts the instants refused here, by reason; those that arrived incomplete are not among them.
    """

    def __init__(self, settings: QualitySettings) -> None:
        is_input = np.arange(len(settings.channels)) < settings.inputs
        self.settings = settings
        self.rejected: Counter[str] = Counter()
        self._cleaner = Cleaner(is_input, settings.step)
        kinds = np.unique(settings.quantities, return_inverse=True)[1] if settings.quantities else None
        commanded = is_input & settings.commanded
        self._watch = SensorWatch(is_input, settings.step, settings.window, kinds, commanded, settings.wire)
        self._labels = SensorLabels(settings.channels, settings.inputs, settings.window)
        self._open = False
        self._newest, self._newest_ns = -1, 0
        self._silent = np.zeros(len(settings.channels), dtype=np.int64)
        self._index: IntArray = np.zeros(0, dtype=np.int64)  # of samples that the cleaner holds
        self._t_ns: IntArray = np.zeros(0, dtype=np.int64)
        self._watched = 0

    def step(self, index: IntArray, t_ns: IntArray, v: FloatArray, *, anew: bool = False) -> Labelled:
        """Take samples v (N, c), NaN for a missing reading, with increasing numbers; return what is settled.

        anew: they follow on nothing that came before, however short the gap.
        """
        return Labelled.joined(self._parts(index, t_ns, v, anew=anew))

    def _parts(self, index: IntArray, t_ns: IntArray, v: FloatArray, *, anew: bool) -> Iterator[Labelled]:
        if anew:
            yield self._end()
        edges = [0, *(np.flatnonzero(np.diff(index) > 1) + 1).tolist(), len(index)]
        for start, stop in pairwise(edges):
            if stop > start:
                yield from self._follow(index[start:stop], t_ns[start:stop], v[start:stop])

    def unpaired(self, index: IntArray, t_ns: IntArray, v: FloatArray) -> Labelled:
        """Take samples v (N, c) of sources that may not go together; return them, good for nothing."""
        return Labelled.joined([self._end(), self._labels.unpaired(index, t_ns, v)])

    def finish(self) -> Labelled:
        """Return what waits for samples that will not come."""
        return self._end()

    @property
    def waiting(self) -> int:
        """How many complete samples wait for what comes after them."""
        return self._cleaner.waiting()

    def _follow(self, index: IntArray, t_ns: IntArray, v: FloatArray) -> Iterator[Labelled]:
        """Take consecutive samples: after a short gap with it filled, after a longer one as a new stretch."""
        gap = int(index[0]) - self._newest - 1
        if self._open and gap > self.settings.bridge:
            yield self._end()
        elif self._open and gap > 0:
            lost = np.arange(1, gap + 1, dtype=np.int64)
            times = self._newest_ns + (int(t_ns[0]) - self._newest_ns) * lost // (gap + 1)
            index, t_ns = np.concatenate([self._newest + lost, index]), np.concatenate([times, t_ns])
            v = np.vstack([np.full((gap, v.shape[1]), np.nan), v])
        self._newest, self._newest_ns = int(index[-1]), int(t_ns[-1])
        for part, speaking in self._stretches(v):
            if speaking:
                self._open = True
                yield self._clean(index[part], t_ns[part], v[part])
            else:
                yield self._end()
                yield self._labels.silence(index[part], t_ns[part], v[part])

    def _stretches(self, v: FloatArray) -> Iterator[tuple[slice, bool]]:
        """Cut where a channel falls silent for longer than is bridged, and where all speak again."""
        missing = np.isnan(v)
        start = 0 if self._open else _first_complete(missing, 0)
        if start:
            yield slice(0, start), False
        while (row := self._falls_silent(missing, start)) < len(v):
            if row > start:
                yield slice(start, row), True
            start = _first_complete(missing, row)
            yield slice(row, start), False
        if start < len(v):
            yield slice(start, len(v)), True

    def _falls_silent(self, missing: BoolArray, start: int) -> int:
        """Return the row from `start` on where a channel is silent too long; the number of rows if none."""
        rest = missing[start:]
        if not rest.any():
            self._silent[:] = 0 if len(rest) else self._silent
            return len(missing)
        number = np.arange(1, len(rest) + 1)[:, None]
        received = np.maximum.accumulate(np.where(rest, 0, number), axis=0)
        silent = np.where(received > 0, number - received, number + self._silent)
        late = (silent > self.settings.bridge).any(axis=1)
        row = int(np.argmax(late)) if late.any() else len(rest)
        self._silent = np.zeros_like(self._silent) if late.any() else silent[-1]
        return start + row

    def _clean(self, index: IntArray, t_ns: IntArray, v: FloatArray) -> Labelled:
        self._index, self._t_ns = np.concatenate([self._index, index]), np.concatenate([self._t_ns, t_ns])
        clean = self._cleaner.take(v)
        self._count_spikes(clean)
        return self._label(clean)

    def _end(self) -> Labelled:
        """End the stretch; incomplete samples at its end are left out."""
        if not self._open:
            return Labelled()
        self._open = False
        clean = self._cleaner.take(np.zeros((0, len(self.settings.channels))), end=True)
        complete = np.flatnonzero(~rows_with(clean.missing))
        self._count_spikes(clean)
        pieces = self._label(clean.part(int(complete[-1]) + 1 if len(complete) else 0))
        self._index, self._t_ns = self._index[:0], self._t_ns[:0]
        self._watched = 0
        self._cleaner.restart()
        self._watch.restart()
        self._labels.new_segment()
        return pieces

    def _count_spikes(self, clean: Clean) -> None:
        """Count the samples that a spike alone spoils: those that also lack a reading count as that."""
        lost = clean.missing & ~clean.spike
        spikes = int((rows_with(clean.spike) & ~rows_with(lost)).sum())
        if spikes:
            self.rejected["spike"] += spikes

    def _label(self, clean: Clean) -> Labelled:
        """Hand on clean samples with what is known of their channels."""
        count = len(clean)
        piece = Piece(self._index[:count], self._t_ns[:count], clean)
        self._index, self._t_ns = self._index[count:], self._t_ns[count:]
        findings = self._watch.take(clean.v)
        labelled = self._labels.labelled(piece, findings, self._watched)
        self._watched += count
        for samples in labelled.values:
            if not samples.usable and samples.fault is not None:
                self.rejected[samples.fault.reason.name.lower()] += int(samples.complete.sum())
        return labelled


def _first_complete(missing: BoolArray, start: int) -> int:
    """Return the first row from `start` on that lacks no reading; as many as rows if none."""
    complete = ~rows_with(missing[start:])
    return start + int(np.argmax(complete)) if complete.any() else len(missing)
