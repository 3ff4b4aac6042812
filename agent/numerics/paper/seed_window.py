"""The paper's estimator over a sliding window and over a stream (method = "seed").

One pass is the method as printed: the observer runs on the nominal parameters, the window's last W states give dA.
Each further pass puts the observer on the parameters of the pass before, with the physical structure imposed, and runs
it again over the window and the samples before it that it needs to settle. The fixed point is the exact answer, since
there the observer has nothing left to correct.

The printed method has no test of whether a window straddles a change; its rows are never called changing.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.faults.suspects import Accusation
from agent.numerics.model.statespace import Hold, Model, StateSpace, discretise
from agent.numerics.paper.seed import (
    Batch,
    Descent,
    Stopping,
    Structured,
    descend,
    general_solution,
    observe,
    structured,
)
from agent.numerics.window.hops import HopPlan
from agent.numerics.window.rows import Rows
from agent.types import Calibrated

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
RUN_AWAY = 1e60
"""States of an observer that is not stable any more, small enough for their squares to be figures."""


@dataclass(frozen=True, slots=True)
class SeedSettings:
    """What the seed's estimator is told.

    Attributes:
        period_s: sampling period, s.
        plan: window and hop, samples.
        hold: how the input runs between samples; "euler" is the paper's (23).
        gain: (n, p) the observer's K_e, kept in every pass.
        passes: 1 is the method as printed.
        rank: directions solved in closed form before descent (`agent.numerics.paper.seed`); None: nothing is left.
        stopping: the rules that end descent.
        read: how parameters are read from the matrix of a pass; None is structured least squares over the batch.
        scale: (q,) size of each parameter: an estimate further away than a hundred times this has diverged.
        settled: share of the observer's first error that is left when it counts as settled.
    """

    period_s: float
    plan: HopPlan
    hold: Hold
    gain: FloatArray
    passes: int
    scale: FloatArray
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
        descents: one a pass.
        trail: (passes, q) parameters after each pass.
    """

    theta: FloatArray
    sd: FloatArray
    dof: float
    descents: tuple[Descent, ...]
    trail: FloatArray


def settling(model: StateSpace, gain: FloatArray, share: float) -> int:
    """Return the samples after which the observer has forgotten its first state to a share.

    Raises ValueError where the observer is not stable.
    """
    radius = float(np.max(np.abs(np.linalg.eigvals(model.A - gain @ model.C))))
    if not radius < 1.0:
        raise ValueError(f"the observer is not stable: its poles reach {radius:.6g}, (3) asks for less than 1")
    return int(np.ceil(np.log(share) / np.log(max(radius, 1e-9))))


def regression(model: StateSpace, states: FloatArray, u: FloatArray) -> tuple[Batch, FloatArray]:
    """Return the batch of a window and the derivatives (q, n, r) of its matrix.

    Where the sampled input matrix depends on the parameters (every exact hold, not the paper's Euler model) the input
    joins the regressors, so that the matrix is (dA, dB).
    """
    moved = states[1:] - states[:-1] @ model.A.T - u @ model.B.T
    if not model.dB.any():
        return Batch(states[:-1], moved), model.dA
    return Batch(np.hstack([states[:-1], u]), moved), np.concatenate([model.dA, model.dB], axis=2)


def one_pass(
    model: StateSpace, settings: SeedSettings, states: FloatArray, u: FloatArray
) -> tuple[Descent, Structured]:
    """Estimate from the observer's states (W+1, n) over a window and its inputs u (W, m)."""
    batch, derivatives = regression(model, states, u)
    descent = descend(batch, general_solution(batch, settings.rank), settings.stopping)
    found = structured(batch, descent.M, derivatives)
    return descent, found if settings.read is None else replace(found, delta=settings.read(descent.M))


