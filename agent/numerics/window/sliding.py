"""Summaries of long sliding windows at a cost that does not grow with the window.

Hops are grouped into blocks of b. A window of F hops is a suffix of one block, whole blocks, and a prefix of another:

    moment = suffix + (Pi^x)' whole + (Pi^(x + c b))' prefix        x hops in the suffix, c whole blocks

Suffixes and prefixes cost one product a hop each, whole blocks are joined by doubling once a block, and nothing is
ever subtracted (the two stacks of Tangwongsan et al., VLDB 2015, with blocks in the place of flips, so that all hops
that arrive together are computed together).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.window.cells import Summary, joined, repeated, sliding
from agent.numerics.window.products import column_products

FloatArray = NDArray[np.float64]
SHORT = 16
"""Windows of fewer hops than this are joined by doubling alone."""


@dataclass(frozen=True, slots=True)
class Joins:
    """Constant matrices of the windows that end at hop k of a block, k = 0..b-1.

    Attributes:
        block, whole: hops a block, b; whole blocks c (b,).
        suffix: (b,) hops x in the suffix.
        powers: (b, nz, nz) transposed Pi^k.
        to_whole, to_prefix: (b, nz, nz) transposed Pi^x and Pi^(x + c b).
        one, window: Pi and GG of a block and of a window (gram and moment are of no use).
    """

    block: int
    whole: NDArray[np.int64]
    suffix: NDArray[np.int64]
    powers: FloatArray
    to_whole: FloatArray
    to_prefix: FloatArray
    one: Summary
    window: Summary


@dataclass(frozen=True, slots=True)
class Phases:
    """Summaries by phase, the place in a block: moment (b, nz, blocks, 1+q), gram (b, blocks, 1+q, 1+q)."""

    moment: FloatArray
    gram: FloatArray

    @classmethod
    def of(cls, hops: Summary, block: int, blocks: int) -> "Phases":
        """Lay hops out by phase, with nothing where the last block is not full."""
        count, width = hops.gram.shape[:2]
        nz = len(hops.moment)
        moment, gram = np.zeros((nz, blocks * block, width)), np.zeros((blocks * block, width, width))
        moment[:, :count], gram[:count] = hops.moment, hops.gram
        return cls(
            np.ascontiguousarray(moment.reshape(nz, blocks, block, width).transpose(2, 0, 1, 3)),
            gram.reshape(blocks, block, width, width).swapaxes(0, 1),
        )

    def in_order(self, which: slice, constants: Summary) -> Summary:
        """Return some of the hops' summaries in order of time."""
        b, nz, blocks, width = self.moment.shape
        moment = self.moment.transpose(1, 2, 0, 3).reshape(nz, blocks * b, width)[:, which]
        gram = self.gram.swapaxes(0, 1).reshape(blocks * b, width, width)[which]
        return Summary(gram, moment, constants.Pi, constants.GG)

    def followed_by(self, later: "Phases") -> "Phases":
        """Append blocks in time."""
        return Phases(
            np.concatenate([self.moment, later.moment], axis=2), np.concatenate([self.gram, later.gram], axis=1)
        )

    def part(self, which: slice) -> "Phases":
        """Return some of the blocks."""
        return Phases(self.moment[:, :, which], self.gram[:, which])


@dataclass(frozen=True, slots=True)
class Kept:
    """What must be kept of the hops so far to slide on.

    Attributes:
        hops: (short windows) the newest hops, at most F - 1; (long ones) those of the block that is not full yet.
        blocks: (long windows) summaries of whole blocks.
        suffixes: (long windows) of those blocks, from each of their hops on.
        joins: (long windows) how pieces are put together.
    """

    hops: Summary | None = None
    blocks: Summary | None = None
    suffixes: Phases | None = None
    joins: Joins | None = None


def slide(kept: Kept, hops: Summary, count: int) -> tuple[Kept, Summary | None]:
    """Take the next hops; return what to keep and the windows of `count` hops that end at the newest of them.

    There are as many windows as hops, fewer while there are not enough hops before, None when there is none.
    """
    if count >= SHORT:
        return _slide_blocks(kept, hops, count)
    have = hops if kept.hops is None else joined(kept.hops, hops)
    have = have.part(slice(max(0, len(have) - len(hops) - count + 1), None))
    windows = sliding(have, count) if len(have) >= count else None
    return Kept(have.part(slice(max(0, len(have) - count + 1), None))), windows


