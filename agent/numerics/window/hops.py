"""One uninterrupted stretch of samples, summarised hop by hop, and the windows that end at each.

The hop grid counts from sample 0 of the run: windows start at multiples of H. A hop has a head of `a` samples (the
last hop of a window is taken only that far) and a rest; a window is F whole hops and the head of the next one. Cells
are fixed pieces of heads and rests, so results do not depend on how the stream was cut on arrival.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.sensitivity import SensitivityFilter
from agent.numerics.window.cells import CellOperator, Summary, cell_operators, joined, merge, summarise_cells
from agent.numerics.window.course import Course
from agent.numerics.window.sliding import Kept, slide

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
CELL_TARGET = 28
"""Samples a cell: longer wastes the empty half of the triangular products, shorter wastes calls."""


def divide(length: int) -> list[int]:
    """Cut a stretch into nearly equal cells of about CELL_TARGET samples."""
    if not length:
        return []
    parts = max(1, round(length / CELL_TARGET))
    return [length // parts + (i < length % parts) for i in range(parts)]


@dataclass(frozen=True, slots=True)
class HopPlan:
    """How samples fall into hops: `window` W and `hop` H samples."""

    window: int
    hop: int

    @property
    def head(self) -> int:
        """Samples of a window in its last hop, 1..H."""
        return self.window % self.hop or self.hop

    @property
    def fulls(self) -> int:
        """Whole hops in a window before its last one."""
        return (self.window - self.head) // self.hop

    def rows_between(self, start: int, stop: int) -> IntArray:
        """Return the sample indices in [start, stop) at which rows fall due."""
        return np.arange(start + (self.head - 1 - start) % self.hop, stop, self.hop, dtype=np.int64)


class HopOperators:
    """The lifted filters of a hop's head and rest, for one theta_r and gain."""

    def __init__(self, system: SensitivityFilter, plan: HopPlan) -> None:
        self.head = divide(plan.head)
        self.rest = divide(plan.hop - plan.head)
        self.cells: dict[int, CellOperator] = cell_operators(system, [*self.head, *self.rest])
        self.nz = len(system.F)
        self.n = system.n
        self.hop_transition = np.linalg.matrix_power(system.F, plan.hop)

    def forced(self, v: FloatArray) -> FloatArray:
        """Return the states (N, nz) that rest and head v (N, H, p+m) leave when started from zero."""
        state = np.zeros((len(v), self.nz))
        start = 0
        for length in (*self.rest, *self.head):
            cell = self.cells[length]
            inputs = v[:, start : start + length].reshape(len(v), -1)
            state = cell.after(inputs, state)
            start += length
        return state

    def summarise(self, lengths: list[int], v: FloatArray, z: FloatArray) -> tuple[Summary, FloatArray]:
        """Return the summaries of N stretches v (N, L, p+m) from states z (N, nz), and the states at their ends."""
        total: Summary | None = None
        start = 0
        for length in lengths:
            cell = self.cells[length]
            inputs = v[:, start : start + length].reshape(len(v), -1)
            piece = summarise_cells(cell, inputs, z)
            z = cell.after(inputs, z)
            total = piece if total is None else merge(total, piece)
            start += length
        if total is None:
            raise ValueError("a stretch without samples has no summary")
        return total, z


