"""The product's estimator: sliding-window maximum likelihood in observer form, with its policy of change.

Samples go in, one row of estimates comes out a hop. Between re-centrings a row is one exact projected Gauss-Newton
step about theta_r from block summaries; the policy decides when a window straddles a change, when theta_r is moved by
an iterated fit, and what a row may be called.

The hop grid counts from sample 0 of the run: windows start at multiples of H and rows come at the end of each, so a
hop has a head of `a` samples (the end of a window) and a rest: a window is F whole hops and the head of the next.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.numerics.cells import (
    CellOperator,
    Summary,
    cell_operators,
    merge,
    propagate,
    sliding,
    summarise_cells,
)
from agent.numerics.fit import Fit, Problem, fit_window
from agent.numerics.sensitivity import sensitivity_filter
from agent.numerics.statespace import Discrete, Hold, Model, discretise
from agent.numerics.window import solve_windows

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
CELL_TARGET = 28
UNITS_MIN, UNITS_MAX = 32, 1024
"""Hops computed at once: few after a re-centring (which throws the rest of them away), more while nothing happens."""


@dataclass(frozen=True, slots=True)
class Gains:
    """How the observer is set: before the first fit, and about a fitted model."""

    start: Callable[[Discrete], FloatArray]
    settled: Callable[[Discrete], FloatArray]


@dataclass(frozen=True, slots=True)
class WindowSettings:
    """What `WindowML` is told.

    Attributes:
        period_s: sampling period, s.
        window, hop: W and H, samples.
        hold: how the input runs between samples.
        gains: the observer's gains.
        sigma: (p,) standard deviation of each output's noise where known, NaN where it is to be learnt.
        floor: (p,) standard deviation that the wire's resolution alone causes.
        scale: (q,) size of each parameter, |nominal| or what stands for it.
        lower: (q,) bounds from below.
        enough_sd: (q,) sd above which a window cannot judge a parameter ("unexcited").
    """

    period_s: float
    window: int
    hop: int
    hold: Hold
    gains: Gains
    sigma: FloatArray
    floor: FloatArray
    scale: FloatArray
    lower: FloatArray
    enough_sd: FloatArray


@dataclass(frozen=True, slots=True)
class Rows:
    """Estimates at N hops.

    Attributes:
        index: (N,) newest sample of each window, counted from the run's first.
        theta, sd: (N, q); NaN while warming.
        dof: (N,) degrees of freedom of the residual variance.
        full: (N,) a whole window was there.
        changing, mismatch: (N,) the window's residual fails the gate: since less than a window, or for longer.
        ratio: (N,) residual variance over the reference.
    """

    index: NDArray[np.int64]
    theta: FloatArray
    sd: FloatArray
    dof: FloatArray
    full: BoolArray
    changing: BoolArray
    mismatch: BoolArray
    ratio: FloatArray


@dataclass(slots=True)
class _Operators:
    """Everything that depends on theta_r and the gain: lifted cells of the head and of the rest of a hop."""

    cells: dict[int, CellOperator]
    head: list[int]
    rest: list[int]

    def transition(self, lengths: list[int]) -> FloatArray:
        """F^L over consecutive cells."""
        total = np.eye(len(self.cells[self.head[0]].Pi))
        for length in lengths:
            total = self.cells[length].state_from_state @ total
        return total

    def forced(self, lengths: list[int], v: FloatArray) -> FloatArray:
        """State (N, nz) that inputs v (N, L, p+m) leave after consecutive cells, from state zero."""
        state = np.zeros((len(v), len(self.cells[self.head[0]].Pi)))
        start = 0
        for length in lengths:
            cell = self.cells[length]
            inputs = v[:, start : start + length].reshape(len(v), -1)
            state = state @ cell.state_from_state.T + inputs @ cell.state_from_inputs
            start += length
        return state

    def summarise(self, lengths: list[int], v: FloatArray, z: FloatArray) -> tuple[Summary, FloatArray]:
        """Summary of N stretches v (N, L, p+m) from states z (N, nz), and the states at their ends."""
        total: Summary | None = None
        start = 0
        for length in lengths:
            cell = self.cells[length]
            inputs = v[:, start : start + length].reshape(len(v), -1)
            piece = summarise_cells(cell, inputs, z)
            z = z @ cell.state_from_state.T + inputs @ cell.state_from_inputs
            total = piece if total is None else merge(total, piece)
            start += length
        assert total is not None
        return total, z


def _divide(length: int) -> list[int]:
    """Cut a stretch into nearly equal cells of about CELL_TARGET samples."""
    parts = max(1, round(length / CELL_TARGET))
    return [length // parts + (i < length % parts) for i in range(parts)]


def _joined(first: Summary | None, second: Summary) -> Summary:
    """Append stretches in time."""
    if first is None:
        return second
    return Summary(
        np.concatenate([first.gram, second.gram]),
        np.concatenate([first.moment, second.moment], axis=1),
        second.Pi,
        second.GG,
    )


@dataclass(slots=True)
class _Segment:
    """The state of filters and summaries in one uninterrupted stretch of samples."""

    start: int  # index of the first sample used, a multiple of the hop
    v: FloatArray  # samples from `first` on
    first: int
    done: int = 0  # index after the last sample summarised
    z: FloatArray = field(default_factory=lambda: np.zeros(0))
    fulls: Summary | None = None
    head: Summary | None = None
    anchored: bool = False


class WindowML:
    """Sliding-window maximum likelihood over a stream of samples; deterministic however the stream is cut."""

    def __init__(self, model: Model, settings: WindowSettings) -> None:
        self.model = model
        self.settings = settings
        self.theta = np.array(model.nominal, dtype=float)
        self.settled = False
        self.calibrated = bool(np.all(np.isfinite(settings.sigma)))
        self.sigma = np.where(np.isfinite(settings.sigma), settings.sigma, 1.0)
        self.recentred = 0
        self._a = settings.window % settings.hop or settings.hop
        self._F = (settings.window - self._a) // settings.hop
        self._units = UNITS_MIN
        self._onset: int | None = None
        self._last_fit = -(10**18)
        self._segment: _Segment | None = None
        self._rebuild()

    @property
    def rows_per_window(self) -> int:
        """Number of outputs in a window."""
        return self.settings.window * len(self.sigma)

    def sampled(self, theta: FloatArray) -> Discrete:
        """Return the sampled model at theta (q,)."""
        return discretise(self.model.continuous(theta), self.settings.period_s, self.settings.hold)

    def _rebuild(self) -> None:
        """Make gain and operators about theta_r."""
        discrete = self.sampled(self.theta)
        gains = self.settings.gains
        self.gain = (gains.settled if self.settled else gains.start)(discrete)
        system = sensitivity_filter(discrete.model, self.gain, 1.0 / self.sigma)
        head, rest = _divide(self._a), _divide(self.settings.hop - self._a) if self._a < self.settings.hop else []
        self._operators = _Operators(cell_operators(system, [*head, *rest]), head, rest)
        self._n, self._q = discrete.model.n, discrete.model.q

    def start_segment(self) -> None:
        """Forget the samples before a gap; what was learnt of the parameters stays."""
        self._segment = None
        self._onset = None

    def step(self, index: int, y: FloatArray, u: FloatArray) -> Rows:
        """Take consecutive samples y (N, p), u (N, m), the first of them number `index`; return the rows they end."""
        v = np.hstack([y, u])
        pieces: list[Rows] = []
        if self._segment is None:
            first = -(-index // self.settings.hop) * self.settings.hop
            self._segment = _Segment(start=first, v=np.zeros((0, v.shape[1])), first=first, done=first)
            pieces.append(self._warming(self._grid(index, min(first, index + len(v)))))
        segment = self._segment
        skipped = max(0, segment.first + len(segment.v) - index)
        segment.v = np.concatenate([segment.v, v[skipped:]])
        while self._ready():
            pieces.append(self._advance())
        self._trim()
        return _concatenated(pieces, self._q)

    def _grid(self, start: int, stop: int) -> NDArray[np.int64]:
        """Indices of rows in [start, stop)."""
        hop = self.settings.hop
        return np.arange(start + (self._a - 1 - start) % hop, stop, hop, dtype=np.int64)

    def _ready(self) -> int:
        """Number of units that can be summarised now: the segment's first head alone, then hop after hop."""
        segment = self._segment
        assert segment is not None
        waiting = segment.first + len(segment.v) - segment.done
        if segment.head is None:
            return int(waiting >= self._a)
        return min(waiting // self.settings.hop, self._units)

    def _samples(self, start: int, stop: int) -> FloatArray:
        segment = self._segment
        assert segment is not None
        return segment.v[start - segment.first : stop - segment.first]

    def _trim(self) -> None:
        """Keep a window and a hop of samples for the fits."""
        segment = self._segment
        if segment is None:
            return
        spare = segment.done - self.settings.window - self.settings.hop - segment.first
        if spare > self.settings.window + 4096:
            segment.v = segment.v[spare:].copy()
            segment.first += spare

    def _advance(self) -> Rows:
        """Summarise what is ready, judge each row, act at the first that asks for it, return the rows settled."""
        segment = self._segment
        assert segment is not None
        index, windows = self._summarise(self._ready())
        rows = self._rows(index, windows)
        taken = self._judge(rows)
        if taken < len(index):
            # a fit moved theta_r at row `taken`: what was summarised after it belongs to the old operators
            segment.done = int(index[taken]) + 1
            self._units = UNITS_MIN
            return _part(rows, slice(0, taken + 1))
        self._units = min(2 * self._units, UNITS_MAX)
        return rows

    def _summarise(self, units: int) -> tuple[NDArray[np.int64], Summary | None]:
        """Run the filters over the next units; return the rows' indices and the summaries of the windows that end there."""
        segment, hop, a = self._segment, self.settings.hop, self._a
        assert segment is not None
        if segment.head is None:
            segment.z = segment.z if len(segment.z) else np.zeros(self._n * (1 + self._q))
            v = self._samples(segment.done, segment.done + a)
            segment.head, z = self._operators.summarise(self._operators.head, v[None], segment.z[None])
            segment.z = z[0]
            segment.done += a
            index = np.array([segment.done - 1], dtype=np.int64)
            return index, segment.head if self._F == 0 else None
        v = self._samples(segment.done, segment.done + units * hop).reshape(units, hop, -1)
        operators = self._operators
        lengths = [*operators.rest, *operators.head]
        states, segment.z = propagate(segment.z, operators.transition(lengths), operators.forced(lengths, v))
        rest: Summary | None = None
        if operators.rest:
            rest, states = operators.summarise(operators.rest, v[:, : hop - a], states)
        heads, _ = operators.summarise(operators.head, v[:, hop - a :], states)
        previous = _joined(segment.head, heads.part(slice(0, -1)))
        segment.fulls = _joined(segment.fulls, previous if rest is None else merge(previous, rest))
        segment.head = heads.part(slice(-1, None))
        index = segment.done + hop * np.arange(1, units + 1, dtype=np.int64) - 1
        segment.done += units * hop
        return index, self._windows(segment, heads)

    def _windows(self, segment: _Segment, heads: Summary) -> Summary | None:
        """Join F whole hops and a head, for as many of the newest rows as there are enough hops."""
        if self._F == 0:
            return heads
        fulls = segment.fulls
        assert fulls is not None
        usable = min(len(fulls), self._F - 1 + len(heads))
        segment.fulls = fulls.part(slice(max(0, len(fulls) - self._F), None))
        if usable < self._F:
            return None
        slid = sliding(fulls.part(slice(len(fulls) - usable, None)), self._F)
        return merge(slid, heads.part(slice(len(heads) - len(slid), None)))

    def _warming(self, index: NDArray[np.int64]) -> Rows:
        shape = (len(index), self._q)
        nothing, no = np.full(shape, np.nan), np.zeros(len(index), dtype=bool)
        unknown = np.full(len(index), np.nan)
        return Rows(index, nothing, nothing.copy(), unknown, no, no.copy(), no.copy(), unknown.copy())

    def _rows(self, index: NDArray[np.int64], windows: Summary | None) -> Rows:
        """Turn the windows' summaries into rows; the gate's verdict comes later."""
        rows = self._warming(index)
        if windows is None:
            return rows
        count = len(windows)
        solution = solve_windows(windows, self._n)
        dof = float(self.rows_per_window - self._n - self._q)
        s2 = solution.residual / dof
        variance = np.einsum("nii->ni", solution.covariance) * np.maximum(s2, self._floor_ratio())[:, None]
        new = slice(len(index) - count, None)
        rows.theta[new] = np.where(np.isfinite(solution.delta), self.theta + solution.delta, np.nan)
        rows.sd[new] = np.sqrt(variance)
        rows.dof[new], rows.full[new], rows.ratio[new] = dof, True, s2
        return rows

    def _floor_ratio(self) -> float:
        """Least residual variance that the wire allows, in units of the reference."""
        return float(np.mean((self.settings.floor / self.sigma) ** 2))

    def _gate(self) -> float:
        """Largest residual variance ratio of an undisturbed window."""
        return 1.0 + 4.0 * np.sqrt(2.0 / (self.rows_per_window - self._n - self._q))

    def _judge(self, rows: Rows) -> int:
        """Set the gate's verdicts row by row; return the number of the row at which theta_r was moved, or their count."""
        passes = rows.ratio <= self._gate()
        away = self._away(rows) & passes[:, None]
        quiet = rows.ratio < 2.0 - self._gate()
        learns = ~np.isfinite(self.settings.sigma).all() & quiet
        eventful = rows.full & (~passes | away.any(axis=1) | learns)
        position, count = 0, len(rows.index)
        while position < count:
            if not (self._segment is not None and self._segment.anchored):
                ahead = np.flatnonzero(rows.full[position:])
            else:
                ahead = np.flatnonzero(eventful[position:])
                if self._onset is not None and (not len(ahead) or ahead[0] > 0):
                    self._onset = None  # the row at `position` passes: the disturbance is over
            if not len(ahead):
                return count
            if ahead[0] > 0:
                self._onset = None
            position += int(ahead[0])
            if self._act(rows, position, bool(passes[position])):
                return position
            position += 1
        return count

    def _away(self, rows: Rows) -> BoolArray:
        """(N, q) estimates so far from theta_r that the linearisation should move."""
        share = 0.005 if not self.gain.any() else 0.02
        change = np.abs(rows.theta - self.theta)
        known = rows.sd < self.settings.enough_sd
        size = np.maximum(np.abs(self.theta), 0.1 * self.settings.scale)
        return np.asarray(known & (change > 3 * rows.sd) & (change > share * size))

    def _act(self, rows: Rows, row: int, passes: bool) -> bool:
        """Mark one eventful row and try a fit where the policy calls for one; return whether theta_r was moved."""
        index = int(rows.index[row])
        window, hop = self.settings.window, self.settings.hop
        segment = self._segment
        assert segment is not None
        due = index - self._last_fit >= window // 4
        if not segment.anchored:
            if (due or self._onset is None) and self._fit(rows, row):
                return True
        elif passes:
            self._onset = None
            return due and self._fit(rows, row)
        if self._onset is None:
            self._onset = index
        clean = index - self._onset >= window - hop
        first_clean = index - self._onset < window
        if segment.anchored and clean and (due or first_clean) and self._fit(rows, row):
            self._onset = None
            return True
        excited = bool(np.any(rows.sd[row] < self.settings.enough_sd))
        lasting = index - self._onset >= window
        judged = not passes or excited
        rows.changing[row], rows.mismatch[row] = judged and not lasting, judged and lasting
        return False

    def _fit(self, rows: Rows, row: int) -> bool:
        """Fit the window of a row on its samples; if it passes the gate move theta_r there and redo the summaries."""
        index = int(rows.index[row])
        self._last_fit = index
        v = self._samples(index + 1 - self.settings.window, index + 1)
        fit = self._fit_calibrated(v) if not self.calibrated or self._too_quiet(rows, row) else self._maximise(v)
        if not fit.converged or not np.all(np.isfinite(fit.residual)):
            return False
        dof = float(self.rows_per_window - self._n - self._q)
        s2 = float(np.sum(fit.residual**2)) / dof
        sd = np.sqrt(np.diag(fit.covariance) * max(s2, self._floor_ratio()))
        if s2 > self._gate() or not np.all(sd < np.inf):
            return False
        self.theta, self.settled, self.recentred = fit.theta, True, self.recentred + 1
        self._rebuild()
        self._resummarise(index + 1 - self.settings.window, fit.x0)
        rows.theta[row], rows.sd[row], rows.ratio[row] = fit.theta, sd, s2
        rows.changing[row] = rows.mismatch[row] = False
        return True

    def _too_quiet(self, rows: Rows, row: int) -> bool:
        return bool(~np.isfinite(self.settings.sigma).all() and rows.ratio[row] < 2.0 - self._gate())

    def _maximise(self, v: FloatArray) -> Fit:
        s = self.settings
        problem = Problem(self.sampled, v, 1.0 / self.sigma, s.scale, s.lower)
        return fit_window(problem, self.theta, np.zeros(self._n), [s.gains.start, s.gains.settled])

    def _fit_calibrated(self, v: FloatArray) -> Fit:
        """Fit with unknown noise: the residual of each output sets its sigma, then the fit is done again."""
        known = np.isfinite(self.settings.sigma)
        before = self.sigma.copy()
        scale = np.std(v[:, : len(known)], axis=0)
        self.sigma = np.where(known, self.settings.sigma, np.maximum(scale, np.max(scale) * 1e-6) * 1e-4 + 1e-300)
        fit = self._maximise(v)
        for _ in range(2):
            share = (self.rows_per_window - self._n - self._q) / self.rows_per_window
            seen = np.sqrt(np.mean(fit.residual**2, axis=0) / share) * self.sigma
            # arithmetic cannot resolve less than this of the signal, whatever the residual says
            least = np.maximum(self.settings.floor, 1e-12 * np.abs(v[:, : len(known)]).max(axis=0) + 1e-300)
            self.sigma = np.where(known, self.settings.sigma, np.maximum(seen, least))
            fit = self._maximise(v)
        if fit.converged and np.all(np.isfinite(fit.covariance)):
            self.calibrated = True
        else:
            self.sigma = before
        return fit

    def _resummarise(self, start: int, x0: FloatArray) -> None:
        """Run the new operators over the window that starts at `start` with initial state x0."""
        segment = self._segment
        assert segment is not None
        segment.fulls = segment.head = None
        segment.done = start
        segment.anchored = True
        segment.z = np.zeros(self._n * (1 + self._q))
        segment.z[: self._n] = x0
        self._summarise(1)
        if self._F:
            self._summarise(self._F)


def _part(rows: Rows, which: slice) -> Rows:
    return Rows(*(getattr(rows, name)[which] for name in Rows.__dataclass_fields__))


def _concatenated(pieces: list[Rows], q: int) -> Rows:
    if len(pieces) == 1:
        return pieces[0]
    empty = Rows(
        np.zeros(0, np.int64), np.zeros((0, q)), np.zeros((0, q)), np.zeros(0),
        np.zeros(0, bool), np.zeros(0, bool), np.zeros(0, bool), np.zeros(0),
    )  # fmt: skip
    pieces = [empty, *pieces]
    return Rows(*(np.concatenate([getattr(piece, name) for piece in pieces]) for name in Rows.__dataclass_fields__))
