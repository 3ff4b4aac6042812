"""Frames to samples: frames of one message as they come, frames of several joined by their counter. Pure: no I/O."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.can_database import MessageCodec, is_remote
from drivers.can_errors import ErrorWatch
from drivers.can_frames import ERROR, Frames
from drivers.port import Counts, DriverConfigError, FloatArray, IntArray

_PENDING = 64
_LATE_BEFORE_RESTART = 50


@dataclass(frozen=True, slots=True)
class Decoded:
    """Samples: values (n, m), counters or None, times in ns, and the epoch of the counting."""

    values: FloatArray
    counter: IntArray | None
    t_ns: IntArray
    epoch: int = 0


class FrameDecoder:
    """Turns frames into samples and counts those that are none.

    Args:
        messages: the messages that carry the fields.
        columns: number of fields.
        counts: told of every sample received and rejected ("dlc", "remote frame", "checksum", "counter", "mux").
        note: told what happened, in words.
        errors: shown the error frames; by default they are counted among the faults, and nobody is told.
    """

    def __init__(
        self,
        messages: tuple[MessageCodec, ...],
        columns: int,
        counts: Counts,
        note: Callable[[str], None],
        errors: ErrorWatch | None = None,
    ) -> None:
        self._messages = messages
        self._columns = columns
        self._counts = counts
        self._errors = errors or ErrorWatch("", counts, lambda _name, _words: None)
        moduli = {message.counter.sample_modulus for message in messages if message.counter}
        if len(moduli) > 1:
            raise DriverConfigError("the counters of the messages to join wrap after different numbers of samples")
        self.modulus = moduli.pop() if moduli else None
        parts = sum(len(message.pages) for message in messages)
        together = len(messages) > 1 or (parts > 1 and self.modulus is not None)
        self._joiner = Joiner(parts, columns, self.modulus or 1, counts, note) if together else None

    def restart(self) -> None:
        """Forget samples that are not whole: the bus was opened anew."""
        self._errors.restart()
        if self._joiner:
            self._joiner.restart()

    def decode(self, frames: Frames) -> Decoded:
        """Return the samples that are whole now."""
        if self._joiner is None:
            return self._single(frames)
        self._show_errors(frames)
        parts: list[Part] = []
        number = 0
        for message in self._messages:
            parts += self._parts(number, message, frames)
            number += len(message.pages)
        return self._joiner.join([part for part in parts if len(part.keys)])

    def flush(self) -> Decoded | None:
        """Return the samples that never became whole, at the end of a log; None when there are none."""
        rest = self._joiner.flush() if self._joiner else None
        return rest if rest is not None and len(rest.values) else None

    def _show_errors(self, frames: Frames) -> None:
        if (frames.table["id"] & np.uint32(ERROR)).any():
            self._errors.take(frames.table, frames.t_ns)

    def _reject(self, reason: str, frames: int, samples: int) -> None:
        """Count bad frames as the samples that they would have carried."""
        if frames:
            self._counts.received += frames * samples
            self._counts.rejected[reason] += frames * samples

    def _sound(self, message: MessageCodec, frames: Frames) -> Frames:
        """Return the message's frames that can be read; the others are counted by the first thing wrong with them."""
        frames = _picked(frames, message.mine(frames.table))
        for reason, judge in (
            ("remote frame", lambda table: ~is_remote(table)),
            ("dlc", message.right_length),
            ("checksum", message.right_sum),
            ("counter", message.right_counter),
        ):
            right = judge(frames.table)
            self._reject(reason, int(np.count_nonzero(~right)), len(message.samples))
            frames = _picked(frames, right)
        return frames

    def _single(self, frames: Frames) -> Decoded:
        (message,) = self._messages
        sound = frames
        if not message.all_sound(frames.table):
            self._show_errors(frames)
            sound = self._sound(message, frames)
        values = message.values(sound.table, self._columns)
        if message.switches:
            # a frame of other signals is nobody's sample; one whose multiplexer makes no sense is a bad one
            bare = np.logical_and.reduce(np.isnan(values), axis=1).reshape(len(sound), len(message.samples)).all(axis=1)
            self._reject("mux", int((bare & ~message.knows(sound.table)).sum()), len(message.samples))
            sound, values = _picked(sound, ~bare), values[~np.repeat(bare, len(message.samples))]
        self._counts.received += len(values)
        return Decoded(values, message.numbers(sound.table), np.repeat(sound.t_ns, len(message.samples)))

    def _parts(self, number: int, message: MessageCodec, frames: Frames) -> "list[Part]":
        """Return what one message gave, a part a page."""
        sound = self._sound(message, frames)
        if message.switches:
            known = message.knows(sound.table)
            self._reject("mux", int(np.count_nonzero(~known)), 1)
            sound = _picked(sound, known)
        parts = []
        for place, page in enumerate(message.pages, number):
            shown = _picked(sound, page.shown(sound.table))
            counter = message.numbers(shown.table)
            keys = np.zeros(len(shown), np.int64) if counter is None else counter
            values = message.values(shown.table, self._columns)[:, page.columns]
            parts.append(Part(place, keys, values, page.columns, shown.t_ns))
        return parts


