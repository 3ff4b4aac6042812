"""The product's estimator: sliding-window maximum likelihood in observer form, with its policy of change.

Samples go in, one row of estimates comes out a hop. A row is one exact projected Gauss-Newton step about theta_r from
block summaries; the policy decides when a window straddles a change and when theta_r is moved by an iterated fit.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from agent.numerics.cells import Summary
from agent.numerics.fit import Fit, Problem, fit_window
from agent.numerics.hops import HopOperators, HopPlan, Segment
from agent.numerics.reference import Reference, combined, mean_and_sd
from agent.numerics.sensitivity import sensitivity_filter
from agent.numerics.sensors import with_constant
from agent.numerics.statespace import Discrete, Hold, Model, discretise
from agent.numerics.window import solve_windows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
UNITS_MIN, UNITS_MAX = 32, 1024
"""Hops computed at once: few after a re-centring (which throws the rest of them away), more while nothing happens."""
LONG = 4096
"""Samples beyond which a fit iterates on summaries instead of samples."""
ROUND_OFF = 1e-12
"""Least noise that arithmetic can tell from zero, as a share of the signal."""


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
        plan: window and hop, samples.
        hold: how the input runs between samples.
        gains: the observer's gains.
        sigma: (p,) standard deviation of each output's noise where known, NaN where it is to be learnt.
        floor: (p,) standard deviation that the wire's resolution alone causes.
        scale: (q,) size of each parameter, |nominal| or what stands for it; NaN where the data must say.
        lower: (q,) bounds from below.
        enough_sd: (q,) sd above which a window cannot judge a parameter ("unexcited").
        scale_column: (q,) the channel (outputs, then inputs) whose rms in the first window fitted is the size of a
            parameter without one (an offset); None where every parameter has a size.
    """

    period_s: float
    plan: HopPlan
    hold: Hold
    gains: Gains
    sigma: FloatArray
    floor: FloatArray
    scale: FloatArray
    lower: FloatArray
    enough_sd: FloatArray
    scale_column: IntArray | None = None


@dataclass(frozen=True, slots=True)
class Rows:
    """Estimates at N hops.

    Attributes:
        index: (N,) newest sample of each window, counted from the run's first.
        theta, sd: (N, q); NaN while warming.
        dof: (N,) degrees of freedom of the residual variance.
        full: (N,) a whole window was there.
        changing, mismatch: (N,) the window is not to be believed: since less than a window's length, or for longer.
        ratio: (N,) residual variance over the reference.
    """

    index: IntArray
    theta: FloatArray
    sd: FloatArray
    dof: FloatArray
    full: BoolArray
    changing: BoolArray
    mismatch: BoolArray
    ratio: FloatArray

    @classmethod
    def warming(cls, index: IntArray, q: int) -> "Rows":
        """Return rows without estimates."""
        nothing, no = np.full((len(index), q), np.nan), np.zeros(len(index), dtype=bool)
        unknown = np.full(len(index), np.nan)
        return cls(index, nothing, nothing.copy(), unknown, no, no.copy(), no.copy(), unknown.copy())

    @classmethod
    def joined(cls, pieces: "list[Rows]", q: int) -> "Rows":
        """Return rows one after the other."""
        if len(pieces) == 1:
            return pieces[0]
        pieces = [cls.warming(np.zeros(0, np.int64), q), *pieces]
        return cls(*(np.concatenate([getattr(piece, f.name) for piece in pieces]) for f in fields(cls)))

    def part(self, stop: int) -> "Rows":
        """Return the first `stop` rows."""
        return Rows(*(getattr(self, f.name)[:stop] for f in fields(self)))


