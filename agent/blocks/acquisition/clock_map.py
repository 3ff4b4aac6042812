"""When a device that counts for itself took its samples, on the gateway's monotonic clock."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from agent.blocks.tuning import LINE_EVERY_S, SETTLE_S, STEEPEST, TRUSTED_S
from agent.numerics.preprocessing.drift import ClockFit
from agent.types import FloatArray


class _Piece(NamedTuple):
    first: int
    time_s: float
    period_s: float


@dataclass(slots=True)
class ClockMap:
    """Times (s, the gateway's monotonic clock) of a device's samples: straight pieces, one after the other.

    Each piece rests on arrivals before it alone, and on the device's own alone, so what is said of a sample
    does not depend on when it is asked. Where the device began anew, so does the map, with a jump.
    """

    rate_hz: float
    settled: bool = False
    """Whether there is a line for the device as it counts now."""
    _fit: ClockFit | None = None
    _pieces: list[_Piece] = field(default_factory=list)
    _from: int = 0  # the sample from which the next first piece holds
    _begun: int = 0  # where arrivals began to be watched
    _newest: int = -1
    _due_s: float = SETTLE_S

    @property
    def known(self) -> int:
        """The last sample whose time is known; below the first one while there is none."""
        return self._newest if self.settled else self._from - 1

    def restart(self) -> None:
        """Forget the line: the device began anew."""
        self._fit = None
        self.settled = False
        self._due_s = SETTLE_S
        self._from = self._newest + 1

    def observe(self, index: int, arrival_ns: int) -> None:
        """Take the newest sample of a block and when the block arrived."""
        if self._fit is None:
            self._fit = ClockFit(self.rate_hz)
            self._begun = index
        self._fit.observe(index, arrival_ns)
        self._newest = index
        elapsed = (index - self._begun) / self.rate_hz
        if elapsed >= self._due_s:
            self._draw(self._fit)
            self._due_s = elapsed + min(elapsed, LINE_EVERY_S)

    def _draw(self, fit: ClockFit) -> None:
        """Go on from the newest sample towards the line as arrivals show it now; begin on it."""
        line = fit.line(TRUSTED_S)
        nominal = 1.0 / self.rate_hz
        if not self.settled:
            self._pieces.append(_Piece(self._from, fit.at_s(line, self._from), nominal * (1 + line.slope)))
            self.settled = True
            return
        here = float(self.time_s(np.array([self._newest]))[0])
        ahead = round(LINE_EVERY_S * self.rate_hz)
        period = (fit.at_s(line, self._newest + ahead) - here) / ahead
        period = float(np.clip(period, nominal * (1 - STEEPEST), nominal * (1 + STEEPEST)))
        self._pieces.append(_Piece(self._newest, here, period))

    def time_s(self, index: FloatArray) -> FloatArray:
        """Return the times (n,) of samples (n,) up to the last known."""
        firsts = np.array([piece.first for piece in self._pieces])
        return self._along(np.maximum(np.searchsorted(firsts, index, side="right") - 1, 0), index)

    def _along(self, number: np.ndarray[tuple[int], np.dtype[np.intp]], index: FloatArray) -> FloatArray:
        table = np.array(self._pieces, dtype=np.float64)[number]
        return np.asarray(table[:, 1] + (index - table[:, 0]) * table[:, 2])

    def place(self, time_s: FloatArray) -> FloatArray:
        """Return which samples, with fractions, were taken at times (n,)."""
        begins = np.array([piece.time_s for piece in self._pieces])
        number = np.maximum(np.searchsorted(begins, time_s, side="right") - 1, 0)
        table = np.array(self._pieces, dtype=np.float64)[number]
        return np.asarray(table[:, 0] + (time_s - table[:, 1]) / table[:, 2])

    def forget(self, before: int) -> None:
        """Drop pieces that only samples before one need."""
        while len(self._pieces) > 1 and self._pieces[1].first <= before:
            del self._pieces[0]
