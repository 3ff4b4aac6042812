"""When a window is learnt from, and when a broken one is retried; counted in samples, so replay agrees."""

from dataclasses import dataclass

EAGER = (6, 32)
"""Windows, at least and at the most, learnt from one after another before learning becomes seldom."""
EAGER_SAMPLES = 64_000
"""Samples in them otherwise: long windows say more each."""
GROWTH = 2.0
"""Ratio of the stretches between windows learnt from afterwards."""
SELDOM, SELDOM_SAMPLES = 256, 256_000
"""Windows between two that are learnt from, at the most, or so many samples where windows are short."""
LATEST = 5
"""Doublings of the time between tries at windows that cannot be solved: eight windows, at the most."""
FOLLOWED = 8
"""Windows learnt from one after another where the noise changed: of slow forces each says but little."""
TRIES = 8
"""Tries a window length to solve windows that are broken."""
AGAIN = 3
"""Windows within which parameters that change twice are rather pushed by forces that nobody measures."""
LASTS = 1.5
"""Windows that one change is in the way at the most; what lasts longer may be forces that began."""


@dataclass(slots=True)
class Schedule:
    """When to learn: from every window at first, then ever more seldom."""

    window: int
    learnt: int = 0
    due: int = 0
    tried: int = 0
    failed: int = 0

    def done(self, index: int) -> None:
        """Note that the window ending at sample `index` was learnt from."""
        self.learnt, self.tried, self.failed = self.learnt + 1, index, 0
        most = max(SELDOM, SELDOM_SAMPLES // self.window)
        stretch = min(GROWTH ** max(0, self.learnt - self._eager), most)
        self.due = index + self.window * int(stretch)

    def later(self, index: int, *, failed: bool = False) -> None:
        """Try again a quarter of a window on; where windows cannot be solved, twice as long after each."""
        self.failed = self.failed + 1 if failed else 0
        self.tried = index
        self.due = index + max(1, self.window // 4) * 2 ** min(max(self.failed - 1, 0), LATEST)

    def skip(self, index: int) -> None:
        """Learn from no window that reaches back to sample `index`: parameters moved there."""
        self.tried = index
        self.due = max(self.due, index + self.window)

    def follow(self, index: int) -> None:
        """Learn soon: something changed."""
        self.learnt = min(self.learnt, max(self._eager - FOLLOWED, 0))
        self.due = index + self.window

    @property
    def _eager(self) -> int:
        least, most = EAGER
        return min(max(EAGER_SAMPLES // self.window, least), most)


@dataclass(slots=True)
class Disturbance:
    """A stretch of broken rows: since which sample, None outside one; `again`: the sample of the next try."""

    onset: int | None = None
    again: int = -(1 << 60)
    ended: int = -(1 << 60)
    changed: int = -(1 << 60)

    def at(self, index: int) -> None:
        """Note a broken row."""
        if self.onset is None:
            self.onset = index

    def is_more_than_a_change(self, index: int, window: int) -> bool:
        """Note that other parameters fit; return whether too slowly for one change, or too soon after one."""
        before, self.changed = self.changed, index
        return index - before < AGAIN * window or index - (self.onset or index) > LASTS * window

    def tried(self, index: int, window: int) -> None:
        """Note a try at sample `index`."""
        self.again = index + max(1, window // TRIES)

    def wait(self, until: int) -> None:
        """Let sample `until` pass before the next try."""
        self.again = max(self.again, until)

    def since(self, index: int) -> bool:
        """Whether rows after sample `index` were broken."""
        return self.onset is not None or self.ended > index

    def over(self, index: int) -> None:
        """Note a row that holds."""
        if self.onset is not None:
            self.onset, self.ended = None, index