class WindowML:
    """Sliding-window maximum likelihood over a stream of samples; deterministic however the stream is cut."""

    def __init__(self, model: Model, settings: WindowSettings) -> None:
        self.model = model
        self.settings = settings
        self.theta = np.array(model.nominal, dtype=float)
        self.sigma = np.where(np.isfinite(settings.sigma), settings.sigma, 1.0)
        self.scale = np.where(np.isfinite(settings.scale), settings.scale, 1.0)
        self.learns_noise = not bool(np.all(np.isfinite(settings.sigma)))
        self.calibrated = not self.learns_noise
        self.settled = False
        self.recentred = 0
        self._units = UNITS_MIN
        self._onset: int | None = None
        self._last_fit = -(10**18)
        self._anchored = False
        self._segment: Segment | None = None
        self._reference = Reference.empty(len(self.theta))
        self._rebuild()
        self._dof = float(settings.plan.window * len(self.sigma) - self._n - len(self.theta))
        self._gate = 1.0 + 4.0 * np.sqrt(2.0 / max(self._dof, 1.0))

    def sampled(self, theta: FloatArray) -> Discrete:
        """Return the sampled model at theta (q,)."""
        return discretise(self.model.continuous(theta), self.settings.period_s, self.settings.hold)

    def _rebuild(self) -> None:
        """Make gain and operators about theta_r."""
        discrete = self.sampled(self.theta)
        gains = self.settings.gains
        self.gain = (gains.settled if self.settled else gains.start)(discrete)
        system = sensitivity_filter(discrete.model, self.gain, 1.0 / self.sigma)
        self._operators = HopOperators(system, self.settings.plan)
        self._n, self._inputs = discrete.model.n, discrete.model.m

    def start_segment(self) -> None:
        """Forget the samples before a gap; what was learnt of the parameters stays."""
        self._segment = None
        self._onset = None
        self._anchored = False

    def step(self, index: int, y: FloatArray, u: FloatArray) -> Rows:
        """Take consecutive samples y (N, p), u (N, m), the first of them number `index`; return the rows they end."""
        v = np.hstack([y, with_constant(u, self._inputs)])
        q = len(self.theta)
        pieces: list[Rows] = []
        if self._segment is None:
            self._segment = Segment(self.settings.plan, index, v.shape[1])
        first_row = self._segment.first if self._segment.head is None else index
        due = self.settings.plan.rows_between(index, min(first_row, index + len(v)))
        if len(due):
            pieces.append(Rows.warming(due, q))
        self._segment.append(index, v)
        while self._segment.ready():
            pieces.append(self._advance(self._segment))
        self._segment.trim(self.settings.plan.window + self.settings.plan.hop)
        return Rows.joined(pieces, q)

    def _advance(self, segment: Segment) -> Rows:
        """Summarise what is ready, judge each row, act at the first that asks for it, return the rows settled."""
        index, windows = segment.advance(self._operators, min(segment.ready(), self._units))
        rows, information = self._rows(index, windows)
        moved_at = self._judge(segment, rows, information)
        if moved_at is None:
            self._units = min(2 * self._units, UNITS_MAX)
            return rows
        # rows after the one that moved theta_r belong to the old operators and are computed again
        self._units = UNITS_MIN
        return rows.part(moved_at + 1)

    def _rows(self, index: IntArray, windows: Summary | None) -> tuple[Rows, FloatArray]:
        """Turn the windows' summaries into rows and scaled information (rows, q, q); the verdicts come later."""
        q = len(self.theta)
        rows = Rows.warming(index, q)
        information = np.zeros((len(index), q, q))
        if windows is None:
            return rows, information
        solution = solve_windows(windows, self._n)
        s2 = solution.residual / self._dof
        variance = np.einsum("nii->ni", solution.covariance) * np.maximum(s2, self._floor_ratio())[:, None]
        new = slice(len(index) - len(windows), None)
        rows.theta[new] = self.theta + solution.delta
        rows.sd[new] = np.sqrt(variance)
        rows.dof[new], rows.full[new], rows.ratio[new] = self._dof, True, s2
        information[new] = solution.information * np.outer(self.scale, self.scale)
        return rows, information

    def _floor_ratio(self) -> float:
        """Least residual variance that the wire allows, in units of the reference."""
        return float(np.mean((self.settings.floor / self.sigma) ** 2))

    def _judge(self, segment: Segment, rows: Rows, information: FloatArray) -> int | None:
        """Give the verdicts in order; return the row at which theta_r was moved (those after it are void), or None."""
        passes = rows.ratio <= self._gate
        eventful = rows.full & (~passes | self._far(rows) | self._quieter(rows))
        slow = self._drifted(rows, information, passes)
        trusted = self._anchored  # rows about a theta_r that was never fitted say nothing to remember
        position, count = 0, len(rows.index)
        while position < count:
            events = (eventful | slow)[position:] if self._anchored else rows.full[position:]
            ahead = int(np.argmax(events)) if events.any() else count - position
            if ahead:
                self._onset = None
            position += ahead
            if position < count and self._act(segment, rows, position, bool(passes[position])):
                self._remember(rows, information, passes & trusted, position)
                return position
            position += 1
        self._remember(rows, information, passes & trusted, count)
        return None

    def _far(self, rows: Rows) -> BoolArray:
        """(N,) some estimate is so far from theta_r, and so surely, that the linearisation should move at once."""
        change = np.abs(rows.theta - self.theta)
        known = rows.sd < self.settings.enough_sd
        return np.asarray(np.any(known & (change > 6 * rows.sd) & (change > self._share()), axis=1))

    def _share(self) -> FloatArray:
        """(q,) changes below this do not matter to the linearisation; without correction the observer feels more."""
        size = np.maximum(np.abs(self.theta), 0.1 * self.scale)
        return np.asarray((0.02 if self.gain.any() else 0.005) * size)

    def _quieter(self, rows: Rows) -> BoolArray:
        """(N,) the residual is so far below a learnt reference that the reference was learnt in a disturbance."""
        return np.asarray(self.learns_noise & (rows.ratio < 2.0 - self._gate))

    def _disjoint(self, rows: Rows, passes: BoolArray) -> IntArray:
        """Rows whose windows follow each other without overlap and pass the gate: one in ceil(W/H)."""
        stride = self.settings.plan.fulls + 1
        number = rows.index // self.settings.plan.hop
        return np.flatnonzero((number % stride == 0) & passes & rows.full & np.isfinite(rows.theta).all(axis=1))

    def _drifted(self, rows: Rows, information: FloatArray, passes: BoolArray) -> BoolArray:
        """(N,) the windows up to a row, together, put theta away from theta_r."""
        drifted = np.zeros(len(rows.index), dtype=bool)
        chosen = self._disjoint(rows, passes)
        if len(chosen):
            scale = self.scale
            A, b = self._reference.with_windows(information[chosen], rows.theta[chosen] / scale)
            mean, sd = mean_and_sd(A, b)
            change = np.abs(mean * scale - self.theta)
            known = sd * scale < self.settings.enough_sd
            drifted[chosen] = np.any(known & (change > 3 * sd * scale) & (change > self._share()), axis=1)
        return drifted

    def _remember(self, rows: Rows, information: FloatArray, passes: BoolArray, stop: int) -> None:
        """Add the disjoint healthy windows among the first `stop` rows to the reference."""
        chosen = self._disjoint(rows, passes)
        chosen = chosen[chosen < stop]
        if len(chosen):
            A, b = self._reference.with_windows(information[chosen], rows.theta[chosen] / self.scale)
            self._reference = Reference(A[-1], b[-1])

    def _act(self, segment: Segment, rows: Rows, row: int, passes: bool) -> bool:
        """Mark one eventful row and try a fit where the policy calls for one; return whether theta_r was moved."""
        index, plan = int(rows.index[row]), self.settings.plan
        due = index - self._last_fit >= plan.window // 4
        if self._anchored and passes:
            self._onset = None
            return due and self._fit(segment, rows, row)
        starting = not self._anchored and (due or self._onset is None)
        if self._onset is None:
            self._onset = index
        since = index - self._onset
        # the window that begins after the onset is the first that can be free of it
        clean = self._anchored and since >= plan.window - plan.hop and (due or since < plan.window)
        if (starting or clean) and self._fit(segment, rows, row):
            self._onset = None
            return True
        excited = bool(np.any(rows.sd[row] < self.settings.enough_sd))
        if not passes or excited:
            rows.changing[row], rows.mismatch[row] = since < plan.window, since >= plan.window
        return False

    def _fit(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Fit the window of a row; if the fit passes the gate move theta_r and redo the summaries."""
        index = int(rows.index[row])
        start = index + 1 - self.settings.plan.window
        self._last_fit = index
        v = segment.samples(start, index + 1)
        if not self.settled:
            self._size_offsets(v)
        learns = self.learns_noise and (not self.calibrated or bool(self._quieter(rows)[row]))
        before = (self.theta, self.sigma, self.settled)
        fit = self._learn(v[-LONG:]) if learns else self._maximise(v[-LONG:])
        accepted = fit.converged and self._place(segment, fit, start, long=len(v) > LONG)
        if not accepted:
            self.theta, self.sigma, self.settled = before
            return False
        self.calibrated = self._anchored = True
        self.recentred += 1
        self._write(rows, row)
        return True

    def _size_offsets(self, v: FloatArray) -> None:
        """Take the size of each parameter that has none from the signal of its channel."""
        if self.settings.scale_column is None:
            return
        rms = np.sqrt(np.mean(v**2, axis=0))[self.settings.scale_column]
        self.scale = np.where(np.isfinite(self.settings.scale), self.settings.scale, np.maximum(rms, 1e-300))

    def _place(self, segment: Segment, fit: Fit, start: int, *, long: bool) -> bool:
        """Linearise about a fit if it passes the gate; a long window is iterated on its summaries first."""
        if long:
            return self._place_long(segment, fit, start)
        s2 = float(np.sum(fit.residual**2)) / self._dof
        variance = np.diag(fit.covariance) * max(s2, self._floor_ratio())
        if not (s2 <= self._gate and np.all(np.isfinite(variance))):
            return False
        scale = self.scale
        scaled = fit.covariance / np.outer(scale, scale)
        information = np.asarray(np.linalg.pinv(scaled, hermitian=True), dtype=np.float64)
        self._outcome = (fit.theta, np.sqrt(variance), s2)
        self._centre(segment, start, fit.x0, information)
        return True

    def _centre(self, segment: Segment, start: int, x0: FloatArray, information: FloatArray) -> None:
        """Move theta_r to what window and reference say together and summarise the window anew."""
        scale = self.scale
        centre, self._reference = combined(self._reference, information, self._outcome[0] / scale)
        self.theta = np.maximum(centre * scale, self.settings.lower)
        self.settled = True
        self._rebuild()
        self._resummarise(segment, start, x0)

    def _resummarise(self, segment: Segment, start: int, x0: FloatArray) -> Summary:
        """Run the operators over the window that starts at `start` with observer state x0 (n,); return its summary."""
        z = np.zeros(self._operators.nz)
        z[: self._n] = x0
        segment.restart(start, z)
        _, windows = segment.advance(self._operators, 1)
        if self.settings.plan.fulls:
            _, windows = segment.advance(self._operators, self.settings.plan.fulls)
        if windows is None:
            raise ValueError("a window needs all of its samples")
        return windows

    def _place_long(self, segment: Segment, fit: Fit, start: int) -> bool:
        """Carry a fit of the newest LONG samples to the whole window by steps on its summaries."""
        kept = (segment.done, segment.z, segment.fulls, segment.head, self._operators, self.gain)
        self.theta, self.settled, x0 = fit.theta, True, np.zeros(self._n)
        for _ in range(8):
            self._rebuild()
            solution = solve_windows(self._resummarise(segment, start, x0), self._n)
            s2 = float(solution.residual[0]) / self._dof
            sd = np.sqrt(np.diag(solution.covariance[0]) * max(s2, self._floor_ratio()))
            if not np.all(np.isfinite(sd)):
                break
            step = np.clip(solution.delta[0], -0.5 * self.scale, self.scale)
            x0 = x0 + solution.e0[0]
            if np.all(np.abs(step) < 0.1 * sd) and s2 <= self._gate:
                scale = self.scale
                self._outcome = (self.theta + step, sd, s2)
                self._centre(segment, start, x0, solution.information[0] * np.outer(scale, scale))
                return True
            self.theta = np.maximum(self.theta + step, self.settings.lower)
        segment.done, segment.z, segment.fulls, segment.head, self._operators, self.gain = kept
        return False

    def _write(self, rows: Rows, row: int) -> None:
        """Put the outcome of an accepted fit into its row."""
        rows.theta[row], rows.sd[row], rows.ratio[row] = self._outcome
        rows.changing[row] = rows.mismatch[row] = False

    def _maximise(self, v: FloatArray) -> Fit:
        s = self.settings
        problem = Problem(self.sampled, v, 1.0 / self.sigma, self.scale, s.lower)
        return fit_window(problem, self.theta, np.zeros(self._n), [s.gains.start, s.gains.settled])

    def _learn(self, v: FloatArray) -> Fit:
        """Fit with unknown noise: the residual of each output sets its sigma, then the fit is done again."""
        known = np.isfinite(self.settings.sigma)
        y = v[:, : len(known)]
        signal = np.maximum(np.std(y, axis=0), 1e-3 * np.std(y) + 1e-300)
        self.sigma = np.where(known, self.settings.sigma, 1e-3 * signal)
        # arithmetic cannot resolve less than this of the signal, whatever the residual says
        least = np.maximum(self.settings.floor, ROUND_OFF * np.abs(y).max(axis=0) + 1e-300)
        fit = self._maximise(v)
        for _ in range(2):
            share = max(1.0 - (self._n + len(self.theta)) / v[:, : len(known)].size, 0.1)
            seen = np.sqrt(np.mean(fit.residual**2, axis=0) / share) * self.sigma
            self.sigma = np.where(known, self.settings.sigma, np.maximum(seen, least))
            fit = self._maximise(v)
        return fit
