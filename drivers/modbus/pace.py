"""Whether a link keeps up with a ring overwritten while it is read, and where to go on if it does not.

Who reads the oldest slot next is always late on a link that is slower than the device's rate, and delivers
nothing for ever. Reading that goes on near the newest sample instead has the whole ring to fall behind in: as
many samples come in a row as it has room for, then the next ones are left out.
"""

from math import inf
from typing import NamedTuple

from drivers import clock
from drivers.modbus.codec import Ring
from drivers.modbus.tuning import HOPELESS, NEAR, SLOW_S
from drivers.port import BoolArray


class Carried(NamedTuple):
    """What a link carried in a read, or in several.

    Attributes:
        read: samples read.
        written: samples that the device wrote meanwhile.
        seconds: how long that took.
        good_s: how much of it good replies took; without what bad, late and missing ones cost.
        broken: whether there were such.
    """

    read: int
    written: int
    seconds: float
    good_s: float
    broken: bool = False

    @property
    def carries(self) -> float:
        """Samples a second that the link carries."""
        return self.read / max(self.good_s, 1e-3)

    @property
    def needed(self) -> float:
        """Samples a second that are written."""
        return self.written / max(self.seconds, 1e-3)

    @property
    def keeps_up(self) -> bool:
        """Whether the link is quick enough for the device, were it not for replies lost or late."""
        return self.broken and self.carries >= self.needed

    def and_then(self, more: "Carried") -> "Carried":
        """Return both reads as one: a read that a lost reply cut short says little by itself."""
        return Carried(
            self.read + more.read, self.written + more.written, self.seconds + more.seconds,
            self.good_s + more.good_s, self.broken or more.broken,
        )  # fmt: skip

    @property
    def words(self) -> str:
        """What is wrong, in words."""
        return (
            f"the link is too slow for the device: it carries about {self.carries:.0f} of the "
            f"{self.needed:.0f} samples a second that are written; those that come too late are left out, "
            "with gaps (a faster line, a nearer gateway, shorter slots or a lower sample rate would help)"
        )


class Pace:
    """How reading a ring keeps up with its device."""

    def __init__(self, ring: Ring) -> None:
        self._ring = ring
        self._late = 0
        self.carried = Carried(0, 0, 0.0, 0.0)
        """What the link carried in the newest read, or in all since the first that came too late in a row."""
        self._slow_until = self._reported_until = -inf

    @property
    def slow(self) -> bool:
        """Whether the link is taken for too slow at present."""
        return clock.monotonic() < self._slow_until

    def behind(self, late: BoolArray, carried: Carried) -> bool:
        """Take which samples (n,) came too late; tell whether the oldest slots cannot be caught up with."""
        self._late = self._late + 1 if 2 * late.sum() > len(late) else 0
        self.carried = self.carried.and_then(carried) if self._late > 1 else carried
        return bool(late.any()) and (self.slow or self._late >= HOPELESS)

    def fell_behind(self) -> bool:
        """Take the link for slow from now on, unless it fell behind by lost replies; tell if that is news."""
        if self.carried.keeps_up:
            return False
        now = clock.monotonic()
        reported = now < self._reported_until
        news = not reported and self.carried.carries < self.carried.needed
        self._slow_until = now + SLOW_S
        if reported or news:
            self._reported_until = now + SLOW_S
        return news

    def resume(self, head: int) -> int:
        """Return the sample to resume at when `head` are written: a request's worth, if the ring has room."""
        oldest = self._ring.oldest(head)
        if not self.slow:
            return oldest
        return max(oldest, head - min(self._ring.samples_a_request, max(1, self._ring.slots // NEAR)))
