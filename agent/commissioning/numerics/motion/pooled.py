"""Windows of one rig, joined: parameters and constants that are the same in all of them, estimated together.

Each window linearised at the same point says of deviations (δ, ξ) of parameters and constants

    cost = (δ - a + Z ξ)ᵀ V⁻¹ (δ - a + Z ξ) + ξᵀ S ξ - 2 gᵀ ξ

with its own initial state and noise eliminated. Costs add up; constants have the prior of their data sheets
once, so what these leave open is averaged by no number of windows. Gauss-Newton: the point moves until the
sum rests.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.commissioning import tuning
from agent.commissioning.numerics.motion.first_noise import Progress, first_noise
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.linearise import Linearised
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit, Ridge
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.columns import Window
from agent.numerics.model.uncertain import Rig
from agent.numerics.preprocessing.wire import Wire
from agent.types import BoolArray, FloatArray


@dataclass
class Costs:
    """What windows say of deviations d = (parameters in `unit`, constants) from a point: dᵀ H d - 2 hᵀ d.

    Attributes:
        theta, unit: (q,) the point, and what a deviation of 1 means.
        H, h: K of (q + c, q + c) and (q + c,);  prior, offset: the same of the data sheets.
    """

    theta: FloatArray
    unit: FloatArray
    prior: FloatArray
    offset: FloatArray
    H: list[FloatArray]
    h: list[FloatArray]

    @classmethod
    def none(cls, theta: FloatArray, prior: FloatArray, offset: FloatArray) -> "Costs":
        """Return the costs of no window."""
        return cls(theta.copy(), np.ones_like(theta), prior.copy(), offset.copy(), [], [])

    def add(self, H: FloatArray, h: FloatArray, unit: FloatArray) -> None:
        """Add a window's."""
        self.unit = unit
        self.H.append(H)
        self.h.append(h)


@dataclass(frozen=True)
class Pooled:
    """What all windows say together.

    Attributes:
        theta, sd, sd_repeat: (q,) parameters, their sd, and that of another record of the rig.
        correlation: (q, q).
        eta: (c,) logarithms of masses and gains, over what is configured.
        scatter: how many times more the windows differ than they should, as a variance.
        restless: (q,) parameters that were far from rest when the steps were over.
        known: what was learnt of the noise, at the point.
    """

    theta: FloatArray
    sd: FloatArray
    sd_repeat: FloatArray
    correlation: FloatArray
    eta: FloatArray
    scatter: float
    restless: BoolArray
    known: Knowledge

    @property
    def converged(self) -> bool:
        """Whether it came near to rest."""
        return not self.restless.any()


def pooled(
    rig: Rig,
    windows: Sequence[Window],
    sigma: FloatArray,
    spread: FloatArray,
    floor: FloatArray,
    wire: Wire,
    progress: Progress,
) -> Pooled:
    """Estimate from disjoint windows of one length, begun at nominal; sigma, spread, floor (p,) of noise.

    wire: what outputs come in.
    progress: is called with words for how far it is.
    """
    learner = Learner(rig, windows[0].length, len(sigma), floor, wire)
    learnt = first_noise(learner, windows, sigma, spread, progress)
    nominal = replace(learnt, theta=rig.nominal.copy(), eta=np.zeros(len(rig.constants)))
    # a window of another machine may teach parameters that run away
    known = max((learnt, nominal), key=lambda known: _Sum.of(learner, windows, known).log_likelihood)
    return _descended(learner, windows, known, progress)


def another(
    rig: Rig,
    windows: Sequence[Window],
    said: Pooled,
    theta: FloatArray,
    floor: FloatArray,
    progress: Progress,
) -> tuple[Pooled, float]:
    """Return where the sum comes to rest from theta (q,) under the same noise, and the evidence for that.

    Evidence is a log likelihood against that of `said`, over the ratio by which windows differ too much.
    """
    learner = Learner(rig, windows[0].length, len(floor), floor)
    eta = np.zeros(len(rig.constants))
    there = _descended(learner, windows, replace(said.known, theta=theta, eta=eta), progress)
    at_rest = [_Sum.of(learner, windows, known).log_likelihood for known in (there.known, said.known)]
    return there, (at_rest[0] - at_rest[1]) / max(said.scatter, there.scatter)


def _descended(learner: Learner, windows: Sequence[Window], known: Knowledge, progress: Progress) -> Pooled:
    """Return what the sum of windows says where it comes to rest.

    A full step may leave a curved valley and the next one come back to it further down, so steps that are
    worse are followed for a while; where none of them is better, the first is halved (the watchdog technique,
    Nocedal & Wright, Numerical Optimization, 2nd ed. 2006, section 15.6).
    """
    point = best = known
    progress(f"joining {len(windows)} windows, step 1")
    found = best_found = _Sum.of(learner, windows, known)
    share, tried = 1.0, 0
    for number in range(1, tuning.MOST_STEPS):
        if not tried and not found.restless.any():
            break
        progress(f"joining {len(windows)} windows, step {number + 1}")
        point = _moved(
            learner.rig, point, (1.0 if tried else share) * found.step_at(point.theta, learner.rig)
        )
        found = _Sum.of(learner, windows, point)
        tried += 1
        if found.log_likelihood > best_found.log_likelihood - tuning.WORSE * best_found.scatter:
            best, best_found, share, tried = point, found, 1.0, 0
        elif tried == tuning.PATIENCE:
            point, found, share, tried = best, best_found, 0.5 * share, 0
    if best_found.restless.any():
        return best_found.said(best, best_found.step)
    last = _moved(learner.rig, best, best_found.step_at(best.theta, learner.rig))
    return best_found.said(last, np.zeros_like(best_found.step))


