"""The frequencies that a design may choose from, and what each teaches."""

from dataclasses import dataclass

import numpy as np

from agent.commissioning.tuning import ABOVE, BANDWIDTHS, BELOW, HIGHEST, MOST_LINES, NEAR_LINES
from agent.errors import UsageError
from agent.numerics.model.statespace import Discrete
from agent.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines of a multisine: whole periods (L,) in its length, and the input (L,) that each belongs to."""

    periods: IntArray
    column: IntArray


def candidate_lines(discrete: Discrete, count: int, inputs: int, band: tuple[float, float] | None) -> Lines:
    """Return the lines of a signal of `count` samples in a band, Hz; those of several inputs alternate.

    Raises UsageError for a band without a line.
    """
    rate = 1.0 / discrete.period_s
    modes = _modes(discrete)
    low, high = band or (BELOW * modes[0, 0], ABOVE * modes[-1, 0])
    low, high = max(low, 0.0), min(high, HIGHEST * rate)
    first = max(int(np.ceil(low * count / rate - 1e-9)), 1)
    last = int(np.floor(high * count / rate + 1e-9))
    if band is None and last - first < 2 * inputs:
        first, last = 1, max(last, min(3 * inputs, count // 3))
    if last - first + 1 < 2 * inputs:
        held = f"{max(last - first + 1, 0)} lines, which are 1/{count / rate:g} Hz apart"
        what = f"the band {low:.4g} to {high:.4g} Hz holds {held}"
        raise UsageError.at(
            "--band", what, f"widen it (at most to {HIGHEST * rate:g} Hz), or give more seconds"
        )
    chosen = _spaced(first, last, modes * count / rate)
    periods, column = [], []
    for number in range(inputs):
        own = np.unique(np.clip(chosen // inputs * inputs + number, first, last))
        own = own[own % inputs == number % inputs]
        periods.append(own)
        column.append(np.full(len(own), number))
    return Lines(np.concatenate(periods), np.concatenate(column))


def _modes(discrete: Discrete) -> FloatArray:
    """Return frequency and half-power bandwidth (k, 2) of modes, Hz, slowest first; of none, a slow one."""
    z = np.linalg.eigvals(discrete.model.A)
    with np.errstate(divide="ignore"):
        s = np.log(z.astype(complex)) / discrete.period_s
    kept = s[np.isfinite(s) & (np.abs(s) > 1e-6 * np.max(np.abs(s), initial=0.0, where=np.isfinite(s)))]
    if not len(kept):
        return np.array([[1e-3 / discrete.period_s, 1e-3 / discrete.period_s]])
    found = np.column_stack([np.abs(kept), 2.0 * np.abs(kept.real)]) / (2.0 * np.pi)
    return np.asarray(found[np.argsort(found[:, 0])])


def _spaced(first: int, last: int, modes: FloatArray) -> IntArray:
    """Return lines from first to last; modes (k, 2) in periods."""
    if last - first < MOST_LINES:
        return np.arange(first, last + 1)
    wide = np.geomspace(first, last, MOST_LINES // 2)
    near = [f + b * np.linspace(-BANDWIDTHS, BANDWIDTHS, NEAR_LINES) for f, b in modes]
    every = np.rint(np.concatenate([wide, *near])).astype(np.int64)
    return np.unique(every[(every >= first) & (every <= last)])