def fit_passes(
    model: Model, settings: SeedSettings, y: FloatArray, u: FloatArray, x0: FloatArray | None = None
) -> SeedFit:
    """Estimate from the last W samples of y (N, p), u (N, m); the observer starts at x0 (n,), zero where not given.

    A pass whose estimate is not finite or has run away ends the passes with NaN.
    """
    theta = np.array(model.nominal, dtype=float)
    window, trail, descents = settings.plan.window, [], []
    sd, dof = np.full(len(theta), np.nan), np.nan
    for _ in range(settings.passes):
        sampled = discretise(model.continuous(theta), settings.period_s, settings.hold).model
        start = np.zeros(sampled.n) if x0 is None else x0
        states = observe(sampled, settings.gain, y, u, start)[-window - 1 :]
        if not np.all(np.abs(states) < RUN_AWAY):
            theta = np.full(len(theta), np.nan)
            break
        descent, found = one_pass(sampled, settings, states, u[-window:])
        theta, sd, dof = _kept(model, settings, theta + found.delta), found.sd, found.dof
        descents.append(descent)
        trail.append(theta)
        if not np.all(np.isfinite(theta)):
            break
    return SeedFit(theta, sd, dof, tuple(descents), np.array(trail))


def _kept(model: Model, settings: SeedSettings, theta: FloatArray) -> FloatArray:
    """Return theta, or NaN where it has run away."""
    near = np.all(np.abs(theta - model.nominal) <= 100.0 * settings.scale)
    return theta if near else np.full(len(theta), np.nan)


class SeedWindow:
    """The seed's estimator over a stream of samples; the same calls as `agent.numerics.estimator.window_ml.WindowML`.

    The observer's first pass runs once over the stream from state zero, as printed. A row counts as full when a whole
    window lies after the observer has settled.
    """

    def __init__(self, model: Model, settings: SeedSettings) -> None:
        self.model = model
        self.settings = settings
        self._sampled = discretise(model.continuous(model.nominal), settings.period_s, settings.hold).model
        self._run_up = settling(self._sampled, settings.gain, settings.settled)
        self._history = settings.plan.window + (self._run_up if settings.passes > 1 else 0)
        self.start_segment()

    def calibrated(self) -> Calibrated | None:
        """Return nothing: this method learns no disturbances."""
        return None

    def adopt(self, known: Calibrated) -> None:
        """Take nothing."""

    def take_findings(self) -> list[tuple[int, Accusation]]:
        """Return nothing: this method does not ask what the model lacks."""
        return []

    def start_segment(self) -> None:
        """Forget the samples before a gap."""
        model = self._sampled
        self._seen = 0
        self._states = np.zeros((1, model.n))
        self._y, self._u = np.zeros((0, model.p)), np.zeros((0, model.m))

    spikes = 0

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None = None,
        suspect: BoolArray | None = None,
    ) -> Rows:  # fmt: skip
        """Take consecutive samples y (N, p), u (N, m), the first of them number `index`; return the rows they end."""
        self._append(y, u)
        due = self.settings.plan.rows_between(index, index + len(y))
        rows = Rows.warming(due, len(self.model.nominal))
        newest = index + len(y) - 1
        for row, at in enumerate(due.tolist()):
            after = newest - at
            if self._seen - after >= self._run_up + self.settings.plan.window:
                self._write(rows, row, self._fit(len(self._y) - after))
        self._trim()
        return rows

    def _append(self, y: FloatArray, u: FloatArray) -> None:
        states = observe(self._sampled, self.settings.gain, y, u, self._states[-1])
        self._states = np.concatenate([self._states, states[1:]])
        self._y, self._u = np.concatenate([self._y, y]), np.concatenate([self._u, u])
        self._seen += len(y)

    def _fit(self, stop: int) -> SeedFit:
        """Estimate from the window that ends before kept sample `stop`."""
        window = self.settings.plan.window
        if self.settings.passes == 1:
            states, u = self._states[stop - window : stop + 1], self._u[stop - window : stop]
            descent, found = one_pass(self._sampled, self.settings, states, u)
            theta = _kept(self.model, self.settings, self.model.nominal + found.delta)
            return SeedFit(theta, found.sd, found.dof, (descent,), theta[None])
        start = max(0, stop - self._history)
        return fit_passes(self.model, self.settings, self._y[start:stop], self._u[start:stop], self._states[start])

    def _write(self, rows: Rows, row: int, fit: SeedFit) -> None:
        rows.theta[row], rows.sd[row] = fit.theta, fit.sd
        rows.dof[row], rows.full[row], rows.ratio[row] = fit.dof, True, 1.0
        rows.mismatch[row] = not np.all(np.isfinite(fit.theta))

    def _trim(self) -> None:
        """Forget samples that no later row can need."""
        spare = len(self._y) - self._history - self.settings.plan.hop
        if spare > 0:
            self._states, self._y, self._u = self._states[spare:], self._y[spare:], self._u[spare:]