def _moved(rig: Rig, known: Knowledge, step: FloatArray) -> Knowledge:
    """Return the point a step (q + c,) away, within what parameters and constants may be."""
    farthest = tuning.FARTHEST * np.array([constant.sheet for constant in rig.constants])
    eta = np.clip(known.eta + step[rig.q :], -farthest, farthest)
    return replace(known, theta=np.maximum(known.theta + step[: rig.q], rig.lower), eta=eta)


def _log_likelihood(learner: Learner, known: Knowledge, at: Linearised) -> float:
    """Return the log likelihood of the point in a window linearised there: initial states are free."""
    R = at.ridge.R.copy()
    for held in (at.regression.layout.psi, at.regression.layout.xi):
        R[held, held] = tuning.HELD * np.eye(held.stop - held.start)
    ridge = Ridge(R, np.zeros_like(R[0]))
    return NoiseFit(known.noise, at.cells, at.regression, learner.sources, ridge).restricted_log_likelihood()


def costs_of(
    rig: Rig, windows: Sequence[Window], said: Pooled, theta: FloatArray, floor: FloatArray
) -> tuple[Costs, float]:
    """Return what windows say of theta (q,) of a rig with more parameters than `said` is of, and the scatter.

    The noise is that which was learnt with fewer; constants stand where they were found.
    """
    learner = Learner(rig, windows[0].length, len(floor), floor)
    found = _Sum.of(learner, windows, replace(said.known, theta=theta))
    return found.costs, found.scatter


@dataclass(frozen=True)
class _Sum:
    """The windows' costs added at one point: step and covariance in units of parameters, then constants.

    log_likelihood: of the point, data sheets counted once.
    """

    unit: FloatArray
    step: FloatArray
    covariance: FloatArray
    given: FloatArray
    scatter: float
    costs: Costs
    log_likelihood: float

    @classmethod
    def of(cls, learner: Learner, windows: Sequence[Window], known: Knowledge) -> "_Sum":
        q = learner.rig.q
        c = len(learner.rig.constants)
        sheet = np.array([max(constant.sheet, 1e-6) for constant in learner.rig.constants])
        H, h = np.zeros((q + c, q + c)), np.zeros(q + c)
        H[q:, q:] = np.diag(sheet**-2.0)
        h[q:] = -known.eta * sheet**-2.0
        said = []
        costs = Costs.none(known.theta, H, h)
        log_likelihood = -0.5 * float(np.sum((known.eta / sheet) ** 2))
        for window in windows:
            at = learner.at_point(window, known)
            log_likelihood += _log_likelihood(learner, known, at)
            (S, g), (alone, V, Z) = at.information, at.given
            precision = inverse(V)
            J = np.hstack([np.eye(q), Z])
            H_w, h_w = J.T @ precision @ J, J.T @ (precision @ alone)
            H_w[q:, q:] += S
            h_w[q:] += g
            costs.add(H_w, h_w, at.unit)
            H, h = H + H_w, h + h_w
            said.append((alone, precision, Z))
        covariance = inverse(H)
        step = covariance @ h
        differing = [alone - Z @ step[q:] - step[:q] for alone, _, Z in said]
        total = sum(float(d @ W @ d) for d, (_, W, _) in zip(differing, said, strict=True))
        scatter = max(1.0, total / (q * max(len(said) - 1, 1)))
        return cls(at.unit, step, covariance, inverse(H[:q, :q]), scatter, costs, log_likelihood)

    @property
    def restless(self) -> BoolArray:
        """(q,) parameters that the step moves by much."""
        return self._steps_beyond(tuning.RESTS_SD)

    def _steps_beyond(self, sds: float) -> BoolArray:
        q = len(self.unit)
        return np.asarray(np.abs(self.step[:q]) > sds * np.sqrt(np.diag(self.covariance)[:q]))

    def step_at(self, theta: FloatArray, rig: Rig) -> FloatArray:
        """Return the step (q + c,) from theta (q,), in units of the parameters themselves.

        It takes none further than half its size; what has none (0) may go anywhere. Constants go as short a
        way: a parameter shortened beside a mass that is not would be neither the old motion nor the new.
        """
        moved = np.abs(self.unit) * self.step[: rig.q]
        size = np.where((rig.nominal != 0) & (theta != 0), np.abs(theta), np.inf)
        short = max(1.0, float(np.max(np.abs(moved) / (0.5 * size))))
        return np.concatenate([moved, self.step[rig.q :]]) / short

    def said(self, known: Knowledge, left: FloatArray) -> Pooled:
        """Return what the windows say of a point from which a step left (q + c,) is still to go."""
        q = len(self.unit)
        way = np.outer(left[:q], left[:q])
        own = self.scatter * self.given + way
        whole = self.covariance[:q, :q] + (self.scatter - 1.0) * self.given + way
        sd = np.sqrt(np.diag(whole))
        return Pooled(
            known.theta, np.abs(self.unit) * sd, np.abs(self.unit) * np.sqrt(np.diag(own)),
            whole / np.outer(sd, sd),
            known.eta, self.scatter, self._steps_beyond(tuning.NEAR_SD), known,
        )  # fmt: skip
