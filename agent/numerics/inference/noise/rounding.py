"""Readings of so many significant digits, as tables and displays give them: 0.0987, then 0.101.

Their rounding errors grow tenfold where a reading passes a power of ten, so that neither the noise of a
window is that of another nor that of its parts each other's. With r(t) what rounding adds to S, estimates by
the score Σ ψ' S⁻¹ e have Σ (S⁻¹ψ)² r / Σ ψ' S⁻¹ ψ more of the variance that S alone states (White,
Econometrica 48 (1980) 817). Where in a window ψ is large the readings themselves show: springs and dampers
show by the size of the motion, so r is weighed by y². A code that repeats itself repeats its error. Digits
are those of readings as they came: what comes in multiples of g, or is scaled, is no table in SI.
"""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.inference.tuning import LEAST_OWN, MOST_DIGITS, MOST_REPEATS, ROUNDING
from agent.numerics.preprocessing.wire import Wire
from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Rounding:
    """How outputs are rounded, and what that does.

    Attributes:
        digits: (p,) significant digits; 0 of an output with one step, or none.
        wire: what outputs come in.
        usual: (p,) mean variance of rounding errors that the noise counts.
        of_power, of_score: (p,) by how much of itself the residual's power, and the variance of scores, grows
            with a unit of variance of an output's readings.
    """

    digits: IntArray
    wire: Wire
    usual: FloatArray
    of_power: FloatArray
    of_score: FloatArray

    def variance(self, y: FloatArray) -> FloatArray:
        """Return the variance (N, p) of the rounding errors of readings y (N, p)."""
        steps = self.wire.unit * _steps(self.wire.readings(y), np.maximum(self.digits, 1))
        return np.asarray(np.where(self.digits > 0, steps**2 / 12, 0.0))

    def at(self, y: FloatArray) -> "Rounding":
        """Return the rounding with readings y (W, p) as the usual ones."""
        return replace(self, usual=self.variance(y).mean(axis=0))


def rounding_after(known: Rounding | None, y: FloatArray, wire: Wire) -> Rounding | None:
    """Return how outputs are rounded after one more window of values y (W, p); None where evenly."""
    digits, uneven = significant_digits(wire.readings(y))
    before = np.zeros_like(digits) if known is None else known.digits
    digits = np.where((digits > 0) & (digits <= before), before, np.where(uneven, digits, 0))
    if not digits.any():
        return None
    none = np.zeros(len(digits))
    return Rounding(digits, wire, none, none, none) if known is None else replace(known, digits=digits)


def reference(known: Rounding | None, here: Rounding, share: float) -> FloatArray:
    """Return the variance (p,) of rounding errors that the bank's filters count on after one more window.

    Its precision is the mean over windows, of which the newest is a `share`: filters for the windows that
    tell most. Filters for large readings would leave little known of the power that small ones must have.
    """
    if known is None:
        return here.usual
    least = np.finfo(float).tiny
    return 1 / ((1 - share) / np.maximum(known.usual, least) + share / np.maximum(here.usual, least))


def significant_digits(y: FloatArray) -> tuple[IntArray, BoolArray]:
    """Return how many significant digits (p,) all readings y (W, p) do with, and whether one step does not.

    0 where they need more than any table that is rounded so.
    """
    digits = np.zeros(y.shape[1], dtype=np.int64)
    for count in range(MOST_DIGITS, 0, -1):
        # most readings have all digits of a double: a look at one is enough
        if not (_fits(y[:1], count).any() and (fits := _fits(y, count)).any()):
            break
        digits[fits] = count
    if not digits.any():
        return digits, digits > 0
    coarsest = _steps(np.abs(y).max(axis=0, keepdims=True), np.maximum(digits, 1))
    return digits, (digits > 0) & ~_whole(y, coarsest)


def _fits(y: FloatArray, digits: int) -> BoolArray:
    """(p,) whether all readings y (N, p) do with so many digits."""
    return _whole(y, _steps(y, np.full(y.shape[1], digits)))


def _steps(y: FloatArray, digits: IntArray) -> FloatArray:
    """Step (N, p) at readings of so many digits (p,)."""
    # a power of ten may come as a number just below it
    exact = 1 + ROUNDING * 10.0 ** (1 - MOST_DIGITS)
    power = np.floor(np.log10(np.maximum(np.abs(y) * exact, 1e-300)))
    return np.asarray(10.0 ** (power + 1 - digits))


