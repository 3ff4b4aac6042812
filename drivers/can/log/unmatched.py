"""What is in a CAN log of which no frame is one of those looked for, in words. Pure: no I/O."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from drivers.can.codec.database import MessageCodec
from drivers.can.codec.frames import ERROR, EXTENDED, EXTENDED_MASK, STANDARD_MASK, FrameTable
from drivers.can.tuning import NAMED_IDS


class UnmatchedFrames:
    """Counts the frames of a log, by identifier, until one fits."""

    def __init__(self) -> None:
        self._seen: Counter[int] = Counter()

    def see(self, table: FrameTable) -> None:
        """Count frames (n,) of which none was one of those looked for."""
        numbers, counts = np.unique(table["id"], return_counts=True)
        self._seen.update(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))

    def words(self, messages: Sequence[MessageCodec]) -> str:
        """Say how many frames there are, which are seen most often, and the messages that are looked for."""
        often = ", ".join(f"{_digits(number)} ({n} times)" for number, n in self._seen.most_common(NAMED_IDS))
        looked = ", ".join(f"{message.name} ({_pattern(message)})" for message in messages)
        return (
            f"none of its {self._seen.total()} frames fits: most often seen are {often}; "
            f"looked for is {looked}"
        )


def _digits(number: int) -> str:
    """Write an identifier, flag bits included, as candump does."""
    if number & ERROR:
        return "error frames"
    return f"{number & EXTENDED_MASK:08X}" if number & EXTENDED else f"{number & STANDARD_MASK:03X}"


def _pattern(message: MessageCodec) -> str:
    """Write the identifier of a message, an x in the place of each digit that may be any."""
    if not message.number & EXTENDED:
        return _digits(message.number)
    digits = f"{message.number & EXTENDED_MASK:08X}"
    fixed = f"{message.mask & EXTENDED_MASK:08X}"
    whole = message.mask & EXTENDED_MASK == EXTENDED_MASK
    return digits if whole else "".join(d if f == "F" else "x" for d, f in zip(digits, fixed, strict=True))
