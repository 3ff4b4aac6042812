"""The product's estimator: sliding-window maximum likelihood in observer form, with its policy of change.

Samples go in, one row of estimates comes out a hop. A row is one exact projected Gauss-Newton step about theta_r from
block summaries; the policy decides when a window straddles a change and when theta_r is moved by an iterated fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.calibrate import Calibrator
from agent.numerics.cells import Summary
from agent.numerics.choice import Candidate, candidate, choose, gate
from agent.numerics.colour import Colour, InputNoise, colour_of
from agent.numerics.commission import Commission
from agent.numerics.fit import Fit, Problem, fit_window, linearise
from agent.numerics.gains import Gains
from agent.numerics.hops import HopOperators, HopPlan, Segment
from agent.numerics.lacking import MOST, Answer, Lacking, answer
from agent.numerics.observer import Gain, Noise
from agent.numerics.past import Past
from agent.numerics.reference import Reference, combined, mean_and_sd
from agent.numerics.rows import Rows
from agent.numerics.sensitivity import sensitivity_filter
from agent.numerics.sensors import with_constant
from agent.numerics.statespace import Discrete, Hold, Model, discretise
from agent.numerics.straddle import Window, is_clean
from agent.numerics.suspects import Suspects
from agent.numerics.verdict import Before, Court, Verdict
from agent.numerics.window import WindowSolution, solve_windows
from agent.types import Reason

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
UNITS_MIN, UNITS_MAX = 32, 1024
"""Hops computed at once: few after a re-centring (which throws the rest of them away), more while nothing happens."""
LONG = 4096
"""Samples beyond which a fit iterates on summaries instead of samples."""
CALIBRATION = 32_768
"""The same for a fit that learns the noise: what the newest samples leave says little of a whole long window."""
MOST_FAILED = 6
"""First fits that fail are tried again after a quarter of a window, then after twice as long each time, this often."""
RECORD_WINDOWS, RECORD_SAMPLES = 10, 20_000
"""The record on which unknown forces are searched again after a start: ten windows, but no more than this."""
RECOLOUR = 131_072
"""Samples between two looks at the colour of a residual that was white; one that was not is looked at every window."""


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
        input_sd: (k,) noise of the first k inputs as far as it is known; None for none.
        suspects: what to look for where the model does not fit; None for nothing.
        court: tells a changed sensor from a changed structure; None believes in the structure.
        longer: further windows, samples, longer than the plan's by whole hops; each estimate is taken from the
            shortest that knows it to wanted_sd (q,).
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
    longer: tuple[int, ...] = ()
    wanted_sd: FloatArray | None = None
    suspects: Suspects | None = None
    court: Court | None = None
    input_sd: FloatArray | None = None


class WindowML:
    """Sliding-window maximum likelihood over a stream of samples; deterministic however the stream is cut."""

    def __init__(self, model: Model, settings: WindowSettings) -> None:
        self.model = model
        self.settings = settings
        self.theta = np.array(model.nominal, dtype=float)
        self.calibrator = Calibrator(settings.gains, settings.sigma, settings.floor)
        directions = settings.gains.disturbance
        unforced = np.zeros(0 if directions is None else directions.shape[1])
        self.noise = Noise(np.where(np.isfinite(settings.sigma), settings.sigma, 1.0), unforced)
        self.scale = np.where(np.isfinite(settings.scale), settings.scale, 1.0)
        self.colour = Colour.white(len(self.theta))
        self.commission = Commission(np.ones(len(self.theta)))
        self.settled = False
        self.recentred = 0
        self._units = UNITS_MIN
        self._failed = 0
        self._onset: int | None = None
        self._last_fit = self._coloured_at = self._steady_since = -(10**18)
        self._searched = directions is None
        self._accused, self._accused_at = 0, -(10**18)
        self._anchored = False
        self._segment: Segment | None = None
        self._reference = Reference.empty(len(self.theta))
        self._past = Past.empty(len(self.theta))
        self._blamed: Verdict | None = None
        self._heard = 0
        self._lacking = Lacking(len(self.noise.sigma))
        self._rebuild()
        self._unknowns = self._n + len(self.theta)
        self._dof = max(float(settings.plan.window * len(self.noise.sigma) - self._unknowns), 1.0)

    @property
    def _gate(self) -> float:
        """Largest residual variance, in units of the reference, of an undisturbed window."""
        return float(gate(self._dof, self._doubt, self.colour.share))

    @property
    def _doubt(self) -> float:
        return 2.0 if self.calibrator.learns else 1.0

    def sampled(self, theta: FloatArray) -> Discrete:
        """Return the sampled model at theta (q,)."""
        return discretise(self.model.continuous(theta), self.settings.period_s, self.settings.hold)

    def _rebuild(self) -> None:
        """Make gain and operators about theta_r."""
        self._discrete = discrete = self.sampled(self.theta)
        gains = self.settings.gains
        self.gain = (gains.settled if self.settled else gains.start)(discrete, self.noise)
        system = sensitivity_filter(discrete.model, self.gain.L, self.gain.whitening)
        self._operators = HopOperators(system, self.settings.plan)
        speed = float(np.max(np.abs(np.angle(np.linalg.eigvals(discrete.model.A)))))
        self._turned = self.settings.plan.window * speed
        self._n, self._inputs = discrete.model.n, discrete.model.m

    def start_segment(self) -> None:
        """Forget the samples before a gap; what was learnt of the parameters stays."""
        self._segment = None
        self._onset = self._blamed = None
        self._anchored = False
        self._lacking.forget()

    def step(self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None) -> Rows:
        """Take consecutive samples y (N, p), u (N, m), the first of them number `index`; return the rows they end.

        missing (N, p+m): readings that were filled in and are to be treated as unknown.
        """
        if missing is not None:
            self._lacking.append(index, missing)
        v = np.hstack([y, with_constant(u, self._inputs)])
        q, plan = len(self.theta), self.settings.plan
        pieces: list[Rows] = []
        if self._segment is None:
            more = [(window - plan.head) // plan.hop for window in self.settings.longer]
            self._segment = Segment(plan, index, v.shape[1], more)
        first_row = self._segment.first if self._segment.head is None else index
        due = plan.rows_between(index, min(first_row, index + len(v)))
        if len(due):
            pieces.append(Rows.warming(due, q))
        self._segment.append(index, v)
        while self._segment.ready():
            pieces.append(self._advance(self._segment))
        keep = max(plan.window, *self.settings.longer, 0 if self._searched else self._record()) + plan.hop
        self._segment.trim(keep)
        self._lacking.trim(self._segment.first)
        return Rows.joined(pieces, q)

    def _record(self) -> int:
        """Samples of the record on which unknown forces are searched."""
        return min(RECORD_WINDOWS * self.settings.plan.window, RECORD_SAMPLES)

    def _advance(self, segment: Segment) -> Rows:
        """Summarise what is ready, judge each row, act at the first that asks for it, return the rows settled."""
        index, windows = segment.advance(self._operators, min(segment.ready(), self._units))
        rows, information = self._rows(index, None if windows is None else solve_windows(windows, self._n))
        candidates = self._candidates(segment)
        self._mend(segment, rows, information, candidates)
        white_sd = rows.sd / self._widening()
        moved_at = self._judge(segment, rows, information)
        if candidates and self.settings.wanted_sd is not None:
            with np.errstate(invalid="ignore"):
                widening = np.where(white_sd > 0, rows.sd / white_sd, 1.0)
            choose(rows, widening, rows.dof / self._dof, candidates, self.settings.wanted_sd, self._doubt)
        if moved_at is None:
            self._units = min(2 * self._units, max(UNITS_MAX, 2 * self.settings.plan.fulls))
            return rows
        # rows after the one that moved theta_r belong to the old operators and are computed again
        self._units = UNITS_MIN
        return rows.part(moved_at + 1)

    def _candidates(self, segment: Segment) -> list[Candidate]:
        """What the longer windows that are whole say at the newest rows."""
        pairs = zip(self.settings.longer, segment.longer, strict=True)
        theta, outputs, least = self.theta, len(self.noise.sigma), self._floor_ratio()
        return [candidate(s, window, theta, self._n, outputs, least) for window, s in pairs if s is not None]

    def _rows(self, index: IntArray, solution: WindowSolution | None) -> tuple[Rows, FloatArray]:
        """Turn solved windows into rows and scaled information (rows, q, q); the verdicts come later."""
        q = len(self.theta)
        rows = Rows.warming(index, q)
        information = np.zeros((len(index), q, q))
        if solution is None:
            return rows, information
        s2 = solution.residual / self._dof
        # a residual of exactly nothing leaves what is unknown unknown
        s2_floored = np.maximum(s2, max(self._floor_ratio(), 1e-300))
        variance = np.einsum("nii->ni", solution.covariance) * s2_floored[:, None]
        new = slice(len(index) - len(s2), None)
        rows.theta[new] = self.theta + solution.delta
        rows.sd[new] = np.sqrt(variance) * self._widening()
        rows.dof[new], rows.full[new], rows.ratio[new] = self._dof * self.colour.share, True, s2
        rows.window[new] = self.settings.plan.window
        rows.suspect[new] = self._accused
        information[new] = solution.information * np.outer(self.scale, self.scale)
        return rows, information

    def _mend(self, segment: Segment, rows: Rows, information: FloatArray, candidates: list[Candidate]) -> None:
        """Solve the windows that lack readings once more, with those as unknowns, and put that in place."""
        window = self.settings.plan.window
        for row in np.flatnonzero((self._lacking.count(rows.index, window) > 0) & rows.full).tolist():
            found = self._answer(segment, int(rows.index[row]) + 1, window)
            dof, rows.ratio[row], sd = self._judged(found, window)
            rows.theta[row], rows.sd[row] = self.theta + found.delta, sd * self._widening()
            rows.dof[row] = dof * self.colour.share
            information[row] = found.information * np.outer(self.scale, self.scale)
        for longer in candidates:
            newest = rows.index[len(rows.index) - len(longer.ratio) :]
            for i in np.flatnonzero(self._lacking.count(newest, longer.window) > 0).tolist():
                found = self._answer(segment, int(newest[i]) + 1, longer.window)
                _, longer.ratio[i], longer.sd[i] = self._judged(found, longer.window)
                longer.theta[i] = self.theta + found.delta

    def _answer(self, segment: Segment, stop: int, window: int) -> Answer:
        """Solve one window that ends before sample `stop` about theta_r, on its samples."""
        v, q = segment.samples(stop - window, stop), len(self.theta)
        if self._lacking.count(np.array([stop - 1]), window)[0] > MOST * window:
            return Answer(np.full(q, np.nan), np.full((q, q), np.inf), np.zeros((q, q)), np.inf, 0)
        bridge = self._lacking.bridge(v, stop)
        here = linearise(self._discrete.model, self.gain, v, np.zeros(self._n), bridge)
        return answer(here, 0 if bridge is None else bridge.free)

    def _judged(self, found: Answer, window: int) -> tuple[float, float, FloatArray]:
        """Return degrees of freedom, residual variance and white sd (q,) of an answer."""
        dof = max(float(window * len(self.noise.sigma) - self._unknowns - found.free), 1.0)
        ratio = found.residual / dof
        variance = np.diag(found.covariance) * max(ratio, self._floor_ratio(), 1e-300)
        return dof, ratio, np.sqrt(variance)

    def _widening(self) -> FloatArray:
        """(q,) honest sd over what white noise would have it."""
        return np.asarray(self.colour.inflation * self.commission.factor)

    def _floor_ratio(self) -> float:
        """Least residual variance that the wire allows, in units of the reference."""
        return float(np.mean((self.settings.floor / self.noise.sigma) ** 2))

    def _judge(self, segment: Segment, rows: Rows, information: FloatArray) -> int | None:
        """Give the verdicts in order; return the row at which theta_r was moved (those after it are void), or None."""
        trusted = self._anchored  # rows about a theta_r that was never fitted say nothing to remember
        healthy, wanting = self._first_looks(rows, information)
        position, count = 0, len(rows.index)
        while position < count:
            events = (~healthy | wanting | self._chores(rows))[position:] & rows.full[position:]
            events = events if self._anchored else rows.full[position:]
            ahead = int(np.argmax(events)) if events.any() else count - position
            if ahead:
                self._onset = self._blamed = None
            position += ahead
            if position == count:
                break
            if healthy[position] and self._anchored and self._keep_house(segment, rows, position):
                healthy, wanting = self._first_looks(rows, information)
            before = (self._reference, self._past)
            # what came before this row is remembered first: a fit that contradicts it must forget it too
            self._remember(rows, information, healthy & trusted, position)
            if self._act(segment, rows, position, healthy=bool(healthy[position]), wants=bool(wanting[position])):
                return position
            self._reference, self._past = before
            position += 1
        self._remember(rows, information, healthy & trusted, count)
        return None

    def _first_looks(self, rows: Rows, information: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Return which rows pass the gate (N,), and which of them want theta_r moved (N,)."""
        passes = rows.ratio <= self._gate
        passes &= ~self._contradicted(rows, information, passes)
        moves = self._far(rows) | self._quieter(rows) | self._drifted(rows, information, passes)
        return passes, np.asarray(moves & passes)

    def _contradicted(self, rows: Rows, information: FloatArray, passes: BoolArray) -> BoolArray:
        """(N,) some estimate leaves what was known before its window began, beyond chance and enough to matter."""
        estimates = (rows.theta / self.scale, rows.sd / self.scale)
        matters = self.settings.enough_sd / self.scale
        chosen = self._disjoint(rows, passes)
        while True:
            found = self._past.contradicted(estimates, chosen, information, self._widening(), matters)
            wrong = chosen[found[chosen]]
            if not len(wrong):
                return found
            # a contradicted row is not remembered, so it must not speak for those after it either
            chosen = chosen[chosen != wrong[0]]

    def _chores(self, rows: Rows) -> BoolArray:
        """(N,) rows from which on the residual's colour is due for a look, or unknown forces for a search."""
        recolour = rows.index - self._coloured_at >= self._recolour_every()
        commission = np.zeros(len(rows.index), dtype=bool)
        if not self.commission.known:
            commission[self._disjoint(rows, rows.ratio <= self._gate)] = True
        search = (not self._searched) & (rows.index - self._steady_since >= self._record())
        return np.asarray(recolour | search | commission)

    def _recolour_every(self) -> int:
        white = self.colour.share == 1.0 and bool(np.all(self.colour.inflation < 1.2))
        return max(RECOLOUR, self.settings.plan.window) if white else self.settings.plan.window

    def _far(self, rows: Rows) -> BoolArray:
        """(N,) some estimate is so far from theta_r, and so surely, that the linearisation should move at once."""
        change = np.abs(rows.theta - self.theta)
        known = rows.sd < self.settings.enough_sd
        return np.asarray(np.any(known & (change > 6 * rows.sd) & (change > self._share()), axis=1))

    def _share(self) -> FloatArray:
        """(q,) changes below this do not matter to the linearisation.

        Without correction the observer feels more: its phase runs away with the angle that a mode turns in a window.
        """
        size = np.maximum(np.abs(self.theta), 0.1 * self.scale)
        if self.gain.L.any():
            return np.asarray(0.02 * size)
        return np.asarray(0.02 * float(np.clip(2.0 / max(self._turned, 1e-9), 0.25, 1.0)) * size)

    def _quieter(self, rows: Rows) -> BoolArray:
        """(N,) the residual is so far below a learnt reference that the reference was learnt in a disturbance."""
        return np.asarray(self.calibrator.learns & (rows.ratio < 2.0 - self._gate))

    def _disjoint(self, rows: Rows, healthy: BoolArray) -> IntArray:
        """Healthy rows whose windows follow each other without overlap: one in ceil(W/H)."""
        number = rows.index // self.settings.plan.hop
        chosen = number % (self.settings.plan.fulls + 1) == 0
        return np.flatnonzero(chosen & healthy & rows.full & np.isfinite(rows.theta).all(axis=1))

    def _drifted(self, rows: Rows, information: FloatArray, healthy: BoolArray) -> BoolArray:
        """(N,) the windows up to a row, together, put theta away from theta_r."""
        drifted = np.zeros(len(rows.index), dtype=bool)
        chosen = self._disjoint(rows, healthy)
        if len(chosen):
            A, b = self._reference.with_windows(information[chosen], rows.theta[chosen] / self.scale)
            mean, sd = mean_and_sd(A, b)
            change = np.abs(mean * self.scale - self.theta)
            known = sd * self.scale < self.settings.enough_sd
            drifted[chosen] = np.any(known & (change > 3 * sd * self.scale) & (change > self._share()), axis=1)
        return drifted

    def _remember(self, rows: Rows, information: FloatArray, healthy: BoolArray, stop: int) -> None:
        """Add the disjoint healthy windows among the first `stop` rows to the reference."""
        chosen = self._disjoint(rows, healthy)
        chosen = chosen[chosen < stop]
        if len(chosen):
            A, b = self._reference.with_windows(information[chosen], rows.theta[chosen] / self.scale)
            self._reference = Reference(A[-1], b[-1])
            self._past = self._past.after(information[chosen], rows.theta[chosen] / self.scale)

    def _act(self, segment: Segment, rows: Rows, row: int, *, healthy: bool, wants: bool) -> bool:
        """Mark one eventful row and try a fit where the policy calls for one; return whether theta_r was moved."""
        index, plan = int(rows.index[row]), self.settings.plan
        if self._lacking.count(rows.index[row : row + 1], plan.window)[0] > MOST * plan.window:
            return False
        pause = (plan.window // 4) << self._failed if self._blamed is None else plan.window << self._heard
        due = index - self._last_fit >= pause
        if self._anchored and healthy:
            self._onset = self._blamed = None
            if not self._searched and index - self._steady_since >= self._record():
                return self._search(segment, rows, row)
            return wants and due and self._fit(segment, rows, row)
        starting = not self._anchored and (due or self._onset is None)
        if self._onset is None:
            self._onset = index
        self._steady_since = index
        self.commission.restart()
        since = index - self._onset
        # the window that begins after the onset is free of it for certain, one before that may be
        clean = self._anchored and since >= plan.window - plan.hop and (due or since < plan.window)
        clean = clean or (2 * since >= plan.window and since < plan.window and self._is_clean(segment, rows, row))
        if (starting or clean) and self._fit(segment, rows, row):
            self._onset = None
            return True
        excited = bool(np.any(rows.sd[row] < self.settings.enough_sd))
        if not healthy or excited:
            rows.changing[row], rows.mismatch[row] = since < plan.window, since >= plan.window
        if self._blamed is not None:
            blamed = Reason.SENSOR if self._blamed.changed == "sensor" else Reason.INSEPARABLE
            rows.suspect[row], rows.channel[row] = blamed, self._blamed.channel
        elif since >= plan.window and index - self._accused_at >= plan.window:
            self._accuse(segment, rows, row)
        return False

    def _is_clean(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Tell whether a window that its residual does not accuse is free of what contradicts the past."""
        past, known = self._past.mean(), rows.ratio[row : row + 1] <= self._gate
        if past is None or not known[0] or self._lacking.count(rows.index[row : row + 1], self.settings.plan.window)[0]:
            return False
        stop = int(rows.index[row]) + 1
        v = segment.samples(stop - min(self.settings.plan.window, LONG), stop)
        window = Window(self.sampled, self.gain, v, self.scale, self.settings.lower)
        return is_clean(window, past * self.scale, rows.theta[row])

    def _keep_house(self, segment: Segment, rows: Rows, row: int) -> bool:
        """See to colour and commissioning at a healthy row; return whether later rows must be looked at anew."""
        recoloured = self._recolour(segment, rows, row)
        if self.commission.known or row not in self._disjoint(rows, rows.ratio <= self._gate):
            return recoloured
        if not self.commission.add(rows.theta[row : row + 1], rows.sd[row : row + 1]):
            return recoloured
        rows.sd[row + 1 :] *= self.commission.factor
        return True

    def _recolour(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Look at the colour of a healthy row's residual when that is due; widen this row's and later intervals."""
        index = int(rows.index[row])
        if index - self._coloured_at < self._recolour_every():
            return False
        before, window = self.colour, min(self.settings.plan.window, LONG)
        v = segment.samples(index + 1 - window, index + 1)
        bridge = self._lacking.bridge(v, index + 1)
        here = linearise(self._discrete.model, self.gain, v, np.zeros(self._n), bridge)
        covariance = np.linalg.pinv(here.psi.T @ here.psi, hermitian=True)
        delta = covariance @ (here.psi.T @ here.e)
        residual = (here.e - here.psi @ delta).reshape(-1, len(self.noise.sigma))
        inputs = self._input_noise(self._discrete, self.gain, window)
        self._take_colour(colour_of(here.psi, residual, np.asarray(covariance), self._unknowns, inputs), index)
        rows.sd[row:] *= self.colour.inflation / before.inflation
        rows.dof[row:] *= self.colour.share / before.share
        self._review(segment, rows, row)
        return True

    def _review(self, segment: Segment, rows: Rows, row: int) -> None:
        """Accuse where the residual is coloured; what a model lacks colours it, so a white one clears all suspects."""
        if self.colour.share < 1.0:
            self._accuse(segment, rows, row)
        else:
            self._accused_at, self._accused, rows.suspect[row:] = int(rows.index[row]), 0, 0

    def _accuse(self, segment: Segment, rows: Rows, row: int) -> None:
        """Look for what the model lacks in the window of a row; the finding stands until the next look."""
        index, suspects = int(rows.index[row]), self.settings.suspects
        self._accused_at = index
        if suspects is None:
            return
        v = segment.samples(index + 1 - min(self.settings.plan.window, CALIBRATION), index + 1)
        if not np.isfinite(v).all():
            return
        bridge = self._lacking.bridge(v, index + 1)
        found = suspects.accuse(self.theta, self.gain, v, self._dof * self.colour.share, bridge)
        self._accused = 0 if found is None else int(found.suspect.reason)
        rows.suspect[row:] = self._accused

    def _input_noise(self, discrete: Discrete, gain: Gain, samples: int) -> InputNoise | None:
        sd = self.settings.input_sd
        return None if sd is None else InputNoise.of(discrete.model, gain, sd, samples)

    def _take_colour(self, colour: Colour, index: int) -> None:
        self.colour, self._coloured_at = colour, index

    def _search(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Search a long undisturbed record for unknown forces; where there are some, go on with their gain."""
        index = int(rows.index[row])
        self._searched = True
        v = segment.samples(max(segment.first, index + 1 - self._record()), index + 1)
        found = self.calibrator.forces_in(self._problem(v, index + 1), self.theta, self.noise)
        if found is None:
            return False
        before, self.noise = self.noise, found
        if self._fit(segment, rows, row):
            return True
        self.noise = before
        return False

    def _fit(self, segment: Segment, rows: Rows, row: int) -> bool:
        """Fit the window of a row; if the fit passes the gate move theta_r and redo the summaries."""
        index = int(rows.index[row])
        start = index + 1 - self.settings.plan.window
        self._last_fit = index
        v = segment.samples(start, index + 1)
        if not self.settled:
            self._size_offsets(v)
        before = (self.theta, self.noise, self.settled, self.colour)
        most = CALIBRATION if not self.settled or self._quieter(rows)[row] else LONG
        whole = len(v) <= most or self._lacking.count(rows.index[row : row + 1], len(v))[0] > 0
        problem = self._problem(v if whole else v[-LONG:], index + 1)
        afresh = not self.settled or bool(self._quieter(rows)[row])
        near = self._anchored and self._onset is None
        beginning = np.where(np.isfinite(rows.theta[row]) & near, rows.theta[row], self.theta)
        fit = self._maximise(problem, beginning, afresh=afresh, near=near)
        dof = max(self._dof - (0 if problem.bridge is None else problem.bridge.free), 1.0)
        self._blamed = None if near or not before[2] else self._hear(problem, fit)
        # a sensor that stays at fault is heard ever more seldom; once it fits again that is seen at once
        self._heard = 0 if self._blamed is None else min(self._heard + 1, MOST_FAILED)
        if self._blamed is not None or not (fit.converged and self._place(segment, fit, start, dof if whole else None)):
            self.theta, self.noise, self.settled, self.colour = before
            # a first fit searches for unknown forces: where it keeps failing it must not eat the time there is
            self._failed = 0 if self.settled else min(self._failed + 1, MOST_FAILED)
            return False
        self._coloured_at, self._failed = index, 0
        if not self._anchored or self._onset is not None:
            self._steady_since, self._past = index, Past.empty(len(self.theta))
        self._anchored = True
        self.recentred += 1
        rows.theta[row], rows.sd[row], rows.ratio[row] = self._outcome
        rows.dof[row] = dof * self.colour.share
        rows.changing[row] = rows.mismatch[row] = False
        self._review(segment, rows, row)
        return True

    def _hear(self, problem: Problem, fit: Fit) -> Verdict | None:
        """Say which sensor may have changed where a window contradicts the past; None where it is the structure."""
        court, past = self.settings.court, self._past.reference
        if court is None:
            return None
        before = Before.of(past, self.scale, self.theta)
        known = np.all(np.isfinite(fit.covariance))
        q = len(self.theta)
        if fit.converged and (not known or before.distance(fit.theta, fit.covariance) < q + 5 * np.sqrt(2 * q)):
            return None
        if not fit.converged and not np.diag(past.A).any():
            return None
        after = fit.theta if fit.converged else before.theta
        found = court.judge(problem, self.gain, before, after, self._gate, self.colour.share)
        return None if found is None or found.changed == "structure" else found

    def _size_offsets(self, v: FloatArray) -> None:
        """Take the size of each parameter that has none from the signal of its channel."""
        if self.settings.scale_column is None:
            return
        rms = np.sqrt(np.mean(v**2, axis=0))[self.settings.scale_column]
        self.scale = np.where(np.isfinite(self.settings.scale), self.settings.scale, np.maximum(rms, 1e-300))

    def _problem(self, v: FloatArray, stop: int) -> Problem:
        """Return the problem of fitting samples v that end before sample `stop`."""
        return Problem(self.sampled, v, self.scale, self.settings.lower, self._lacking.bridge(v, stop))

    def _maximise(self, problem: Problem, theta: FloatArray, *, afresh: bool, near: bool) -> Fit:
        """Fit a window from theta (q,); afresh also learns what disturbs it, near needs no wide basin."""
        if afresh:
            calibration = self.calibrator.calibrate(problem, theta)
            self.noise = calibration.noise
            return calibration.fit
        gains, noise = self.settings.gains, self.noise
        stages = [lambda discrete: gains.start(discrete, noise), lambda discrete: gains.settled(discrete, noise)]
        return fit_window(problem, theta, np.zeros(self._n), stages[1:] if near else stages)

    def _place(self, segment: Segment, fit: Fit, start: int, dof: float | None) -> bool:
        """Linearise about a fit if it passes the gate; dof are the fit's degrees of freedom.

        None stands for the fit of a part: the long window is then iterated on its summaries first.
        """
        if not np.all(np.isfinite(fit.covariance)):
            return False
        discrete = self.sampled(fit.theta)
        inputs = self._input_noise(discrete, self.settings.gains.settled(discrete, self.noise), len(fit.residual))
        self.colour = colour_of(fit.psi, fit.residual, fit.covariance, self._unknowns, inputs)
        if dof is None:
            return self._place_long(segment, fit, start)
        s2 = float(np.sum(fit.residual**2)) / dof
        variance = np.diag(fit.covariance) * max(s2, self._floor_ratio())
        if not (s2 <= self._gate and np.all(np.isfinite(variance))):
            return False
        scaled = fit.covariance / np.outer(self.scale, self.scale)
        information = np.asarray(np.linalg.pinv(scaled, hermitian=True), dtype=np.float64)
        self._outcome = (fit.theta, np.sqrt(variance) * self._widening(), s2)
        self._centre(segment, start, fit.x0, information)
        return True

    def _centre(self, segment: Segment, start: int, x0: FloatArray, information: FloatArray) -> None:
        """Move theta_r to what window and reference say together and summarise the window anew."""
        centre, self._reference = combined(self._reference, information, self._outcome[0] / self.scale)
        self.theta = np.maximum(centre * self.scale, self.settings.lower)
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
        kept = (segment.done, segment.z, segment.kept, segment.head, self._operators, self.gain, self._discrete)
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
                self._outcome = (self.theta + step, sd * self._widening(), s2)
                self._centre(segment, start, x0, solution.information[0] * np.outer(self.scale, self.scale))
                return True
            self.theta = np.maximum(self.theta + step, self.settings.lower)
        segment.done, segment.z, segment.kept, segment.head, self._operators, self.gain, self._discrete = kept
        return False
