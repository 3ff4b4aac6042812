"""Which one constant of one channel, left free, would explain readings: its zero, its scale or its delay."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import log
from typing import Literal, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from agent.commissioning.tuning import FITS, LEAST_SHARE, MARGIN, NEAR, STILL, WIDE
from agent.numerics.fitting.fit import FittedModel, fit_window
from agent.numerics.fitting.skew import Group, SkewMeter
from agent.numerics.inference.spectral.columns import window_of
from agent.numerics.model.sensors import Nuisance, SensedModel, with_constant
from agent.numerics.preprocessing.noise import sensor_noise
from agent.types import FloatArray

Kind = Literal["offset", "scale", "delay"]
SMALLEST = {"offset": 0.0, "scale": log(1.03), "delay": 0.25}
"""Least size worth a word: any offset, 3 % (three times the data sheet's sd), a quarter of a sample."""


class WrongConstant(NamedTuple):
    """A hypothesis: by what one constant of one channel is wrong.

    kind, channel: which constant of which channel, inputs first; size: SI, factor, or s; share: (p,) of each
    output that is left; theta: the model's own parameters.
    """

    kind: Kind
    channel: int
    size: float
    share: FloatArray
    theta: FloatArray

    @property
    def left(self) -> float:
        """Share left, geometric mean over the outputs."""
        return float(np.exp(np.mean(np.log(np.maximum(self.share, 1e-12)))))


@dataclass(frozen=True)
class ChannelConstants:
    """Leaves each constant of each channel free in turn.

    Attributes:
        rig: its model.
        inputs: its measured inputs.
        complete: outputs and inputs -> all of the model's inputs.
    """

    rig: FittedModel
    inputs: int
    complete: Callable[[FloatArray, FloatArray], FloatArray]

    def find(self, v: FloatArray) -> tuple[float, Sequence[WrongConstant]]:
        """Return what readings v (N, c), inputs first, leave as is, and what explains them, best first."""
        u, y = v[:, : self.inputs], v[:, self.inputs :]
        noise = np.maximum(sensor_noise(y), 1e-12 * np.abs(y).max(axis=0) + 1e-300)
        rms = np.maximum(np.sqrt(np.mean(y**2, axis=0)), 1e-300)
        if not np.any(y.std(axis=0) > STILL * noise):
            return np.nan, ()
        with np.errstate(all="ignore"):  # of a model far from its rig the first fit is no number
            try:
                plain = self._fitted(self.rig, self.rig.model.nominal, y, self.complete(y, u))
            except (ValueError, np.linalg.LinAlgError):
                return np.nan, ()
        before = float(np.exp(np.mean(np.log(np.maximum(plain[0], 1e-12)))))
        fits = np.maximum(FITS * noise / rms, LEAST_SHARE)
        if np.all(plain[0] <= fits):
            return before, ()
        tried = [one for one in self._each(v) if one.kind == "offset" or np.all(one.share <= fits)]
        # twice the log likelihood ratio of white residuals whose sds are not known
        better = [one for one in tried if len(y) * np.sum(np.log(plain[0] / one.share)) > 2 * WIDE]
        better = [one for one in better if 2 * one.left < before]
        better.sort(key=lambda one: one.left)
        return before, tuple(one for one in better if one.left <= NEAR * better[0].left)

    def _each(self, v: FloatArray) -> Iterator[WrongConstant]:
        for channel in range(v.shape[1]):
            for attempt in (self._offset, self._scale, self._delay):
                with np.errstate(all="ignore"):  # what a wrong hypothesis does to a fit is its own affair
                    try:
                        one = attempt(v, channel)
                    except (ValueError, np.linalg.LinAlgError):
                        continue
                if one is not None and np.all(np.isfinite(one.share)):
                    yield one

    def _offset(self, v: FloatArray, channel: int) -> WrongConstant | None:
        share, theta = self._free("bias", v, channel)
        return WrongConstant("offset", channel, float(theta[-1]), share, theta[:-1])

    def _scale(self, v: FloatArray, channel: int) -> WrongConstant | None:
        share, theta = self._free("gain", v, channel)
        # an input's gain is what it is to be multiplied by, an output's what it was multiplied by
        factor = float(1.0 / theta[-1] if channel < self.inputs else theta[-1])
        if not factor > 0 or abs(log(factor)) < SMALLEST["scale"]:
            return None
        return WrongConstant("scale", channel, factor, share, theta[:-1])

    def _delay(self, v: FloatArray, channel: int) -> WrongConstant | None:
        y = v[:, self.inputs :]
        group = Group((channel,), ()) if channel < self.inputs else Group((), (channel - self.inputs,))
        meter = SkewMeter(replace(self.rig, sigma=self._noise(y)), (group,), self.inputs)
        spline = CubicSpline(np.arange(len(v)), v[:, channel])
        at = np.arange(MARGIN, len(v) - MARGIN)

        def resampled(delays: FloatArray) -> FloatArray:
            moved = v[MARGIN:-MARGIN].copy()
            moved[:, channel] = spline(at + np.clip(delays[0] / self.rig.period_s, -MARGIN, MARGIN))
            outputs = moved[:, self.inputs :]
            return np.hstack([outputs, self.complete(outputs, moved[:, : self.inputs])])

        found = meter.measure(resampled, np.zeros(1), self.rig.model.nominal)
        late = float(found.delay_s[0])
        if not found.sure or abs(late) / self.rig.period_s < SMALLEST["delay"]:
            return None
        share = self._fitted_columns(resampled(found.delay_s), found.theta)
        return WrongConstant("delay", channel, late, share, found.theta)

    def _noise(self, y: FloatArray) -> FloatArray:
        """(p,) what residuals are weighed by: no output more than a thousand times its size."""
        rms = np.sqrt(np.mean(y**2, axis=0))
        return np.asarray(np.maximum(sensor_noise(y), LEAST_SHARE * rms + 1e-300))

    def _free(
        self, kind: Literal["bias", "gain"], v: FloatArray, channel: int
    ) -> tuple[FloatArray, FloatArray]:
        u, y = v[:, : self.inputs], v[:, self.inputs :]
        side, number = ("input", channel) if channel < self.inputs else ("output", channel - self.inputs)
        inner = self.rig.model.model if isinstance(self.rig.model, SensedModel) else self.rig.model
        known = self.rig.model.nuisances if isinstance(self.rig.model, SensedModel) else ()
        if any((n.kind, n.side, n.number) == (kind, side, number) for n in known):
            raise ValueError("it is estimated already")
        freed = Nuisance(f"freed {kind}", kind, side, number)  # type: ignore[arg-type]
        model = SensedModel(inner, (*known, freed))
        size = 1.0 if kind == "gain" else max(float(np.std(v[:, channel])), 1e-300)
        u = with_constant(self.complete(y, u), model.continuous(model.nominal).m)
        freed_rig = self.rig.with_more(model, np.array([size]), np.array([-np.inf]))
        return self._fitted(freed_rig, model.nominal, y, u)

    def _fitted(
        self, rig: FittedModel, start: FloatArray, y: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the share (p,) left of each output, and the parameters there."""
        fitted = rig.of(self._noise(y), np.hstack([y, u]))
        fit = fit_window(fitted, window_of(y, u), start, max_steps=10, tolerance=0.1)
        return np.sqrt(fit.left / np.maximum(np.sum(y**2, axis=0), 1e-300)), fit.theta

    def _fitted_columns(self, columns: FloatArray, theta: FloatArray) -> FloatArray:
        p = len(self.rig.sigma)
        y, u = columns[:, :p], columns[:, p:]
        return self._fitted(self.rig, theta, y, u)[0]
