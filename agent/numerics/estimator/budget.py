"""How much may be computed beside the rows: a token bucket that is filled by samples, so that live and replay agree."""

from dataclasses import dataclass, field

BURST = 24
"""Solves that may follow one another: the first windows, or a step and its aftermath."""
WINDOWS_A_TOKEN = 6
"""Windows of samples after which one more solve may be spent: what bounds the cost of a rig that nothing fits."""
SAMPLES_A_TOKEN = 4096
"""The same, in samples, where windows are short."""


@dataclass(slots=True)
class Budget:
    """Tokens for solves; window in samples. Counted in whole samples: asking more often changes nothing."""

    window: int
    at: int | None = field(default=None)
    closed: bool = False
    saved: int = field(init=False)

    def __post_init__(self) -> None:
        self.saved = BURST * self.price

    @property
    def price(self) -> int:
        """Samples a token."""
        return max(WINDOWS_A_TOKEN * self.window, SAMPLES_A_TOKEN)

    def close(self) -> None:
        """Allow nothing any more: there is no time for anything but rows."""
        self.closed = True

    def take(self, index: int) -> bool:
        """Spend one token at sample `index`; False where none is left."""
        if self.at is not None:
            self.saved = min(BURST * self.price, self.saved + max(index - self.at, 0))
        self.at = index if self.at is None else max(index, self.at)
        if self.saved < self.price:
            return False
        self.saved -= self.price
        return True

    def give_back(self) -> None:
        """Return the token that was spent last: what explains a row is no loss."""
        self.saved = min(BURST * self.price, self.saved + self.price)