class Segment:
    """Samples of one uninterrupted stretch and the summaries of its hops.

    Args:
        plan: the hop and the window that rows are made of.
        index: number of the first sample that will be appended.
        width: channels.
        more: whole hops before the head in each further, longer window; `longer` holds the newest summaries of those,
            None for each that is not whole yet.
    """

    def __init__(self, plan: HopPlan, index: int, width: int, more: Sequence[int] = ()) -> None:
        self.plan = plan
        self.more = tuple(more)
        self._kept_more = [Kept() for _ in self.more]
        self.longer: list[Summary | None] = [None for _ in self.more]
        self.first = -(-index // plan.hop) * plan.hop
        self.done = self.first
        self.v: FloatArray = np.zeros((0, width))
        self.z: Course | None = None
        self.kept = Kept()
        self.head: Summary | None = None

    def append(self, index: int, v: FloatArray) -> None:
        """Take samples v (N, p+m), the first of them number `index`, directly after those before."""
        skipped = max(0, self.first + len(self.v) - index)
        self.v = np.concatenate([self.v, v[skipped:]])

    def samples(self, start: int, stop: int) -> FloatArray:
        """Return the kept samples [start, stop)."""
        return self.v[start - self.first : stop - self.first]

    def trim(self, keep: int) -> None:
        """Forget samples older than `keep` before the newest summarised, now and then."""
        spare = self.done - keep - self.first
        if spare > keep + 4096:
            self.v = self.v[spare:].copy()
            self.first += spare

    def ready(self) -> int:
        """Return how many rows can be computed from the samples that wait."""
        waiting = self.first + len(self.v) - self.done
        if self.head is None:
            return int(waiting >= self.plan.head)
        return waiting // self.plan.hop

    def restart(self, start: int, z: FloatArray) -> None:
        """Begin again at sample `start` with filter state z (nz,): the summaries belong to other operators."""
        self.head = None
        self.kept = Kept()
        self._kept_more = [Kept() for _ in self.more]
        self.done, self.z = start, Course.at(z)

    def kept_summaries(self) -> Callable[[], None]:
        """Return what puts the summaries back as they are now."""
        before = (self.done, self.z, self.kept, self.head, list(self._kept_more), list(self.longer))

        def restore() -> None:
            self.done, self.z, self.kept, self.head, self._kept_more, self.longer = before

        return restore

    def advance(self, operators: HopOperators, units: int) -> tuple[IntArray, Summary | None]:
        """Summarise the next rows' samples; return the rows' indices and the windows that end there, if whole."""
        if self.head is None:
            return self._first_head(operators)
        plan = self.plan
        v = self.samples(self.done, self.done + units * plan.hop).reshape(units, plan.hop, -1)
        states, self.z = self._course(operators).over(operators.hop_transition, operators.forced(v))
        split = plan.hop - plan.head
        rest: Summary | None = None
        if split:
            rest, states = operators.summarise(operators.rest, v[:, :split], states)
        heads, _ = operators.summarise(operators.head, v[:, split:], states)
        finished = joined(self.head, heads.part(slice(0, -1)))
        whole = finished if rest is None else merge(finished, rest)
        windows = self._windows(whole, heads)
        for i, fulls in enumerate(self.more):
            self._kept_more[i], slid = slide(self._kept_more[i], whole, fulls)
            self.longer[i] = None if slid is None else _with_heads(slid, heads)
        self.head = heads.part(slice(-1, None))
        index = self.done + plan.hop * np.arange(1, units + 1, dtype=np.int64) - 1
        self.done += units * plan.hop
        return index, windows

    def _first_head(self, operators: HopOperators) -> tuple[IntArray, Summary | None]:
        v = self.samples(self.done, self.done + self.plan.head)
        self.longer = [None for _ in self.more]
        self.head, ends = operators.summarise(operators.head, v[None], self._course(operators).start[None])
        self.z = Course.at(ends[0])
        self.done += self.plan.head
        return np.array([self.done - 1], dtype=np.int64), self.head if self.plan.fulls == 0 else None

    def _course(self, operators: HopOperators) -> Course:
        """The filters' state after the newest sample summarised; zero before the first."""
        return Course.at(np.zeros(operators.nz)) if self.z is None else self.z

    def _windows(self, finished: Summary, heads: Summary) -> Summary | None:
        """Join whole hops and a head into windows, for as many of the newest rows as there are enough hops."""
        if not self.plan.fulls:
            return heads
        self.kept, slid = slide(self.kept, finished, self.plan.fulls)
        return None if slid is None else _with_heads(slid, heads)


def _with_heads(slid: Summary, heads: Summary) -> Summary:
    """Put the newest hops' heads behind as many runs of whole hops."""
    return merge(slid, heads.part(slice(len(heads) - len(slid), None)))
