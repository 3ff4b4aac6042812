"""What is kept of a stretch of samples, and the sliding windows made of it.

    gram = [e ψ]'[e ψ]   (1+c, 1+c)        moment = [e ψ]'U   (1+c, r)

of adjacent stretches merge associatively and are never subtracted: first.gram + second.gram and first.moment
+ second.moment Π. Hops are grouped by GROUP; a window of F hops is a suffix of one group, whole groups (the
same problem, a group being a hop) and a prefix of another: fewer than five merges a hop for any F (van Herk,
Pattern Recognition Letters 13 (1992) 517; Tangwongsan, Hirzel, Schneider, Wu, VLDB 2015). Groups are counted
from the first hop, so that windows do not depend on how hops arrive.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.numerics.window.filtering.products import row_products
from agent.numerics.window.tuning import GROUP
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Summary:
    """N stretches of equal length: gram (N, 1+c, 1+c) and moment (N, 1+c, r)."""

    gram: FloatArray
    moment: FloatArray

    def __len__(self) -> int:
        return len(self.gram)

    def part(self, which: slice) -> "Summary":
        """Return some of the stretches."""
        return Summary(self.gram[which], self.moment[which])

    def merged(self, later: "Summary", over: FloatArray) -> "Summary":
        """Return each stretch followed at once by `later`; `over` is Π (r, r) of self."""
        return Summary(self.gram + later.gram, self.moment + row_products(later.moment, over))

    def followed(self, later: "Summary") -> "Summary":
        """Append stretches in time."""
        return Summary(np.concatenate([self.gram, later.gram]), np.concatenate([self.moment, later.moment]))


Kind = tuple[int, int]
"""Windows of so many hops, of which each so-manieth is wanted: those that end at hops every-1, 2 every-1, ..
counted from the first hop. `every` divides GROUP."""


class Sliding:
    """Windows of several kinds over a stream of hops.

    Args:
        kinds: hops in each window, at least 1, and how many of them are wanted.
        step: Π of a hop, (r, r).
    """

    def __init__(self, kinds: Sequence[Kind], step: FloatArray) -> None:
        short = [kind for kind in kinds if kind[0] < GROUP]
        long = [kind for kind in kinds if kind[0] >= GROUP]
        self._short = _Doubling(short, step) if short else None
        self._long = _Grouped(long, step) if long else None

    def append(self, hops: Summary) -> dict[Kind, Summary]:
        """Take the next hops; return for each kind the whole windows that end at these hops."""
        windows = self._short.append(hops) if self._short else {}
        return windows | (self._long.append(hops) if self._long else {})


class _Doubling:
    """Windows of fewer than GROUP hops: 1, 2 and 4 hops by doubling, and their sums."""

    def __init__(self, kinds: Sequence[Kind], step: FloatArray) -> None:
        self.kinds = tuple(kinds)
        self.longest = max(count for count, _ in kinds)
        self.powers = _powers(step, GROUP)
        self.hops = 0
        self.kept: Summary | None = None

    def append(self, hops: Summary) -> dict[Kind, Summary]:
        have = hops if self.kept is None else self.kept.followed(hops)
        self.kept = _newest(have, self.longest - 1)
        self.hops += len(hops)
        starts = {}
        for count, every in self.kinds:
            # of the hops at hand, the first at which a window ends
            first = max(len(have) - len(hops), count - 1)
            first += (every - 1 - (self.hops - len(have) + first)) % every
            if first < len(have):
                starts[count, every] = slice(first - count + 1, len(have) - count + 1, every)
        doubled = self._doubled(have) if starts else {}
        return {kind: self._windows(doubled, kind[0], which) for kind, which in starts.items()}

    def _doubled(self, have: Summary) -> dict[int, Summary]:
        """Return all windows of 1, 2 and 4 hops."""
        doubled = {1: have}
        size = 1
        while 2 * size <= min(self.longest, len(have)):
            one = doubled[size]
            later = one.part(slice(size, None))
            doubled[2 * size] = one.part(slice(0, len(one) - size)).merged(later, self.powers[size])
            size *= 2
        return doubled

    def _windows(self, doubled: dict[int, Summary], count: int, starts: slice) -> Summary:
        """Sum the pieces of the windows that start at some hops, the longest piece first."""
        total: Summary | None = None
        taken = 0
        for size in sorted((s for s in doubled if s & count), reverse=True):
            piece = doubled[size].part(slice(starts.start + taken, starts.stop + taken, starts.step))
            total = piece if total is None else total.merged(piece, self.powers[taken])
            taken += size
        if total is None:
            raise ValueError("a window of no hops has no summary")
        return total


class _Grouped:
    """Windows of at least GROUP hops: suffix, whole groups, prefix."""

    def __init__(self, kinds: Sequence[Kind], step: FloatArray) -> None:
        self.kinds = tuple(kinds)
        self.powers = _powers(step, GROUP)
        ends = [(count, k) for count, every in kinds for k in _phases(every)]
        wholes = {(count - k - 1) // GROUP for count, k in ends} - {0}
        self.before_prefix = {(F, k): np.linalg.matrix_power(step, F - k - 1) for F, k in ends}
        self.inner = Sliding([(w, 1) for w in sorted(wholes)], self.powers[GROUP]) if wholes else None
        self.groups_kept = max(wholes, default=0) + 1
        self.hops = 0
        self.open: Summary | None = None  # hops of the group that is not full
        self.prefix: Summary | None = None  # their sum
        self.suffixes: list[Summary] = []  # from hop k of each full group to its end
        self.middles: dict[int, Summary] = {}  # whole groups that end at the newest full groups

    def append(self, hops: Summary) -> dict[Kind, Summary]:
        arrived = _Arrived.of(hops, self.open)
        prefixes = self._prefixes(arrived)
        old = len(self.suffixes[0]) if self.suffixes else 0
        self._close(arrived, prefixes)
        self.hops += len(hops)
        ends = {kind: self._windows(kind, arrived, prefixes, old) for kind in self.kinds}
        self.open = arrived.open_hops()
        self.prefix = _newest(prefixes[len(self.open) - 1], 1) if self.open else None
        if arrived.full:
            self.suffixes = [_newest(suffix, self.groups_kept) for suffix in self.suffixes]
            self.middles = {w: _newest(middle, 1) for w, middle in self.middles.items()}
        return {kind: windows for kind, windows in ends.items() if windows is not None}

    def _prefixes(self, arrived: "_Arrived") -> list[Summary]:
        """Return each group from its first hop up to hop k, for every phase k that occurs.

        Where there is one group only, in the place of those that end before the new hops stands the newest.
        """
        goes_on = self.prefix if len(arrived.hops) <= GROUP else None
        prefixes = [goes_on] * arrived.before if goes_on else [arrived.phase(0)]
        for k in range(len(prefixes), min(GROUP, len(arrived.hops))):
            hop = arrived.phase(k)
            prefixes.append(prefixes[-1].part(slice(0, len(hop))).merged(hop, self.powers[k]))
        return prefixes

    def _close(self, arrived: "_Arrived", prefixes: list[Summary]) -> None:
        """Take the groups now full: their suffixes, and the windows of whole groups that end at them."""
        full = arrived.full
        if not full:
            return
        suffix = arrived.phase(GROUP - 1).part(slice(0, full))
        new = [suffix]
        for k in range(GROUP - 2, -1, -1):
            suffix = arrived.phase(k).part(slice(0, full)).merged(suffix, self.powers[1])
            new.insert(0, suffix)
        self.suffixes = _each_followed(self.suffixes, new)
        if self.inner:
            for (w, _), middle in self.inner.append(prefixes[-1].part(slice(0, full))).items():
                self.middles[w] = self.middles[w].followed(middle) if w in self.middles else middle

    def _windows(self, kind: Kind, arrived: "_Arrived", prefixes: list[Summary], old: int) -> Summary | None:
        """Return the windows of one kind; `old` groups were closed and kept before these hops arrived."""
        count, every = kind
        have = len(arrived.hops)
        first = max(arrived.before, have - self.hops + count - 1)  # of the hops at hand, where a window ends
        which = slice(first // every, have // every)
        if which.start >= which.stop:
            return None
        width, r = prefixes[0].moment.shape[1:]
        gram = np.empty((arrived.groups, GROUP // every, width, width))
        moment = np.empty((arrived.groups, GROUP // every, width, r))
        for place, k in enumerate(k for k in _phases(every) if k < len(prefixes)):
            groups = slice(-(-(first - k) // GROUP), -(-(have - k) // GROUP))
            if groups.start < groups.stop:
                window = self._window(count, k, prefixes[k].part(groups), groups, (arrived.full, old))
                if which.stop - which.start == 1:  # as nearly always while an agent runs
                    return window
                gram[groups, place], moment[groups, place] = window.gram, window.moment
        return Summary(gram.reshape(-1, width, width)[which], moment.reshape(-1, width, r)[which])

    def _window(self, count: int, k: int, prefix: Summary, groups: slice, closed: tuple[int, int]) -> Summary:
        """Return the windows that end at hop k of some groups; their prefixes are given."""
        w, x = divmod(count - k - 1, GROUP)
        full, old = closed
        merged: Summary = Summary(prefix.gram, row_products(prefix.moment, self.before_prefix[count, k]))
        if w:
            shift = len(self.middles[w]) - full - 1
            middle = self.middles[w].part(slice(groups.start + shift, groups.stop + shift))
            merged = Summary(
                middle.gram + merged.gram, row_products(middle.moment, self.powers[x]) + merged.moment
            )
        if x:
            shift = old - 1 - w
            suffix = self.suffixes[GROUP - x].part(slice(groups.start + shift, groups.stop + shift))
            merged = Summary(suffix.gram + merged.gram, suffix.moment + merged.moment)
        return merged


@dataclass(frozen=True, slots=True)
class _Arrived:
    """Hops laid out by groups: those of the open group before, then new ones; the last may not be full."""

    hops: Summary
    before: int

    @classmethod
    def of(cls, hops: Summary, open_hops: Summary | None) -> "_Arrived":
        if open_hops is None:
            return cls(hops, 0)
        return cls(open_hops.followed(hops), len(open_hops))

    @property
    def full(self) -> int:
        return len(self.hops) // GROUP

    @property
    def groups(self) -> int:
        return -(-len(self.hops) // GROUP)

    def phase(self, k: int) -> Summary:
        """Return hop k of each group that has one."""
        return self.hops.part(slice(k, None, GROUP))

    def open_hops(self) -> Summary | None:
        """Return the hops of the group that is not full."""
        count = len(self.hops) - self.full * GROUP
        return _newest(self.hops, count) if count else None


def _powers(step: FloatArray, count: int) -> list[FloatArray]:
    powers = [np.eye(len(step))]
    for _ in range(count):
        powers.append(step @ powers[-1])
    return powers


def _phases(every: int) -> range:
    """Return the places in a group at which wanted windows end."""
    return range(every - 1, GROUP, every)


def _newest(summary: Summary, count: int) -> Summary:
    """Return the newest stretches, copied so that the others are let go where there are any."""
    if len(summary) <= count:
        return summary
    which = slice(len(summary) - count, None)
    return Summary(summary.gram[which].copy(), summary.moment[which].copy())


def _each_followed(before: list[Summary], after: list[Summary]) -> list[Summary]:
    return [b.followed(a) for b, a in zip(before, after, strict=True)] if before else after
