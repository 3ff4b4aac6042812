"""A parameter's history, thinned to what a fit needs: means of runs of rows, without outliers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.prognosis.tuning import NEIGHBOURS, OUTLIER
from agent.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class History:
    """Valid rows of one parameter in order of time.

    Attributes:
        t: (n,) instants, in any unit of time, never decreasing.
        value, sd: (n,) estimate and its standard deviation against the other rows; 0 where none is stated.
    """

    t: FloatArray
    value: FloatArray
    sd: FloatArray

    def __len__(self) -> int:
        return len(self.t)

    @property
    def span(self) -> float:
        """The time from the first row to the newest."""
        return float(self.t[-1] - self.t[0]) if len(self.t) else 0.0

    def until(self, t: float) -> "History":
        """Return the rows up to an instant."""
        return self[: int(np.searchsorted(self.t, t, side="right"))]

    def __getitem__(self, rows: "slice | NDArray[np.intp]") -> "History":
        return History(self.t[rows], self.value[rows], self.sd[rows])


def disjoint(t_ns: IntArray, span_s: FloatArray) -> NDArray[np.intp]:
    """Return the rows, newest kept, whose spans (t − span, t] share nothing; t_ns (n,) in order of time."""
    starts = t_ns - np.round(span_s * 1e9).astype(np.int64)
    if len(t_ns) < 2 or bool((t_ns[:-1] <= starts[1:]).all()):
        return np.arange(len(t_ns))
    before = (np.searchsorted(t_ns, starts, side="right") - 1).tolist()
    chain = []
    row = len(t_ns) - 1
    while row >= 0:
        chain.append(row)
        row = min(before[row], row - 1)  # a row without a span still precedes itself
    return np.array(chain[::-1], dtype=np.intp)


def sound(history: History) -> History:
    """Return the rows that are no outliers among their neighbours and have a time of their own.

    A row is left out where it stands apart from the median of the rows around it (Hampel 1974). That median
    is the row itself on a drift, and of the row's own side at a step; the newest rows have nothing yet to
    stand apart from.
    """
    history = history[np.flatnonzero(np.r_[np.diff(history.t) > 0.0, True][: len(history)])]
    n = len(history)
    if n < 2 * NEIGHBOURS + 1:
        return history
    padded = np.pad(history.value, NEIGHBOURS, mode="reflect", reflect_type="odd")
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1), axis=1)
    apart = np.abs(history.value - around)
    deviation = np.hypot(max(_scatter(history), 1.4826 * float(np.median(apart))), history.sd)
    drift = float(
        np.median(np.abs(np.diff(history.value)))
    )  # an outlier moves its neighbours' median by so much
    keep = (apart <= OUTLIER * deviation + drift) | (np.arange(n) >= n - NEIGHBOURS)
    return history[np.flatnonzero(keep)]


def _scatter(history: History) -> float:
    """Return the robust deviation of rows from the middle of their neighbours."""
    middle = 0.5 * (history.value[:-2] + history.value[2:])
    return 1.4826 * float(np.median(np.abs(history.value[1:-1] - middle)))


def blocks(history: History, most: int) -> History:
    """Return means of at most `most` runs of equally many rows, the newest run whole, weighted by 1/sd²."""
    n = len(history)
    if n <= most:
        return history
    length = -(-n // most)
    starts = np.arange(n % length or length, n, length)
    starts = np.r_[0, starts] if starts[0] > 0 else starts
    known = history.sd > 0.0
    weight = np.ones(n)
    if known.any():
        least = history.sd[known].min()
        weight = np.where(known, (least / np.where(known, history.sd, 1.0)) ** 2, 1.0)
    total = np.add.reduceat(weight, starts)
    t, value = (np.add.reduceat(weight * x, starts) / total for x in (history.t, history.value))
    sd = np.sqrt(np.add.reduceat((weight * history.sd) ** 2, starts)) / total
    return History(t, value, sd)


def monotone(value: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the isotonic regression of values (n,): the nearest that never falls (pool adjacent violators).

    scipy.optimize has one as well, and takes 16 MB of a gateway's memory with it.
    """
    pools: list[tuple[float, float, int]] = []
    for mean, mass in zip(value.tolist(), weight.tolist(), strict=True):
        pool = (mean, mass, 1)
        while pools and pools[-1][0] > pool[0]:
            before, more, count = pools.pop()
            total = more + pool[1]
            pool = ((before * more + pool[0] * pool[1]) / total, total, count + pool[2])
        pools.append(pool)
    return np.repeat([mean for mean, _, _ in pools], [count for _, _, count in pools])


def smoothed(history: History) -> FloatArray:
    """Return levels without noise: the better of the two monotone fits, then means of five neighbours."""
    least = 0.1 * float(np.median(history.sd))
    weight = 1.0 / np.maximum(history.sd / least, 1.0) ** 2 if least > 0.0 else np.ones(len(history))
    fits = [-monotone(-history.value, weight), monotone(history.value, weight)]
    errors = [float(weight @ (fit - history.value) ** 2) for fit in fits]
    best = fits[int(np.argmin(errors))]
    if len(best) < NEIGHBOURS:
        return best
    padded = np.pad(best, NEIGHBOURS // 2, mode="reflect", reflect_type="odd")
    mean: FloatArray = np.convolve(padded, np.full(NEIGHBOURS, 1.0 / NEIGHBOURS), mode="valid")
    return mean
