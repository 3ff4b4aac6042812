"""How much later one group of channels is read than another, as the model shows.

Two devices number their samples by themselves, or stamp them after delays of their own. The motion cannot be
late against the force that causes it, so a delay is one more parameter of the model, to first order

    y(t - d) = y - d y',   y' = C A x + C B u + D u'            u(t - d): u true = u + d u'

and exact where it matters: the readings are resampled by what was found and the fit is repeated until nothing
is left. Springs and dampers are fitted beside it, since a late reading looks like a damper (a delay of d on a
spring k takes k d from its damping) as long as no mass tells them apart.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agent.numerics.fitting.fit import FittedModel, fit_window
from agent.numerics.fitting.tuning import CLOSE, DELAY_SCALE_S, MOST_FITS, MOTION_SEEN
from agent.numerics.inference.spectral.columns import window_of
from agent.numerics.model.statespace import Model, StateSpace
from agent.numerics.preprocessing.noise import sensor_noise
from agent.types import FloatArray


class Group(NamedTuple):
    """Channels that are late together: numbers among the model's inputs and among its outputs."""

    inputs: tuple[int, ...]
    outputs: tuple[int, ...]


@dataclass(frozen=True)
class DelayedModel:
    """A model whose groups of channels are read late; theta is the model's own, then a delay (s) per group.

    Its inputs are the model's, then the rates of change of its first `rates` ones.
    """

    model: Model
    groups: tuple[Group, ...]
    rates: int

    @property
    def parameters(self) -> tuple[str, ...]:
        """The model's own parameters, then the delays."""
        return self.model.parameters + tuple(f"delay {i + 1}" for i in range(len(self.groups)))

    @property
    def nominal(self) -> FloatArray:
        """(q,) nominal values; delays are 0."""
        return np.concatenate([self.model.nominal, np.zeros(len(self.groups))])

    @property
    def state_names(self) -> tuple[str, ...]:
        """The model's states."""
        return self.model.state_names

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return the model with the delays at theta, and derivatives at the same place."""
        own = len(self.model.parameters)
        plain = self.model.continuous(theta[:own])
        return _widened(plain, self.groups, np.asarray(theta[own:]), self.rates)


def _widened(s: StateSpace, groups: Sequence[Group], delays: FloatArray, rates: int) -> StateSpace:
    m = s.m
    q = s.q + len(groups)
    B, D = np.zeros((s.n, m + rates)), np.zeros((s.p, m + rates))
    dA, dC = np.zeros((q, s.n, s.n)), np.zeros((q, s.p, s.n))
    dB, dD = np.zeros((q, s.n, m + rates)), np.zeros((q, s.p, m + rates))
    C = s.C.copy()
    B[:, :m] = s.B
    D[:, :m] = s.D
    dA[: s.q], dC[: s.q], dB[: s.q, :, :m], dD[: s.q, :, :m] = s.dA, s.dC, s.dB, s.dD
    # y' = CA x + CB u + D u', and its derivatives by the model's own parameters
    CA, CB = s.C @ s.A, s.C @ s.B
    dCA, dCB = s.dC @ s.A + s.C @ s.dA, s.dC @ s.B + s.C @ s.dB
    for number, (group, delay) in enumerate(zip(groups, delays.tolist(), strict=True)):
        row = s.q + number
        out = list(group.outputs)
        C[out] -= delay * CA[out]
        D[out, :m] -= delay * CB[out]
        D[out, m:] -= delay * s.D[out, :rates]
        dC[: s.q, out] -= delay * dCA[:, out]
        dD[: s.q, out, :m] -= delay * dCB[:, out]
        dC[row, out], dD[row, out, :m], dD[row, out, m:] = -CA[out], -CB[out], -s.D[out, :rates]
        for j in group.inputs:
            B[:, m + j] += delay * s.B[:, j]
            D[:, m + j] += delay * s.D[:, j]
            dB[: s.q, :, m + j] += delay * s.dB[:, :, j]
            dD[: s.q, :, m + j] += delay * s.dD[:, :, j]
            dB[row, :, m + j] += s.B[:, j]
            dD[row, :, m + j] += s.D[:, j]
    return StateSpace(s.A, B, C, D, dA, dB, dC, dD)


class Delays(NamedTuple):
    """What one stretch of samples tells: delays (g,) and their sd, s, and the model's own parameters there.

    sure: the fit found its maximum, and the stretch tells all delays. misfit: rms of what is left, in the
    noise's sd.
    """

    delay_s: FloatArray
    sd_s: FloatArray
    theta: FloatArray
    sure: bool
    misfit: float


class _Turn(NamedTuple):
    """One fit: the delays left and their sd (g,), the model's own parameters, rms of what is left."""

    step_s: FloatArray
    sd_s: FloatArray
    theta: FloatArray
    converged: bool
    misfit: float