def _whole(y: FloatArray, step: FloatArray) -> BoolArray:
    """(p,) whether all readings are whole numbers of steps."""
    count = y / step
    return np.asarray((np.abs(count - np.rint(count)) < ROUNDING).all(axis=0))


def _repeats(y: FloatArray) -> FloatArray:
    """Return which repetition (N, p) of its code a reading is, the first 1, at most MOST_REPEATS.

    The sum of L errors of one code has L² times the variance of one where the motion rests, and none where it
    passes evenly through a step: with the error of each counted so often it is between them, L (L + 1) / 2.
    """
    place = np.arange(len(y))[:, None]
    changed = np.vstack([np.ones((1, y.shape[1]), dtype=bool), np.diff(y, axis=0) != 0])
    since = place - np.maximum.accumulate(np.where(changed, place, 0), axis=0)
    return np.asarray(np.minimum(since + 1.0, MOST_REPEATS))


class RoundingErrors:
    """Variance in parts of a record in units of the one that is assumed, from sums over its readings.

    None is below 1: quieter readings than the filters count on are learnt from before they are relied on.

    Args:
        first: number of the first reading.
        y: (N, p) readings;  rounding: of them.
        before: how many of them come before the first that is asked for.
    """

    def __init__(self, first: int, y: FloatArray, rounding: Rounding, before: int = 0) -> None:
        self._first, self._rounding = first, rounding
        own = rounding.variance(y)
        repeated = (own * _repeats(y) - rounding.usual)[before:]
        more = (own - rounding.usual)[before:]
        tells = y[before:] ** 2
        each = np.stack([tells, tells * repeated], axis=1)
        self._sums = np.concatenate([np.zeros((1, *each.shape[1:])), np.cumsum(each, axis=0)])
        power = np.maximum(1 + more @ rounding.of_power, LEAST_OWN)
        powers = np.column_stack([power, power**2])
        self._powers = np.concatenate([np.zeros((1, 2)), np.cumsum(powers, axis=0)])

    def _between(self, start: IntArray, stop: IntArray) -> FloatArray:
        """(2, ..., p) sums over readings [start, stop)."""
        return np.moveaxis(self._sums[stop - self._first] - self._sums[start - self._first], -2, 0)

    def power(self, start: IntArray, stop: IntArray) -> FloatArray:
        """Return the expected power (...) of residuals of readings [start, stop)."""
        return np.asarray(np.maximum(self._power(start, stop)[0] / (stop - start), 1.0))

    def count(self, start: IntArray, stop: IntArray) -> FloatArray:
        """Return how many (...) even readings tell as much of the power as readings [start, stop) do."""
        power, square = self._power(start, stop)
        return np.asarray(power**2 / square)

    def _power(self, start: IntArray, stop: IntArray) -> FloatArray:
        return np.moveaxis(self._powers[stop - self._first] - self._powers[start - self._first], -1, 0)

    def inflation(self, start: IntArray, stop: IntArray) -> FloatArray:
        """Return the variance (...) of what readings [start, stop) tell of the parameters."""
        return np.asarray(np.maximum(self._inflation(start, stop), 1.0))

    def _inflation(self, start: IntArray, stop: IntArray) -> FloatArray:
        tells, uneven = self._between(start, stop)
        return np.asarray(
            np.maximum(1 + (uneven / np.maximum(tells, 1e-300)) @ self._rounding.of_score, LEAST_OWN)
        )

    def jump(self, start: IntArray, cut: IntArray, stop: IntArray) -> FloatArray:
        """Return the variance (...) of the score of a jump at `cut`, in units of its information.

        With I₁, I₂ what the parts tell and I their sum, the score is that of one part less what the whole
        lets expect: its information is I₁ I₂ / I, its variance that times (v₂ I₁ + v₁ I₂) / I.
        """
        before = self._between(start, cut)[0] @ self._rounding.of_score
        after = self._between(cut, stop)[0] @ self._rounding.of_score
        both = self._inflation(cut, stop) * before + self._inflation(start, cut) * after
        return np.asarray(np.maximum(both / np.maximum(before + after, 1e-300), 1.0))
