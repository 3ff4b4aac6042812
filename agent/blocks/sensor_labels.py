"""What is known of channels, written on the samples it concerns; and said once when it begins and ends."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from agent.numerics.preprocessing.cleaning import Clean
from agent.numerics.preprocessing.sensor_watch import Finding
from agent.types import FloatArray, IntArray, Output, Reason, Samples, SensorEvent, SensorFault

Labelled = Output[Samples, SensorEvent]
"""Samples with what is known of their channels, and what began or ended meanwhile."""

REASONS = {"stuck": Reason.STUCK, "saturated": Reason.SATURATED}


@dataclass(frozen=True, slots=True)
class Piece:
    """Clean samples with numbers and times."""

    index: IntArray
    t_ns: IntArray
    clean: Clean


class SensorLabels:
    """Labels a rig's samples; inputs is the number of leading input channels, window the estimator's."""

    def __init__(self, channels: Sequence[str], inputs: int, window: int) -> None:
        self._channels = tuple(channels)
        self._inputs = inputs
        self._window = window
        self._segment = 1
        self._faults: dict[str, SensorFault] = {}
        self._standing: dict[str, SensorFault] = {}  # said and not taken back yet
        self._last: SensorFault | None = None
        self._affected_until = -1
        self._silent = 0
        self._silence: SensorFault | None = None
        self._events: list[SensorEvent] = []

    def new_segment(self) -> None:
        """What follows does not follow directly on what was before."""
        self._segment += 1

    def labelled(self, piece: Piece, findings: Sequence[Finding], done: int) -> Labelled:
        """Cut a piece, whose first sample is number `done` of its stretch, where what is known changes."""
        return self._with_events(list(self._cut(piece, findings, done)))

    def _with_events(self, samples: Sequence[Samples]) -> Labelled:
        events, self._events = self._events, []
        return Labelled(samples, events)

    def _cut(self, piece: Piece, findings: Sequence[Finding], done: int) -> Iterator[Samples]:
        start = 0
        count = len(piece.index)
        self._speaks_again(piece)
        for finding in findings:
            stop = min(max(finding.stop - done, start), count)
            yield from self._even(piece, start, stop)
            self._note(finding, int(piece.index[stop - 1]), int(piece.t_ns[stop - 1]))
            start = stop
        yield from self._even(piece, start, count)

    def silence(self, index: IntArray, t_ns: IntArray, v: FloatArray) -> Labelled:
        """Label samples v (N, c) while some channel is silent; say so when that lasts as long as a window."""
        if not len(index):
            return Labelled()
        if not self._silent:
            self._silence = SensorFault(self._channels[int(np.argmax(np.isnan(v[0])))], Reason.NO_DATA)
        fault = self._silence
        due = self._window - 1 - self._silent
        if fault is not None and 0 <= due < len(index):
            self._say(fault, int(index[due]), int(t_ns[due]))
        self._silent += len(index)
        m = self._inputs
        silent = Samples(index, t_ns, v[:, :m], v[:, m:], self._segment, None, None, fault, usable=False)
        return self._with_events([silent])

    def unpaired(self, index: IntArray, t_ns: IntArray, v: FloatArray) -> Labelled:
        """Label samples v (N, c) of sources whose alignment is not known: no channel is at fault."""
        m = self._inputs
        fault = SensorFault("", Reason.REALIGNING)
        return Labelled(
            [Samples(index, t_ns, v[:, :m], v[:, m:], self._segment, None, None, fault, usable=False)]
        )

    def _speaks_again(self, piece: Piece) -> None:
        if self._silent and len(piece.index):
            self._silent = 0
            for fault in [f for f in self._standing.values() if f.reason == Reason.NO_DATA]:
                self._take_back(fault, int(piece.index[0]), int(piece.t_ns[0]))

    def _note(self, finding: Finding, index: int, t_ns: int) -> None:
        channel = self._channels[finding.channel]
        if finding.kind is not None:
            self._faults[channel] = self._last = SensorFault(channel, REASONS[finding.kind])
            self._say(self._faults[channel], index, t_ns)
            return
        self._last = self._faults.pop(channel, self._last)
        if not self._faults:
            self._affected_until = index + self._window
            self.new_segment()

    def _say(self, fault: SensorFault, index: int, t_ns: int) -> None:
        if fault.channel not in self._standing:
            self._standing[fault.channel] = fault
            self._events.append(SensorEvent(fault, True, index, t_ns))

    def _take_back(self, fault: SensorFault, index: int, t_ns: int) -> None:
        del self._standing[fault.channel]
        self._events.append(SensorEvent(fault, False, index, t_ns))

    def _even(self, piece: Piece, start: int, stop: int) -> Iterator[Samples]:
        """Label samples [start, stop) of a piece, between which no channel changes."""
        if start == stop:
            return
        if self._faults:
            yield self._samples(piece, slice(start, stop), next(iter(self._faults.values())), usable=False)
            return
        sound = int(np.searchsorted(piece.index[start:stop], self._affected_until)) + start
        if sound > start:
            yield self._samples(piece, slice(start, sound), self._last, usable=True)
        if sound < stop:
            for fault in [f for f in self._standing.values() if f.reason != Reason.NO_DATA]:
                self._take_back(fault, int(piece.index[sound]), int(piece.t_ns[sound]))
            yield self._samples(piece, slice(sound, stop), None, usable=True)

    def _samples(self, piece: Piece, part: slice, fault: SensorFault | None, *, usable: bool) -> Samples:
        m, clean = self._inputs, piece.clean
        v = clean.v[part]
        masks = [
            np.hstack([mask[part, m:], mask[part, :m]]) if mask[part].any() else None
            for mask in (clean.missing, clean.suspect)
        ]
        return Samples(
            piece.index[part],
            piece.t_ns[part],
            v[:, :m],
            v[:, m:],
            self._segment,
            masks[0],
            masks[1],
            fault,
            usable,
        )