@dataclass(frozen=True, slots=True)
class SkewMeter:
    """Measures delays of groups of channels on stretches of samples.

    Attributes:
        rig: its model.
        groups: channels that are late together, against those in no group.
        signals: inputs of the model that are measured; others (signs, the constant 1) have no rate of change.
    """

    rig: FittedModel
    groups: tuple[Group, ...]
    signals: int

    def measure(
        self, resampled: Callable[[FloatArray], FloatArray], start_s: FloatArray, theta: FloatArray
    ) -> Delays:
        """Find the delays of one stretch.

        Args:
            resampled: delays (g,), s -> outputs and inputs (N, p + m), each group's readings taken that much
                later.
            start_s: (g,) where to begin.
            theta: (q,) the model's own parameters to begin with.
        """
        delays, found = np.array(start_s, dtype=float), np.array(theta, dtype=float)
        for _ in range(MOST_FITS):
            turn = self._turn(resampled(delays), found)
            delays, found = delays + turn.step_s, turn.theta
            resolved = turn.converged and bool(np.all(np.isfinite(turn.sd_s)))
            near = resolved and bool(np.all(np.abs(turn.step_s) < CLOSE * turn.sd_s))
            if near or not resolved:
                break
        sure = resolved and bool(np.all(np.abs(turn.step_s) < turn.sd_s))
        return Delays(delays, turn.sd_s, found, sure, turn.misfit)

    def _turn(self, v: FloatArray, theta: FloatArray) -> "_Turn":
        """Fit once."""
        rig, signals = self.rig, self.signals
        p, g = len(rig.sigma), len(self.groups)
        y, u = v[:, :p], v[:, p:]
        # one row is lost at each end to the rates of change
        rates = (u[2:, :signals] - u[:-2, :signals]) / (2 * rig.period_s)
        columns = np.hstack([y[1:-1], u[1:-1], rates])
        delayed = DelayedModel(rig.model, self.groups, signals)
        widened = rig.with_more(delayed, np.full(g, DELAY_SCALE_S), np.full(g, -np.inf))
        fitted = widened.of(self._noise(y), columns)
        fit = fit_window(
            fitted, window_of(columns[:, :p], columns[:, p:]), np.concatenate([theta, np.zeros(g)])
        )
        unknowns = len(theta) + g + len(rig.model.state_names)
        variance = fit.cost / max(columns[:, :p].size - unknowns, 1)
        delay_variance = np.diag(fit.covariance)[-g:] * variance
        sd = np.sqrt(np.where(delay_variance > 0, delay_variance, np.inf))
        motion = (
            float(np.sum(((columns[:, :p] - columns[:, :p].mean(axis=0)) / fitted.sigma) ** 2)) - fit.cost
        )
        moves = motion > MOTION_SEEN * unknowns * variance
        return _Turn(fit.theta[-g:], sd, fit.theta[:-g], fit.converged and moves, float(np.sqrt(variance)))

    def _noise(self, y: FloatArray) -> FloatArray:
        """(p,) noise sd of each output: known, or as the readings show it."""
        guess = np.maximum(sensor_noise(y), 1e-9 * np.abs(y).max(axis=0) + 1e-300)
        return np.where(np.isfinite(self.rig.sigma), self.rig.sigma, guess)


class Skew(NamedTuple):
    """Delays (g,) over several stretches and the sd of that, s."""

    delay_s: FloatArray
    sd_s: FloatArray
    stretches: int


def combined(found: Sequence[Delays], floor_s: float) -> Skew | None:
    """Return what stretches say together; None with fewer than two that are sure.

    Their scatter counts where it is more than they state; one that is far off (a structure that changed
    within it) does not. floor_s is what no measurement is better than.
    """
    sure = [one for one in found if one.sure]
    if len(sure) < 2:
        return None
    delay, sd = np.array([one.delay_s for one in sure]), np.array([one.sd_s for one in sure])
    middle = np.median(delay, axis=0)
    away = np.abs(delay - middle)
    near = np.all(away <= 5 * (1.4826 * np.median(away, axis=0)) + 3 * sd + floor_s, axis=1)
    delay, sd = delay[near], sd[near]
    if len(delay) < 2:
        return None
    weight = 1.0 / (sd**2 + floor_s**2)
    mean = np.sum(weight * delay, axis=0) / np.sum(weight, axis=0)
    stated = 1.0 / np.sum(weight, axis=0)
    scatter = np.sum(weight * (delay - mean) ** 2, axis=0) / np.sum(weight, axis=0) / (len(delay) - 1)
    return Skew(mean, np.sqrt(np.maximum(stated, scatter) + floor_s**2), len(delay))
