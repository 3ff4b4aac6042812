"""The bank over a stream of samples: rows each hop, bounded memory."""

from collections.abc import Sequence

import numpy as np

from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.eliminated import Scanning, Solving
from agent.numerics.window.filtering.course import Course
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import NoiseModel, Push
from agent.numerics.window.filtering.summary import Kind, Sliding, Summary
from agent.numerics.window.jump import Jumps
from agent.numerics.window.losses import Losses
from agent.numerics.window.lost import Lost, Taps
from agent.numerics.window.operators import Operators
from agent.numerics.window.rows import BankRows, Windowed
from agent.numerics.window.solve import Solved, Starts
from agent.numerics.window.tail import Tail
from agent.numerics.window.tuning import BATCH, RENEWED, SPARE
from agent.types import FloatArray, IntArray


class Stream:
    """Rows of windows over samples that arrive in any portions, the same to the last bit for any portioning.

    The mean of a free mass runs away from what is measured. It is started anew now and then, at the best
    state of the newest longest window: that window's samples are run again, after which everything is as if
    the stream had begun there, and no window has two parts.

    Args:
        model, push, noise: see `Operators`.
        plan: hop and window.
        longer: whole hops before the head in each further, longer window.
        interest: number of the model's first parameters that are of interest (the others are constants of the
            rig); all of them if None.
        taps: where a lost reading of each channel enters; each of its own column if None.
    """

    def __init__(
        self, model: StateSpace, push: Push, noise: NoiseModel, plan: HopPlan, longer: Sequence[int] = (),
        interest: int | None = None, taps: Taps | None = None,
    ) -> None:  # fmt: skip
        self.plan = plan
        self._losses = Losses(taps or [[(0, column, 1.0)] for column in range(model.p + model.m)])
        interest = model.q if interest is None else interest
        self.operators = Operators(model, push, noise, plan, longer, interest)
        self.start_segment(0)

    def start_segment(self, index: int, given: int = -1) -> None:
        """Begin an uninterrupted stretch with first sample number `index`; windows do not reach back over it.

        Rows up to sample `given` are not given.
        """
        self._given = given
        size = self.operators.size
        first_hop = -(-index // self.plan.hop)
        self._samples = Tail(first_hop * self.plan.hop, np.empty((0, size.p + size.m)))
        self._losses.forget(self._samples.first, self._samples.first)
        self._begin(first_hop, np.zeros(size.z))

    def append(self, index: int, v: FloatArray, lost: Lost | None = None) -> None:
        """Take outputs and inputs v (N, p+m), the first of them number `index`; lost: those filled in.

        Raises:
            ValueError: they do not follow at once on the samples before.
        """
        end = self._samples.stop
        begins = end == self._samples.first
        skipped = max(0, end - index) if begins else 0
        if index + skipped != end:
            raise ValueError(f"sample {index} does not follow on {end - 1}: start a segment there")
        self._samples.append(v[skipped:])
        if lost is not None and len(lost):
            self._losses.append(lost)

    def next(self) -> BankRows | None:
        """Return the next rows that have fallen due; None where more samples must come first."""
        while units := self._ready():
            rows = self._advance(units)
            if rows is not None:
                return rows
        return None

    def samples(self, start: int, stop: int) -> FloatArray:
        """Return kept samples [start, stop), (N, p+m)."""
        return self._samples.part(start, stop)

    def _begin(self, hop: int, z: FloatArray) -> None:
        """Run the filters from the start of a hop on, with state z (nz,)."""
        self._course = Course.at(z)
        self._head: Summary | None = None
        self._done = hop * self.plan.hop
        self._began = hop
        self._states = Tail(hop, np.empty((0, len(z))))  # at the starts of hops
        self._sliding = _sliding(self.operators)
        self._losses.begin(self.operators)
        self._newest_columns: tuple[tuple[int, int], FloatArray] | None = None
        self._best = np.zeros(self.operators.size.n)  # physical state where the newest longest window starts

    def _ready(self) -> int:
        """Return how many rows can be computed at once from the samples that wait."""
        waiting = self._samples.stop - self._done
        if self._head is None:
            return int(waiting >= self.plan.head)
        units = min(waiting // self.plan.hop, BATCH)
        return units if self.operators.decays else min(units, self._until_renewal())

    def _until_renewal(self) -> int:
        longest = self.operators.longest + 1
        return self._began + (1 + RENEWED) * longest - self._done // self.plan.hop

    def _advance(self, units: int) -> BankRows | None:
        """Summarise the next rows' samples; return the rows that were not given before."""
        heads, rests = self._first_head() if self._head is None else self._units(units)
        index = self._done - self.plan.hop * np.arange(units - 1, -1, -1, dtype=np.int64) - 1
        before = self._head
        windows = self._windows(heads, rests)
        fresh = int(np.count_nonzero(index > self._given))
        solving = self._solving(index[units - fresh :], windows)
        completed = _completed(before, heads, rests, self.operators)
        self._losses.eliminate(int(index[0]) // self.plan.hop, (completed, heads), solving, self._over)
        rows = BankRows(index[units - fresh :], tuple(_row(one) for one in solving)) if fresh else None
        self._given = max(self._given, int(index[-1]))
        self._trim()
        if not self.operators.decays and self._until_renewal() <= 0:
            self._renew()
        return rows

    def _first_head(self) -> tuple[Summary, Summary | None]:
        filters = self.operators.filters
        v = self.samples(self._done, self._done + self.plan.head)[None]
        states = filters.through(filters.head, v, self._course.start[None])
        self._states.append(states[0])
        self._course = Course.at(states[-1][0])
        self._done += self.plan.head
        return self.operators.summarise(filters.head, v, states), None

    def _units(self, units: int) -> tuple[Summary, Summary | None]:
        """Return the summaries of the next heads, and of the rests before them."""
        plan, filters = self.plan, self.operators.filters
        v = self.samples(self._done, self._done + units * plan.hop).reshape(units, plan.hop, -1)
        states, self._course = filters.over(v, self._course)
        cells = len(filters.rest)
        rests = self.operators.summarise(filters.rest, v[:, : plan.rest], states) if plan.rest else None
        heads = self.operators.summarise(filters.head, v[:, plan.rest :], states[cells:])
        self._states.append(states[cells])
        self._done += units * plan.hop
        return heads, rests

    def _windows(self, heads: Summary, rests: Summary | None) -> dict[Kind, Summary]:
        """Return for each kind of window (whole hops, every) those that end at the newest rows."""
        before, self._head = self._head, heads.part(slice(len(heads) - 1, None))
        if not self.plan.rest:
            return {(count - 1, every): slid for (count, every), slid in self._sliding.append(heads).items()}
        if before is None or rests is None:
            return {(0, 1): heads}
        finished = before.followed(heads.part(slice(0, len(heads) - 1)))
        wholes = finished.merged(rests, self.operators.basis.steps[0])
        windows = {(0, 1): heads, (0, self.operators.every): heads.part(self._scanned(len(heads)))}
        for (count, every), slid in self._sliding.append(wholes).items():
            last = heads if every == 1 else windows[0, every]
            windows[count, every] = slid.merged(_newest(last, len(slid)), self.operators.over[count])
        return windows

    def _scanned(self, count: int) -> slice:
        """Return which of the newest `count` rows are scanned for a jump."""
        every = self.operators.every
        hops = (
            self._states.stop - self._began - (1 if self.plan.rest else 0)
        )  # that the windows have slid over
        return slice((every - 1 - (hops - count)) % every, None, every)

    def _solving(self, index: IntArray, windows: dict[Kind, Summary]) -> list[Solving | None]:
        lengths = enumerate(self.operators.lengths)
        return [self._solved(k, fulls, index, windows) if len(index) else None for k, fulls in lengths]

    def _solved(self, k: int, fulls: int, index: IntArray, windows: dict[Kind, Summary]) -> Solving | None:
        """Solve the newest windows of one length, as many as are whole."""
        if (fulls, 1) not in windows:
            return None
        summary = _newest(windows[fulls, 1], len(index))
        count = len(summary)
        starts = self._starts(fulls, count)
        solved = self.operators.solvers[k].solve(summary, starts)
        if fulls == self.operators.longest:
            self._best = solved.normal.x0[-1].copy()
        index = index[len(index) - count :]
        scanned = self._scanning(solved, windows, starts, index) if k == 0 else None
        return Solving(self.operators, k, index, summary, starts, solved, scanned)

    def _scanning(
        self, solved: Solved, windows: dict[Kind, Summary], starts: Starts, index: IntArray
    ) -> Scanning | None:
        """Return the columns of a jump in those windows that are scanned, and what they are made of."""
        scan, rights, every = self.operators.scan, self.operators.rights, self.operators.every
        count = len(index)
        which = self._scanned(count)
        scanned = index[which]
        if scan is None or not len(scanned):
            return None
        parts = [_newest(windows[right, every], len(scanned)) for right in rights]
        ats = [self._starts(right, count).part(which) for right in rights]
        cross, own = scan.columns(solved.part(which), parts, starts.part(which), ats)
        samples = tuple(self.plan.samples(right) for right in rights)
        return Scanning(Jumps(scanned, cross.swapaxes(0, 1), own.swapaxes(0, 1), samples), parts, ats)

    def _over(self, hop: int, stop: int) -> FloatArray:
        """Return [e ψ] of a hop's samples up to `stop`; the newest are at hand."""
        if self._newest_columns is None or self._newest_columns[0] != (hop, stop):
            v = self.samples(hop * self.plan.hop, stop)
            state = self._states.part(hop, hop + 1)[0]
            self._newest_columns = ((hop, stop), self.operators.columns(v, state))
        return self._newest_columns[1]

    def _starts(self, fulls: int, count: int) -> Starts:
        """Return the filter states so many whole hops before the newest `count` rows' heads."""
        stop = self._states.stop - fulls
        return Starts.of(self._states.part(stop - count, stop), self.operators.size)

    def _trim(self) -> None:
        """Let go of samples and states that no window will start at."""
        keep = self.operators.longest + 1
        oldest = self._states.stop - keep
        spare = (oldest - self._states.first) * self.plan.hop
        waiting = self._samples.stop - self._done  # what is kept is copied: seldom, where much is
        if spare > max(SPARE + keep * self.plan.hop, waiting):
            self._states.forget(oldest)
            self._samples.forget(oldest * self.plan.hop)
            self._losses.forget(oldest * self.plan.hop, self._samples.stop)

    def _renew(self) -> None:
        """Start mean and predictor anew at the best state of the newest longest window."""
        hop = self._states.stop - 1 - self.operators.longest
        size = self.operators.size
        z = np.zeros(size.z)
        z[: size.n] = z[size.n : 2 * size.n] = self._best
        self._begin(hop, z)


def _sliding(operators: Operators) -> Sliding:
    """Return the windows of whole hops that rows and the scan for a jump need."""
    kinds = sorted(
        {
            *((fulls, 1) for fulls in operators.lengths),
            *((right, operators.every) for right in operators.rights),
        }
    )
    if not operators.plan.rest:
        return Sliding([(fulls + 1, every) for fulls, every in kinds], operators.basis.steps[2])
    return Sliding([kind for kind in kinds if kind[0]], operators.basis.steps[2])


def _row(solving: Solving | None) -> Windowed | None:
    return None if solving is None else solving.windowed()


def _completed(
    before: Summary | None, heads: Summary, rests: Summary | None, operators: Operators
) -> Summary | None:
    """Return the hop before each of the newest heads; None before the first."""
    if before is None:
        return None
    finished = before.followed(heads.part(slice(0, len(heads) - 1)))
    return finished if rests is None else finished.merged(rests, operators.basis.steps[0])


def _newest(summary: Summary, count: int) -> Summary:
    return summary.part(slice(max(0, len(summary) - count), None))