def _picked(frames: Frames, mask: NDArray[np.bool_]) -> Frames:
    """Return the frames that are picked; the usual case, all of them, costs no copy."""
    return frames if mask.all() else Frames(frames.table[mask], frames.t_ns[mask])


@dataclass(frozen=True, slots=True)
class Part:
    """What one message gave of some samples: counters (as `keys`), values in `columns`, times."""

    number: int
    keys: IntArray
    values: FloatArray
    columns: IntArray
    t_ns: IntArray


@dataclass(slots=True)
class _Pending:
    """Samples that are not whole yet, by unwrapped counter."""

    rows: dict[int, FloatArray] = field(default_factory=dict)
    t_ns: dict[int, int] = field(default_factory=dict)


class Joiner:
    """Puts samples together from the parts that carry the same counter.

    Each message comes in order, so a sample is final once every message has come with its counter or a newer one; a
    part that never came leaves NaN. Parts of a sample that has gone out already are late and counted so.
    """

    def __init__(self, parts: int, columns: int, modulus: int, counts: Counts, note: Callable[[str], None]) -> None:
        self._columns = columns
        self._parts = parts
        self._modulus = modulus
        self._counts = counts
        self._note = note
        self._epoch = 0
        self.restart()

    def restart(self) -> None:
        """Forget what is pending; the next counter that comes is the first."""
        self._pending = _Pending()
        self._newest: list[int | None] = [None] * self._parts
        self._emitted: int | None = None
        self._near: int | None = None
        self._late = 0

    def join(self, parts: list[Part]) -> Decoded:
        """Take parts in; return the samples that are final."""
        if self._near is None and parts:
            first = min(parts, key=lambda part: int(part.t_ns[0]))
            self._near = int(first.keys[0])
        for part in parts:
            self._take(part)
        return self._emit()

    def _take(self, part: Part) -> None:
        keys = self._unwrapped(part)
        for key, row, t_ns in zip(keys.tolist(), part.values, part.t_ns.tolist(), strict=True):
            if self._emitted is not None and key <= self._emitted:
                self._count_late(key)
                continue
            self._late = 0
            sample = self._pending.rows.setdefault(key, np.full(self._columns, np.nan))
            sample[part.columns] = np.where(np.isnan(row), sample[part.columns], row)
            self._pending.t_ns.setdefault(key, t_ns)
            newest = self._newest[part.number]
            self._newest[part.number] = key if newest is None else max(newest, key)

    def _unwrapped(self, part: Part) -> IntArray:
        """Return the counters without their wraps, each taken as the one nearest to the one before it."""
        newest = self._newest[part.number]
        before = (self._near or 0) if newest is None else newest
        half = self._modulus // 2
        steps = (np.diff(part.keys, prepend=before) + half) % self._modulus - half
        return before + np.cumsum(steps)

    def _count_late(self, key: int) -> None:
        self._counts.faults["late part"] += 1
        self._late += 1
        if self._late > _LATE_BEFORE_RESTART:
            self._note("the counters ran back and stayed there: the device was restarted")
            self._epoch += 1
            self.restart()
            self._near = key

    def flush(self) -> Decoded:
        """Return all that is pending, whole or not."""
        return self._release(sorted(self._pending.rows))

    def _emit(self) -> Decoded:
        keys = sorted(self._pending.rows)
        seen = [newest for newest in self._newest if newest is not None]
        final = min(seen) if len(seen) == self._parts else None
        whole = [key for i, key in enumerate(keys) if (final is not None and key <= final) or len(keys) - i > _PENDING]
        return self._release(whole)

    def _release(self, whole: list[int]) -> Decoded:
        if not whole:
            return Decoded(np.empty((0, self._columns)), np.empty(0, np.int64), np.empty(0, np.int64), self._epoch)
        self._emitted = self._near = whole[-1]
        self._counts.received += len(whole)
        values = np.array([self._pending.rows.pop(key) for key in whole])
        t_ns = np.array([self._pending.t_ns.pop(key) for key in whole])
        return Decoded(values, np.array(whole) % self._modulus, t_ns, self._epoch)
