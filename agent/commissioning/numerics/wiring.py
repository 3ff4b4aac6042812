"""Which channel is wired, signed or scaled wrongly, by the model: what explains the readings far better?

Each hypothesis mends the readings (two channels exchanged, one turned round, one divided by a factor) and
fits the model to them; what it leaves of each output is compared, as a share of that output, so that no unit
matters. A healthy rig leaves noise, and nothing leaves much less; a wrong channel leaves most of the motion,
and mending it noise.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.commissioning.numerics.channel_scale import factor_of_input, factor_of_output
from agent.commissioning.tuning import BETTER, EXPLAINED, FACTORS, FITS, LEAST_SHARE, NEAR, STILL, WORTH
from agent.numerics.fitting.fit import FittedModel, fit_window
from agent.numerics.inference.spectral.columns import window_of
from agent.numerics.model.statespace import discretise
from agent.numerics.preprocessing.noise import sensor_noise
from agent.types import FloatArray

REACH = log(4.0)
"""Logarithm of the factor by which wrong parameters may mislead the search for a scale."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One way in which channels may be wrong; numbers are channels, inputs first, then outputs.

    Attributes:
        kind: "sign", "scale" or "swap"; "none" for the readings as they are.
        channels: those concerned.
        factor: how many times too large the reading is, for "scale".
    """

    kind: str
    channels: tuple[int, ...] = ()
    factor: float = 1.0

    def mended(self, v: FloatArray) -> FloatArray:
        """Return readings (N, c), inputs first, as they would be if the fault were mended."""
        v = v.copy()
        if self.kind == "swap":
            first, second = self.channels
            v[:, [first, second]] = v[:, [second, first]]
        for channel in self.channels:
            v[:, channel] *= -1.0 if self.kind == "sign" else 1.0 / self.factor
        return v


AS_THEY_ARE = Hypothesis("none")


class Trial(NamedTuple):
    """What a hypothesis leaves: share of each output (p,), and the parameters (q,) with which it does."""

    hypothesis: Hypothesis
    share: FloatArray
    theta: FloatArray

    @property
    def left(self) -> float:
        """Share left, geometric mean over the outputs."""
        return float(np.exp(np.mean(np.log(np.maximum(self.share, LEAST_SHARE)))))


@dataclass(frozen=True, slots=True)
class Finding:
    """What is suspected: the best explanation first, then those that cannot be told from it.

    Attributes:
        explanations: hypotheses.
        before, after: share left of the outputs, geometric mean, by the readings as they are and as mended.
    """

    explanations: tuple[Hypothesis, ...]
    before: float
    after: float


@dataclass(frozen=True)
class Examiner:
    """Examines stretches of readings of one rig.

    Attributes:
        rig: its model.
        inputs: its measured inputs.
        elastic: (q,) which parameters are springs, dampers or the like, all in proportion to the force.
        complete: outputs and inputs -> all of the model's inputs.
        progress: called with how many of how many hypotheses are examined.
    """

    rig: FittedModel
    inputs: int
    elastic: NDArray[np.bool_]
    complete: Callable[[FloatArray, FloatArray], FloatArray]
    progress: Callable[[int, int], None] = field(default=lambda _done, _all: None)

    def examine(self, stretches: Sequence[FloatArray]) -> Finding | None:
        """Return one suspected fault of stretches of readings (N, c), inputs first; None if none."""
        moving = [v for v in stretches if self._moves(v)]
        return self._finding(moving) if moving else None

    def _moves(self, v: FloatArray) -> bool:
        y = v[:, self.inputs :]
        return bool(np.any(y.std(axis=0) > STILL * self._noise(y)))

    def _noise(self, y: FloatArray) -> FloatArray:
        return np.asarray(np.maximum(sensor_noise(y), 1e-12 * np.abs(y).max(axis=0)))

    def _finding(self, stretches: Sequence[FloatArray]) -> Finding | None:
        plain = self._try(AS_THEY_ARE, stretches)
        if not np.isfinite(plain.left) or self._fits(plain, stretches):
            return None
        candidates = list(self._candidates(stretches[0]))
        trials = []
        for number, hypothesis in enumerate(candidates):
            self.progress(number, len(candidates))
            trials.append(self._try(hypothesis, stretches[:1]))
        self.progress(len(candidates), len(candidates))
        # one stretch shows which are worth all of them
        least = min((trial.left for trial in trials), default=np.inf)
        trials = [self._try(t.hypothesis, stretches) for t in trials if t.left <= WORTH * least]
        good = [
            t
            for t in trials
            if t.left * BETTER < plain.left and t.share.max() < EXPLAINED and self._plausible(t)
        ]
        if not good:
            return None
        best = min(good, key=lambda trial: trial.left)
        near = sorted((t for t in good if t.left <= NEAR * best.left), key=self._oddity)
        return Finding(tuple(t.hypothesis for t in near), plain.left, best.left)

    def _oddity(self, trial: Trial) -> float:
        """How far an explanation's springs and dampers lie from nominal; the likelier one has less."""
        return float(np.abs(self._ratios(trial.theta)).mean())

    def _ratios(self, theta: FloatArray) -> FloatArray:
        """Logarithms of the springs and dampers against their nominals."""
        nominal = self.rig.model.nominal
        counted = self.elastic & (nominal > 0)
        if not counted.any():
            return np.zeros(1)
        return np.log(np.maximum(theta[counted] / nominal[counted], 1e-3))

    def _plausible(self, trial: Trial) -> bool:
        return bool(np.median(np.abs(self._ratios(trial.theta))) < log(5.0))

    def _fits(self, plain: Trial, stretches: Sequence[FloatArray]) -> bool:
        """Whether the readings as they are leave no more than noise."""
        y = np.vstack([v[:, self.inputs :] for v in stretches])
        rms = np.maximum(np.sqrt(np.mean(y**2, axis=0)), 1e-300)
        noise = np.mean([self._noise(v[:, self.inputs :]) for v in stretches], axis=0)
        stated = np.where(np.isfinite(self.rig.sigma), np.maximum(noise, self.rig.sigma), noise)
        return bool(np.all(plain.share <= np.maximum(FITS * stated / rms, LEAST_SHARE)))

    def _candidates(self, v: FloatArray) -> Iterator[Hypothesis]:
        """Every exchange, and for each channel signs and factors near what the nominal model suggests."""
        count = v.shape[1]
        if count < 2:
            return  # a single channel has nothing to contradict it
        for pair in combinations(range(count), 2):
            yield Hypothesis("swap", pair)
        for channel in range(count):
            yield Hypothesis("sign", (channel,))
            guess = self._scale_guess(v, channel)
            for factor in (f**sign for f in FACTORS for sign in (1, -1)):
                if guess is None or abs(log(factor) - log(guess)) < REACH:
                    yield Hypothesis("scale", (channel,), factor)

    def _scale_guess(self, v: FloatArray, channel: int) -> float | None:
        """How many times too large a channel is if the nominal model is right, roughly; None if unclear."""
        u, y = v[:, : self.inputs], v[:, self.inputs :]
        sampled = discretise(
            self.rig.model.continuous(self.rig.model.nominal), self.rig.period_s, self.rig.hold
        )
        if channel >= self.inputs:
            return factor_of_output(sampled, y, self.complete(y, u), channel - self.inputs)
        others = u.copy()
        others[:, channel] = 0.0
        return factor_of_input(sampled, y, self.complete(y, u), self.complete(y, others))

    def _try(self, hypothesis: Hypothesis, stretches: Sequence[FloatArray]) -> Trial:
        """Fit the model to mended stretches."""
        outputs = stretches[0].shape[1] - self.inputs
        squares = np.zeros(outputs)
        signal = np.zeros(outputs)
        theta = self.rig.model.nominal
        for v in stretches:
            left, power, theta = self._left(hypothesis.mended(v))
            squares, signal = squares + left, signal + power
        share = np.sqrt(squares / np.maximum(signal, 1e-300))
        return Trial(hypothesis, np.where(np.isfinite(share), share, np.inf), theta)

    def _left(self, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return sums of squares (p,) of output residuals and of outputs, and the parameters there."""
        u, y = v[:, : self.inputs], v[:, self.inputs :]
        power = np.sum(y**2, axis=0)
        # no output is weighed more than a thousand times its size, or its noise alone would decide
        sigma = np.maximum(self._noise(y), LEAST_SHARE * np.sqrt(power / len(y)) + 1e-300)
        u = self.complete(y, u)
        fitted = self.rig.of(sigma, np.hstack([y, u]))
        with np.errstate(
            all="ignore"
        ):  # what a wrong hypothesis does to a fit is its own affair: it leaves everything
            try:
                fit = fit_window(fitted, window_of(y, u), self.rig.model.nominal, max_steps=8, tolerance=0.1)
            except (ValueError, np.linalg.LinAlgError):
                return np.full_like(power, np.inf), power, self.rig.model.nominal
        return fit.left, power, fit.theta
