"""Frames to samples: of one message as they come, of several joined by their counter. Pure: no I/O."""

from collections.abc import Callable

import numpy as np

from drivers.can.codec.database import MessageCodec, is_remote
from drivers.can.codec.error_frames import ErrorWatch
from drivers.can.codec.frames import ERROR, EXTENDED, EXTENDED_MASK, STANDARD_MASK, Frames, FrameTable
from drivers.can.codec.joiner import Decoded, Joiner, Part
from drivers.port import BoolArray, Counts, DriverConfigError, Trace


class FrameDecoder:
    """Turns frames into samples and counts those that are none.

    Args:
        messages: the messages that carry the fields.
        columns: number of fields.
        counts: told of every sample received and rejected ("dlc", "remote frame", "checksum", "counter",
            "mux").
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
        self._errors = ErrorWatch("", counts, lambda _name, _words: None) if errors is None else errors
        self.modulus = _common_modulus(messages)
        parts = sum(len(message.pages) for message in messages)
        joins_pages = parts > 1 and self.modulus is not None
        self._joiner: Joiner | None = None
        if len(messages) > 1 or joins_pages:
            self._joiner = Joiner(parts, columns, self.modulus or 1, counts, note)

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
        """Return the message's readable frames; the others are counted by the first thing wrong with them."""
        frames = _picked(frames, message.mine(frames.table))
        for reason, assess in (
            ("remote frame", lambda table: ~is_remote(table)),
            ("dlc", message.right_length),
            ("checksum", message.right_sum),
            ("counter", message.right_counter),
        ):
            right = assess(frames.table)
            self._reject(reason, int(np.count_nonzero(~right)), len(message.samples))
            if not right.all():
                self._show_bad(reason, frames.table[~right])
            frames = _picked(frames, right)
        return frames

    def _show_bad(self, reason: str, table: FrameTable) -> None:
        if len(table):
            self._counts.show_bad(reason, shown(table[0]), *map(shown, table[1:][-Trace.NEWEST :]))

    def _show(self, message: MessageCodec, table: FrameTable) -> None:
        """Show frames beside what each of them carries: of several samples in one the last."""
        if self._counts.trace is not None:
            newest = table[-Trace.NEWEST :]
            last = message.values(newest, self._columns)[len(message.samples) - 1 :: len(message.samples)]
            self._counts.trace.good([f"{message.name} {shown(frame)}" for frame in newest], last)

    def _single(self, frames: Frames) -> Decoded:
        (message,) = self._messages
        sound = frames
        if not message.all_sound(frames.table):
            self._show_errors(frames)
            sound = self._sound(message, frames)
        values = message.values(sound.table, self._columns)
        if message.switches:
            # a frame of other signals is nobody's sample; one whose multiplexer makes no sense is a bad one
            bare = (
                np.logical_and.reduce(np.isnan(values), axis=1)
                .reshape(len(sound), len(message.samples))
                .all(axis=1)
            )
            strange = bare & ~message.knows(sound.table)
            self._reject("mux", int(strange.sum()), len(message.samples))
            self._show_bad("mux", sound.table[strange])
            sound, values = _picked(sound, ~bare), values[~np.repeat(bare, len(message.samples))]
        self._counts.received += len(values)
        self._show(message, sound.table)
        return Decoded(values, message.numbers(sound.table), np.repeat(sound.t_ns, len(message.samples)))

    def _parts(self, number: int, message: MessageCodec, frames: Frames) -> list[Part]:
        """Return what one message gave, a part a page."""
        sound = self._sound(message, frames)
        if message.switches:
            known = message.knows(sound.table)
            self._reject("mux", int(np.count_nonzero(~known)), 1)
            self._show_bad("mux", sound.table[~known])
            sound = _picked(sound, known)
        self._show(message, sound.table)
        parts = []
        for place, page in enumerate(message.pages, number):
            shown = _picked(sound, page.shown(sound.table))
            counter = message.numbers(shown.table)
            keys = np.zeros(len(shown), np.int64) if counter is None else counter
            values = message.values(shown.table, self._columns)[:, page.columns]
            parts.append(Part(place, keys, values, page.columns, shown.t_ns))
        return parts


def shown(frame: np.void) -> str:
    """Return one frame as candump writes it, without what it lacks: `18FF0100#0102`."""
    digits, mask = (8, EXTENDED_MASK) if int(frame["id"]) & EXTENDED else (3, STANDARD_MASK)
    data = frame["data"][: int(frame["length"])].tobytes().hex().upper()
    return f"{int(frame['id']) & mask:0{digits}X}#{data}"


def _picked(frames: Frames, mask: BoolArray) -> Frames:
    """Return the frames that are picked; the usual case, all of them, costs no copy."""
    return frames if mask.all() else Frames(frames.table[mask], frames.t_ns[mask])


def _common_modulus(messages: tuple[MessageCodec, ...]) -> int | None:
    """Return after how many samples the counters wrap; None without counters. Raises DriverConfigError."""
    moduli = {message.counter.sample_modulus for message in messages if message.counter}
    if len(moduli) > 1:
        raise DriverConfigError(
            "the counters of the messages to join wrap after different numbers of samples"
        )
    return moduli.pop() if moduli else None
