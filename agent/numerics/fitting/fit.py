"""Iterated maximum-likelihood fit of one window on its samples: variable projection with Levenberg-Marquardt steps.

The sliding estimate of `window` is one Gauss-Newton step about theta_r. Where the parameters have moved far this fit
iterates to the maximum, from a wide basin (with an observer that corrects) to the efficient one (without, where the
model allows it), and works on samples, so that it resolves residuals far below what a Gram matrix does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.eliminated import Unknowns
from agent.numerics.fitting.window_filter import WindowFilter, without_parameters
from agent.numerics.fitting.work import WORK
from agent.numerics.model.observer import Gain
from agent.numerics.model.statespace import Discrete, StateSpace
from agent.numerics.preprocessing.bridge import Bridge

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Linearised:
    """A window's innovations and sensitivities at one (theta, x0), the initial state projected out.

    Attributes:
        e: (W p,) innovations left, in units of their standard deviation.
        psi: (W p, q) sensitivities left.
        e0: (n,) correction of the initial state that was taken out.
        e0_by_theta: (n, q) how that correction moves with theta.
    """

    e: FloatArray
    psi: FloatArray
    e0: FloatArray
    e0_by_theta: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares left."""
        return float(self.e @ self.e)


@dataclass(frozen=True, slots=True)
class Fit:
    """The maximum of the likelihood on one window.

    Attributes:
        theta: (q,) estimate.
        x0: (n,) shifted state at the window's first sample.
        covariance: (q, q) for unit noise variance; inf on the diagonal where nothing is known.
        residual: (W, p) innovations left, in units of their standard deviation.
        psi: (W p, q) sensitivities, the initial state projected out.
        steps: Gauss-Newton steps taken.
        converged: the last step was below the tolerance.
    """

    theta: FloatArray
    x0: FloatArray
    covariance: FloatArray
    residual: FloatArray
    psi: FloatArray
    steps: int
    converged: bool


@dataclass(frozen=True, slots=True)
class Problem:
    """One window to fit.

    Attributes:
        sample: theta (q,) -> the sampled model there.
        v: (W, p+m) outputs and inputs.
        scale: (q,) size of each parameter, for tolerances and the weak prior that keeps what is unexcited in place.
        lower: (q,) bounds from below; -inf where there is none.
        bridge: the readings that v lacks, where it was filled.
    """

    sample: Callable[[FloatArray], Discrete]
    v: FloatArray
    scale: FloatArray
    lower: FloatArray
    bridge: Bridge | None = None

    def at(self, theta: FloatArray, gain: Gain, x0: FloatArray) -> Linearised:
        """Linearise the window about (theta, x0)."""
        return linearise(self.sample(theta).model, gain, self.v, x0, self.bridge)


def linearise(model: StateSpace, gain: Gain, v: FloatArray, x0: FloatArray, bridge: Bridge | None = None) -> Linearised:
    """Run observer (from x0) and sensitivities over a window v (W, p+m) and project the initial state out.

    What the window lacks (bridge) is eliminated too, by its prior where it has one.
    """
    WORK.evaluate(len(v))
    return linearised(WindowFilter(model, gain, len(v)), v, x0, bridge)


def linearised(window: WindowFilter, v: FloatArray, x0: FloatArray, bridge: Bridge | None = None) -> Linearised:
    """Linearise a window v (W, p+m), as `linearise` does, by filters that are there already."""
    n, q = window.system.n, window.system.q
    unknowns = Unknowns.of(window, bridge)
    best = unknowns.solve(unknowns.emptied(window.innovations(v, x0)[:, None]))
    e0 = best.state[:, 0]
    # the sensitivities at the best missing readings, as at the best initial state: else this is no gradient
    moved = unknowns.emptied(window.outputs(unknowns.completed(v, best.readings[:, 0]), x0))
    moved[:, 0] = best.rest[:, 0]
    moved[:, 1:] += unknowns.emptied(window.G[:, n:]).reshape(len(moved), q, n) @ e0
    again = unknowns.solve(moved)
    moved = unknowns.left_of(again)
    return Linearised(moved[:, 0], moved[:, 1:], e0, -again.state[:, 1:])


def least_cost(model: StateSpace, gain: Gain, v: FloatArray, x0: FloatArray, bridge: Bridge | None) -> float:
    """Return the sum of squares that a window v (W, p+m) leaves, its initial state and what it lacks eliminated."""
    WORK.evaluate(len(v))
    window = WindowFilter(without_parameters(model), gain, len(v))
    unknowns = Unknowns.of(window, bridge)
    return unknowns.least_cost(unknowns.emptied(window.innovations(v, x0)))