def _joins(hop: Summary, count: int) -> Joins:
    block = 4 if count < 32 else 8 if count < 128 else 32
    before = count - 1 - np.arange(block)  # hops of the window before the prefix
    whole = -(-before // block) - 1
    suffix = before - whole * block
    powers = [np.eye(len(hop.Pi))]
    for _ in range(block):
        powers.append(hop.Pi @ powers[-1])
    over = {c: np.linalg.matrix_power(powers[block], c) for c in set(whole.tolist())}
    to_whole = np.stack([powers[x].T for x in suffix])
    to_prefix = np.stack([(over[c] @ powers[x]).T for c, x in zip(whole.tolist(), suffix, strict=True)])
    transposed = np.stack([power.T for power in powers[:block]])
    return Joins(
        block, whole, suffix, transposed, to_whole, to_prefix, repeated(hop, block), repeated(hop, count)
    )  # fmt: skip


def _slide_blocks(kept: Kept, hops: Summary, count: int) -> tuple[Kept, Summary | None]:
    joins = kept.joins or _joins(hops, count)
    have = hops if kept.hops is None else joined(kept.hops, hops)
    whole = len(have) // joins.block
    prefixes = _prefixes(joins, have)
    blocks = Summary(prefixes.gram[-1, :whole], prefixes.moment[-1, :, :whole], joins.one.Pi, joins.one.GG)
    suffixes = _suffixes(joins, have, whole)
    if kept.blocks is not None and kept.suffixes is not None:
        blocks, suffixes = joined(kept.blocks, blocks), kept.suffixes.followed_by(suffixes)
    before = len(blocks) - whole
    available = min(len(hops), before * joins.block + len(have) - count + 1)
    windows = None
    if available > 0:
        windows = _windows(joins, prefixes, suffixes, blocks, before, slice(len(have) - available, len(have)))
    newest = slice(max(0, len(blocks) - int(joins.whole[0]) - 1), None)
    left = have.part(slice(whole * joins.block, None))
    return Kept(left, blocks.part(newest), suffixes.part(newest), joins), windows


def _prefixes(joins: Joins, hops: Summary) -> Phases:
    """Prefixes of the blocks into which hops fall, the last of them perhaps not full."""
    phases = Phases.of(hops, joins.block, -(-len(hops) // joins.block))
    moment, gram = _product(joins.powers, phases.moment), phases.gram.copy()
    for k in range(1, joins.block):
        moment[k] += moment[k - 1]
        gram[k] += gram[k - 1]
    return Phases(moment, gram)


def _suffixes(joins: Joins, hops: Summary, whole: int) -> Phases:
    """From each hop of the whole blocks to the end of its block."""
    phases = Phases.of(hops.part(slice(0, whole * joins.block)), joins.block, whole)
    moment, gram = phases.moment, phases.gram.copy()
    carry = joins.powers[1]
    for k in range(joins.block - 2, -1, -1):
        moment[k] += column_products(carry, moment[k + 1].reshape(len(carry), -1)).reshape(moment[k].shape)
        gram[k] += gram[k + 1]
    return Phases(moment, gram)


def _product(matrices: FloatArray, moment: FloatArray) -> FloatArray:
    """Multiply (b, nz, nz) by moments (b, nz, blocks, 1+q), one matrix a phase."""
    flat = moment.reshape(*moment.shape[:2], -1)
    return np.stack([column_products(*pair) for pair in zip(matrices, flat, strict=True)]).reshape(moment.shape)


def _windows(joins: Joins, prefixes: Phases, suffixes: Phases, blocks: Summary, before: int, which: slice) -> Summary:
    """Put suffix, whole blocks and prefix together; `before` blocks came before the first of the prefixes'."""
    sums = _sums(blocks, sorted(set(joins.whole.tolist())))
    whole, start = np.zeros_like(prefixes.moment), np.zeros_like(prefixes.moment)
    gram = prefixes.gram.copy()
    count = gram.shape[1]
    for k, (c, x) in enumerate(zip(joins.whole.tolist(), joins.suffix.tolist(), strict=True)):
        first = max(0, c + 1 - before)
        if first < count:
            at, suffix = slice(before + first - c, before + count - c), joins.block - x
            ahead = slice(at.start - 1, at.stop - 1)
            whole[k, :, first:], start[k, :, first:] = sums[c].moment[:, at], suffixes.moment[suffix, :, ahead]
            gram[k, first:] += sums[c].gram[at] + suffixes.gram[suffix, ahead]
    moment = start + _product(joins.to_whole, whole) + _product(joins.to_prefix, prefixes.moment)
    return Phases(moment, gram).in_order(which, joins.window)


def _sums(blocks: Summary, counts: list[int]) -> dict[int, Summary]:
    """Sums of c consecutive blocks for the two values that c takes, those that there are enough blocks for."""
    return {c: sliding(blocks, c) for c in counts if c <= len(blocks)}
