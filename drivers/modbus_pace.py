"""Whether a link keeps up with a ring that is overwritten while it is read, and where to go on if it does not.

Who reads the oldest slot next is always late on a link that is slower than the device's rate, and delivers nothing for
ever. Reading that goes on near the newest sample instead has the whole ring to fall behind in: as many samples come in
a row as it has room for, then the next ones are left out.
"""

from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers import clock
from drivers.modbus_codec import Ring

SLOW_S = 60.0
"""A link is taken for slow for so long after samples last came too late; it is told once until then."""
HOPELESS = 2
"""Reads in a row of which most came too late: after a mere stall the first is late, and the next one is not."""
NEAR = 2
"""Reading goes on this part of the ring behind the newest sample at most: the rest is for the time that it takes."""


class Carried(NamedTuple):
    """What a link carried in a read: samples read, samples that the device wrote meanwhile, and how long that took."""

    read: int
    written: int
    seconds: float

    @property
    def words(self) -> str:
        """What is wrong, in words."""
        carries, takes = (f"{count / max(self.seconds, 1e-3):.0f}" for count in (self.read, self.written))
        return (
            f"the link is too slow for the device: it carries about {carries} of the {takes} samples a second that are "
            "written; those that come too late are left out, with gaps (a faster line, a nearer gateway, shorter slots "
            "or a lower sample rate would help)"
        )


class Pace:
    """How reading a ring keeps up with its device."""

    def __init__(self, ring: Ring) -> None:
        self._ring = ring
        self._late = 0
        self._slow_until = self._told_until = -inf

    @property
    def slow(self) -> bool:
        """Whether the link is taken for too slow at present."""
        return clock.monotonic() < self._slow_until

    def behind(self, late: NDArray[np.bool_]) -> bool:
        """Take which samples (n,) of a read came too late; tell whether the oldest slots cannot be caught up with."""
        self._late = self._late + 1 if 2 * late.sum() > len(late) else 0
        return bool(late.any()) and (self.slow or self._late >= HOPELESS)

    def fell_behind(self, carried: Carried) -> bool:
        """Take the link for slow from now on; return whether that is to be told."""
        now = clock.monotonic()
        told = now < self._told_until
        news = not told and carried.read < carried.written
        self._slow_until = now + SLOW_S
        if told or news:
            self._told_until = now + SLOW_S
        return news

    def resume(self, head: int) -> int:
        """Return the sample to go on with when `head` are written: what one request holds, if the ring has room."""
        oldest = self._ring.oldest(head)
        if not self.slow:
            return oldest
        return max(oldest, head - min(self._ring.samples_a_request, max(1, self._ring.slots // NEAR)))