def fit_window(
    problem: Problem, theta: FloatArray, x0: FloatArray, gains: Sequence[Callable[[Discrete], Gain]],
    max_steps: int = 12, tolerance: float = 1e-5,
) -> Fit:  # fmt: skip
    """Maximise the likelihood of a window from (theta, x0), one stage a gain, the last one's maximum is returned.

    Each gain is a function of the sampled model at the stage's first point; within a stage it stays fixed.
    """
    fit = Fit(theta, x0, np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), 0, False)
    for stage, gain_at in enumerate(gains):
        last = stage == len(gains) - 1
        fit = _stage(problem, fit, gain_at(problem.sample(fit.theta)), max_steps, tolerance if last else 1e-2)
    return fit


def nowhere(problem: Problem, theta: FloatArray, x0: FloatArray) -> Fit:
    """Return what stands for a fit that failed from (theta, x0): it explains nothing and did not converge."""
    model, q = problem.sample(theta).model, len(theta)
    residual = problem.v[:, : model.p].copy()
    return Fit(theta, x0, np.full((q, q), np.inf), residual, np.zeros((residual.size, q)), 0, False)


def _stage(problem: Problem, start: Fit, gain: Gain, max_steps: int, tolerance: float) -> Fit:
    theta, x0, damping, converged = start.theta, start.x0, 0.0, False
    here = problem.at(theta, gain, x0)
    steps = 0
    while steps < max_steps and not converged:
        steps += 1
        step = _damped_step(here, damping, problem.scale)
        moved = np.maximum(theta + step, problem.lower)
        x_moved = x0 + here.e0 + here.e0_by_theta @ (moved - theta)
        there = problem.at(moved, gain, x_moved)
        small = bool(np.all(np.abs(moved - theta) <= tolerance * problem.scale))
        if there.cost <= here.cost * (1 + 1e-9) or small:
            theta, x0, here, converged = moved, x_moved, there, small
            damping *= 0.1 if damping > 1e-8 else 0.0
        elif np.isfinite(there.cost) or damping < 1e8:
            damping = max(10 * damping, 1e-3)
    return _finish(problem, replace(start, theta=theta, x0=x0, steps=start.steps + steps, converged=converged), here)


def _damped_step(here: Linearised, damping: float, scale: FloatArray) -> FloatArray:
    """Solve (H + damping diag H + weak prior) step = g in units of the parameters' sizes."""
    psi = here.psi * scale
    H = psi.T @ psi
    # the prior of ten times a parameter's size decides only where the data say nothing
    H += damping * np.diag(np.diag(H)) + 1e-2 * np.eye(len(scale)) * min(1.0, here.cost / max(len(here.e), 1))
    root = np.sqrt(np.maximum(np.diag(H), 1e-300))
    step = np.linalg.lstsq(H / np.outer(root, root), (psi.T @ here.e) / root, rcond=1e-15)[0] / root
    return np.asarray(np.clip(step, -0.9, 2.0) * scale)


def _finish(problem: Problem, fit: Fit, here: Linearised) -> Fit:
    """Take the last, undamped step on the samples by orthogonal factors and attach covariance and residual."""
    norms = np.linalg.norm(here.psi, axis=0)
    scale = np.where(norms > 0, 1.0 / np.where(norms > 0, norms, 1.0), 0.0)
    left, values, right = np.linalg.svd(here.psi * scale, full_matrices=False)
    sound = bool(norms.all()) and values[-1] > 1e-7 * values[0]
    p = len(here.e) // len(problem.v)
    if not sound:
        unknown = np.full((len(norms), len(norms)), np.inf)
        return replace(fit, x0=fit.x0 + here.e0, covariance=unknown, residual=here.e.reshape(-1, p), psi=here.psi)
    root = scale[:, None] * (right.T / values)
    step = root @ (left.T @ here.e)
    if not np.all(np.abs(step) <= 1e-2 * problem.scale):
        step = np.zeros_like(step)
    # a little beyond a bound is where noise puts half of the estimates of what lies on it: cut off they were biased
    theta = fit.theta + step
    x0 = fit.x0 + here.e0 + here.e0_by_theta @ (theta - fit.theta)
    residual = here.e - here.psi @ (theta - fit.theta)
    covariance = root @ root.T
    return replace(fit, theta=theta, x0=x0, covariance=covariance, residual=residual.reshape(-1, p), psi=here.psi)
