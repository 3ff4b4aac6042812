"""The paper's estimator over a sliding window and over a stream (method = "seed").

One pass is the method as printed: the observer runs on the nominal parameters, the window's last W states
give dA. Each further pass puts the observer on the parameters of the pass before, with the physical structure
imposed, and runs it again over the window and the samples before it that it needs to settle. The fixed point
is the exact answer, since there the observer has nothing left to correct.

The printed method has no test of whether a window straddles a change; its rows are never called changing.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import stdtrit

from agent.numerics.estimator.outcome import Outcome
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Hold, Model, StateSpace, discretise
from agent.numerics.paper.conditions import window_conditions
from agent.numerics.paper.seed import (
    Batch,
    Descent,
    Stopping,
    Structured,
    descend,
    general_solution,
    observe,
    output_batch,
    state_batch,
    structured,
)
from agent.numerics.paper.sensitivity import sensitivity_filter
from agent.numerics.paper.tuning import DEVIATIONS, ENOUGH, RUN_AWAY, SLOWEST
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import BoolArray, FloatArray, Reason, Status, WindowConditions


@dataclass(frozen=True, slots=True)
class SeedSettings:
    """Settings of the seed's estimator.

    Attributes:
        period_s: sampling period, s.
        plan: window and hop, samples.
        enough_sd: (q,) sd above which a window resolves no parameter.
        hold: how the input runs between samples; "euler" is the paper's (23).
        gain: (n, p) the observer's K_e, kept in every pass.
        passes: 1 is the method as printed.
        rank: directions solved in closed form before descent (`agent.numerics.paper.seed`); None: nothing is
            left.
        stopping: the rules that end descent.
        read: how parameters are read from the matrix of a pass; None is structured least squares over the
            batch.
        scale: (q,) size of each parameter: an estimate further away than a hundred times this has diverged.
        settled: share of the observer's first error that is left when it counts as settled.
    """

    period_s: float
    plan: HopPlan
    hold: Hold
    gain: FloatArray
    passes: int
    scale: FloatArray
    enough_sd: FloatArray
    settled: float = 1e-6
    rank: int | None = None
    stopping: Stopping = field(default_factory=Stopping)
    read: Callable[[FloatArray], FloatArray] | None = None


@dataclass(frozen=True, slots=True)
class SeedFit:
    """The seed's estimate from one window.

    Attributes:
        theta, sd: (q,) parameters and what the regression's residual says of them; NaN where it failed.
        dof: degrees of freedom of that residual.
        descents: those of Z, one a pass; each followed by that of W where gains of sensors are estimated.
        trail: (passes, q) parameters after each pass.
        settled: further passes would not move it by more than its sd says; only the stream (`SeedWindow`)
            asks.
        conditions: of the window, by its last pass; only of the stream, too.
    """

    theta: FloatArray
    sd: FloatArray
    dof: float
    descents: tuple[Descent, ...]
    trail: FloatArray
    settled: bool = True
    conditions: WindowConditions | None = None


def settling(model: StateSpace, gain: FloatArray, share: float) -> int:
    """Return the samples after which the observer has forgotten its first state to a share.

    Raises ValueError where the observer is not stable.
    """
    radius = float(np.max(np.abs(np.linalg.eigvals(model.A - gain @ model.C))))
    if not radius < 1.0:
        raise ValueError(
            f"the observer is not stable: its poles reach {radius:.6g}, (3) asks for less than 1"
        )
    return int(np.ceil(np.log(share) / np.log(max(radius, 1e-9))))


def regression(model: StateSpace, states: FloatArray, u: FloatArray) -> tuple[Batch, FloatArray]:
    """Return the batch of a window and the derivatives (q, n, r) of its matrix.

    Where the sampled input matrix depends on the parameters (every exact hold, not the paper's Euler model)
    the input joins the regressors, so that the matrix is (dA, dB).
    """
    moved = states[1:] - states[:-1] @ model.A.T - u @ model.B.T
    if not model.dB.any():
        return Batch(states[:-1], moved), model.dA
    return Batch(np.hstack([states[:-1], u]), moved), np.concatenate([model.dA, model.dB], axis=2)


def output_regression(
    model: StateSpace, states: FloatArray, y: FloatArray, u: FloatArray
) -> tuple[Batch, FloatArray]:
    """Return dC's batch over a window and its matrix's derivatives (q, p, r); inputs join where dD is any."""
    left = y - states[:-1] @ model.C.T - u @ model.D.T
    if not model.dD.any():
        return Batch(states[:-1], left), model.dC
    return Batch(np.hstack([states[:-1], u]), left), np.concatenate([model.dC, model.dD], axis=2)


def one_pass(
    model: StateSpace, settings: SeedSettings, states: FloatArray, y: FloatArray, u: FloatArray
) -> tuple[tuple[Descent, ...], Structured]:
    """Estimate from observer states (W+1, n) over a window and its readings y (W, p) and inputs u (W, m).

    Descent over Z gives what acts in the states' equation; descent over W gives what shows in the readings
    alone, the gains of sensors, where there are such.
    """
    batch, derivatives = regression(model, states, u)
    moves = np.asarray(derivatives.any(axis=(1, 2)), dtype=bool)
    descent, found = _descended(batch, derivatives[moves], settings)
    if settings.read is not None:
        found = replace(found, delta=settings.read(descent.M))
    if moves.all():
        return (descent,), found
    batch, derivatives = output_regression(model, states, y, u)
    reading, shown = _descended(batch, derivatives[~moves], settings)
    return (descent, reading), _merged(moves, found, shown)


def _descended(batch: Batch, derivatives: FloatArray, settings: SeedSettings) -> tuple[Descent, Structured]:
    """Return where descent on a batch ends, and the parameters (of derivatives (q, d, n)) read from it."""
    descent = descend(batch, general_solution(batch, settings.rank), settings.stopping)
    if not len(derivatives):
        return descent, Structured(np.zeros(0), np.zeros(0), float(batch.targets.size))
    return descent, structured(batch, descent.M, derivatives)


def _merged(moves: BoolArray, found: Structured, shown: Structured) -> Structured:
    """Put what acts in the states' equation and what shows in the readings in the parameters' order."""
    delta, sd = np.empty(len(moves)), np.empty(len(moves))
    delta[moves], delta[~moves] = found.delta, shown.delta
    sd[moves], sd[~moves] = found.sd, shown.sd
    return Structured(delta, sd, min(found.dof, shown.dof))


def fit_passes(
    model: Model, settings: SeedSettings, y: FloatArray, u: FloatArray, x0: FloatArray | None = None
) -> SeedFit:
    """Estimate from the last W samples of y (N, p), u (N, m); the observer starts at x0 (n,), else at zero.

    A pass whose estimate is not finite or has run away ends the passes with NaN.
    """
    theta = np.array(model.nominal, dtype=float)
    window = settings.plan.window
    trail = []
    descents: list[Descent] = []
    sd = np.full(len(theta), np.nan)
    dof = np.nan
    for _ in range(settings.passes):
        sampled = discretise(model.continuous(theta), settings.period_s, settings.hold).model
        start = np.zeros(sampled.n) if x0 is None else x0
        states = observe(sampled, settings.gain, y, u, start)[-window - 1 :]
        if not np.all(np.abs(states) < RUN_AWAY):
            theta = np.full(len(theta), np.nan)
            break
        made, found = one_pass(sampled, settings, states, y[-window:], u[-window:])
        theta, sd, dof = _kept(model, settings, theta + found.delta), found.sd, found.dof
        descents += made
        trail.append(theta)
        if not np.all(np.isfinite(theta)):
            break
    return SeedFit(theta, sd, dof, tuple(descents), np.array(trail))


def _kept(model: Model, settings: SeedSettings, theta: FloatArray) -> FloatArray:
    """Return theta, or NaN where it has run away."""
    near = np.all(np.abs(theta - model.nominal) <= 100.0 * settings.scale)
    return theta if near else np.full(len(theta), np.nan)


def remaining(
    model: Model, settings: SeedSettings, fit: SeedFit, y: FloatArray, u: FloatArray, x0: FloatArray
) -> FloatArray:
    """Return (q,) how far the passes have still to go, by two looks; inf where they do not come nearer.

    The innovation at the last point: what of it other parameters explain. The passes' steps: those to come
    are a geometric series of the ratio of the last two. A small last step alone says nothing: an observer
    that corrects little takes small steps wherever it is.
    """
    sampled = discretise(model.continuous(fit.theta), settings.period_s, settings.hold).model
    with np.errstate(all="ignore"):  # an observer that is not stable there is no number, which is looked at
        left = np.abs(innovation_step(sampled, settings, y, u, x0))
    if len(fit.trail) > 1:
        steps = np.diff(np.vstack([model.nominal, fit.trail]), axis=0)[-2:] / settings.scale
        before, last = np.linalg.norm(steps, axis=1).tolist()
        ratio = min(last / before if before > 0 else 0.0, SLOWEST)
        left = np.maximum(left, np.abs(steps[1]) * settings.scale * ratio / (1.0 - ratio))
    return np.where(np.isfinite(left), left, np.inf)


def innovation_step(
    model: StateSpace, settings: SeedSettings, y: FloatArray, u: FloatArray, x0: FloatArray
) -> FloatArray:
    """Return (q,) the change of parameters that best explains the last window's innovations; NaN without one.

    model: sampled where the passes ended. y (N, p), u (N, m), x0 (n,): the samples that the observer settles
    in, too.
    """
    system = sensitivity_filter(model, settings.gain)
    v = np.hstack([y, u])
    z = np.concatenate([x0, np.zeros(len(system.F) - system.n)])
    states = np.empty((len(v), len(system.F)))
    for k, push in enumerate(v @ system.N.T):
        states[k] = z
        z = system.F @ z + push
    window = settings.plan.window
    rows = states[-window:] @ system.H.T + v[-window:] @ system.J.T
    rows = rows.reshape(window, model.p, 1 + model.q)
    if not np.all(np.abs(rows) < RUN_AWAY):
        return np.full(model.q, np.nan)
    # outputs of any unit weigh by what is left of them
    rows = rows / np.maximum(np.sqrt(np.mean(rows[:, :, :1] ** 2, axis=0)), 1e-300)
    psi = rows[:, :, 1:].reshape(-1, model.q) * settings.scale
    step = np.linalg.lstsq(psi, rows[:, :, 0].ravel(), rcond=None)[0]
    return np.asarray(step * settings.scale)


class RowsAlone:
    """A method of estimation that makes rows and learns nothing."""

    spikes = 0

    def knowledge(self) -> None:
        """Return nothing: this method learns nothing that lasts."""

    def adopt(self, content: str) -> None:
        """Take nothing."""

    def hurry(self) -> None:
        """Go on as ever: rows are all that this method makes."""


class SeedWindow(RowsAlone):
    """The seed's estimator over a stream of samples; the same calls as `agent.numerics.estimator.sliding`.

    The observer's first pass runs once over the stream from state zero, as printed. A row counts as full when
    a whole window lies after the observer has settled.
    """

    def __init__(self, model: Model, settings: SeedSettings) -> None:
        self.model = model
        self.settings = settings
        self._sampled = discretise(model.continuous(model.nominal), settings.period_s, settings.hold).model
        self._run_up = settling(self._sampled, settings.gain, settings.settled)
        self._history = settings.plan.window + self._run_up
        self.start_segment()

    def start_segment(self) -> None:
        """Forget the samples before a gap."""
        model = self._sampled
        self._seen = 0
        self._states = np.zeros((1, model.n))
        self._y, self._u = np.zeros((0, model.p)), np.zeros((0, model.m))

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Outcome:  # fmt: skip
        """Take consecutive samples y (N, p), u (N, m), the first number `index`; return the rows they end."""
        self._append(y, with_constant(u, self._sampled.m))
        due = self.settings.plan.rows_between(index, index + len(y))
        rows = Outcome.warming(due, len(self.model.nominal))
        newest = index + len(y) - 1
        conditions: list[tuple[int, WindowConditions]] = []
        for row, at in enumerate(due.tolist()):
            after = newest - at
            if self._seen - after >= self._run_up + self.settings.plan.window:
                fit = self._fit(len(self._y) - after)
                self._write(rows, row, fit)
                conditions += [(at, fit.conditions)] if fit.conditions is not None else []
        self._trim()
        return replace(rows, conditions=tuple(conditions))

    def _append(self, y: FloatArray, u: FloatArray) -> None:
        states = observe(self._sampled, self.settings.gain, y, u, self._states[-1])
        self._states = np.concatenate([self._states, states[1:]])
        self._y, self._u = np.concatenate([self._y, y]), np.concatenate([self._u, u])
        self._seen += len(y)

    def _fit(self, stop: int) -> SeedFit:
        """Estimate from the window that ends before kept sample `stop`."""
        window = self.settings.plan.window
        start = max(0, stop - self._history)
        y, u, x0 = self._y[start:stop], self._u[start:stop], self._states[start]
        if self.settings.passes > 1:
            return self._examined(fit_passes(self.model, self.settings, y, u, x0), y, u, x0)
        states = self._states[stop - window : stop + 1]
        last = slice(stop - window, stop)
        made, found = one_pass(self._sampled, self.settings, states, self._y[last], self._u[last])
        theta = _kept(self.model, self.settings, self.model.nominal + found.delta)
        return self._examined(SeedFit(theta, found.sd, found.dof, made, theta[None]), y, u, x0)

    def _examined(self, fit: SeedFit, y: FloatArray, u: FloatArray, x0: FloatArray) -> SeedFit:
        """Add to a fit's sd what its passes have left, and say if that is too much to call it settled."""
        fit = replace(fit, conditions=self._conditions(fit, y, u, x0))
        if not np.all(np.isfinite(fit.theta)):
            return replace(fit, settled=False)
        left = remaining(self.model, self.settings, fit, y, u, x0)
        settled = np.all(left <= np.maximum(ENOUGH * self.settings.scale, DEVIATIONS * fit.sd))
        return replace(fit, sd=np.hypot(fit.sd, left), settled=bool(settled))

    def _conditions(
        self, fit: SeedFit, y: FloatArray, u: FloatArray, x0: FloatArray
    ) -> WindowConditions | None:
        """Return what conditions say of the window, by the observer on the nominal model as in the paper."""
        if not fit.descents:
            return None
        window, model = self.settings.plan.window, self._sampled
        states = observe(model, self.settings.gain, y, u, x0)[-window - 1 :]
        outputs = output_batch(model, states[:-1], y[-window:], u[-window:])
        a_pass = len(fit.descents) // len(fit.trail)
        return window_conditions(
            state_batch(model, states, u[-window:]), outputs, fit.descents[-a_pass:], fit.trail,
            np.asarray(self.model.nominal, dtype=float), self.settings.scale,
        )  # fmt: skip

    def _write(self, rows: Outcome, row: int, fit: SeedFit) -> None:
        half = stdtrit(fit.dof, 0.975) * fit.sd
        rows.theta[row], rows.sd[row], rows.sd_repeat[row] = fit.theta, fit.sd, fit.sd
        rows.lower[row], rows.upper[row] = fit.theta - half, fit.theta + half
        rows.dof[row], rows.window[row] = fit.dof, self.settings.plan.window
        known = fit.sd <= self.settings.enough_sd
        rows.status[row] = np.where(known, int(Status.VALID), int(Status.UNEXCITED))
        if not fit.settled:
            rows.invalidate(row, Reason.DIVERGED)

    def _trim(self) -> None:
        """Forget samples that no later row can need."""
        spare = len(self._y) - self._history - self.settings.plan.hop
        if spare > 0:
            self._states, self._y, self._u = self._states[spare:], self._y[spare:], self._u[spare:]
