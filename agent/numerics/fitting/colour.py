"""Coloured residuals: how much wider an honest interval is than white noise would have it.

The covariance of a least-squares estimate under noise of autocovariance r is H^-1 (psi' R psi) H^-1. r comes from an
autoregressive fit to the window's residual (Yule-Walker, order by Schwarz's criterion), and the middle is summed in
the frequency domain (Ljung, System Identification, 2nd ed. 1999, section 9.4).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.observer import Gain
from agent.numerics.model.statespace import StateSpace

FloatArray = NDArray[np.float64]
MOST_LAGS = 12


@dataclass(frozen=True, slots=True)
class InputNoise:
    """White noise of known size on the measured inputs, as the innovations show it.

    Attributes:
        response: (W, p, m) innovations, in units of their noise, at each sample after a reading of input j was wrong
            by one standard deviation.
    """

    response: FloatArray

    @classmethod
    def of(cls, model: StateSpace, gain: Gain, sd: FloatArray, samples: int) -> "InputNoise | None":
        """Return what sd (k,) of the first k inputs does over a window; None where none of them is noisy."""
        if not sd.any():
            return None
        push = (model.B - gain.L @ model.D)[:, : len(sd)] * sd
        Phi, seen = model.A - gain.L @ model.C, gain.whitening @ model.C
        response = np.empty((samples, model.p, len(sd)))
        response[0] = gain.whitening @ model.D[:, : len(sd)] * sd
        for k in range(1, samples):
            response[k], push = seen @ push, Phi @ push
        return cls(response)

    def middle(self, psi: FloatArray) -> FloatArray:
        """Return psi' R psi (q, q) for the covariance R of the innovations that this noise causes, psi (W, p, q)."""
        samples = len(psi)
        size = 2 * samples
        ahead = np.fft.rfft(psi, n=size, axis=0)
        total = np.zeros((psi.shape[2], psi.shape[2]))
        for j in range(self.response.shape[2]):
            shape = np.fft.rfft(self.response[:, :, j], n=size, axis=0)
            # what a wrong reading at each sample of the window adds to psi' e
            pushed = np.fft.irfft(np.einsum("fp,fpq->fq", shape.conj(), ahead), n=size, axis=0)[:samples]
            total += pushed.T @ pushed
        return total


SLOWER = 8
"""Each slower look at a coloured residual takes the means of this many values of the one before."""
LEAST_VALUES = 100
"""Fewer values than this tell no spectrum."""


@dataclass(frozen=True, slots=True)
class Colour:
    """What a window's residual says about its colour.

    Attributes:
        inflation: (q,) honest sd over the white one.
        share: effective degrees of freedom of the residual variance over their count, 0..1.
    """

    inflation: FloatArray
    share: float

    @classmethod
    def white(cls, q: int) -> "Colour":
        """Return the colour of white noise."""
        return cls(np.ones(q), 1.0)


def autoregression(e: FloatArray, most: int = MOST_LAGS) -> tuple[FloatArray, float]:
    """Fit e(k) = sum a_j e(k-j) + w(k) to one series (N,); return a (order,) and the variance of w.

    Order 0 is white; the order minimises Schwarz's criterion. Each order follows from the one before (Levinson 1947,
    Durbin 1960).
    """
    count = len(e)
    most = min(most, max(count // 10, 0))
    r = np.array([e[: count - lag] @ e[lag:] for lag in range(most + 1)]) / count
    a, variance = np.zeros(0), float(r[0])
    best, chosen = np.inf, (a, variance)
    for order in range(most + 1):
        if order and variance > 0:
            reflection = float(r[order] - a @ r[order - 1 : 0 : -1]) / variance
            a = np.append(a - reflection * a[::-1], reflection)
            variance *= 1.0 - reflection**2
        if variance <= 0:
            break
        criterion = count * np.log(variance) + order * np.log(count)
        if criterion < best:
            best, chosen = criterion, (a, variance)
    return chosen


def coloured_likelihood(residual: FloatArray, sigma: FloatArray) -> float:
    """Return the log likelihood of residuals (W, p), in units of sigma (p,), as one autoregression an output."""
    variances = np.array([autoregression(residual[:, channel])[1] for channel in range(residual.shape[1])])
    return float(-0.5 * len(residual) * np.sum(np.log(np.maximum(variances, 1e-300) * sigma**2) + 1.0))


def _unbiased(a: FloatArray, count: int, lost: float) -> FloatArray:
    """Undo the bias towards white of an autoregression fitted to residuals of slow regressors.

    The sum of the coefficients, which decides the spectrum at low frequency, comes out lower by about
    (lost (1 + a) + 2 a) / count (as in Kendall's formula, a regressor a lost degree of freedom).
    """
    total = float(a.sum())
    if not 0.0 < total < 1.0:
        return a
    mended = total + (lost * (1.0 + total) + 2.0 * total) / count
    return np.asarray(a * min(mended, 1.0 - 0.5 * (1.0 - total)) / total)


def colour_of(
    psi: FloatArray, residual: FloatArray, covariance: FloatArray, unknowns: int, inputs: InputNoise | None = None,
    varying: FloatArray | None = None,
) -> Colour:  # fmt: skip
    """Return the colour of a window.

    Args:
        psi: (W p, q) sensitivities with the initial state projected out, in units of the noise.
        residual: (W, p) what the fit left.
        covariance: (q, q) H^-1.
        unknowns: parameters and initial states that the fit took from the window.
        inputs: noise of the measured inputs; too weak beside the outputs' to be seen in the residual, it moves the
            estimates more, since it comes through the mechanics as slowly as what is estimated.
        varying: (W, p) how the noise's variance goes from sample to sample; None where it stays.
    """
    if varying is not None:
        return _varying(psi, residual, covariance, unknowns, inputs, varying)
    count, p = residual.shape
    q = psi.shape[1]
    middle, correlation, white = np.zeros((q, q)), 0.0, True
    for channel in range(p):
        a, variance = autoregression(residual[:, channel])
        white = white and not len(a)
        a = _unbiased(a, count, unknowns / p)
        density, total = _spectrum(a, variance, 2 * count)
        if len(a):
            density = _with_slow_part(density, residual[:, channel])
        spectrum = np.fft.rfft(psi.reshape(count, p, q)[:, channel], n=2 * count, axis=0)
        weights = np.full(len(spectrum), 2.0)
        weights[[0, -1]] = 1.0
        middle += np.real((spectrum.conj() * (density * weights)[:, None]).T @ spectrum) / (2 * count)
        correlation += total / p
    s2 = float(np.mean(residual**2))
    if white and inputs is None:
        return Colour.white(q)
    middle = psi.T @ psi * s2 if white else middle
    middle = middle if inputs is None else middle + inputs.middle(psi.reshape(count, p, q))
    honest = np.diag(covariance @ middle @ covariance)
    inflation = np.sqrt(np.maximum(honest, 0.0) / np.maximum(np.diag(covariance) * s2, 1e-300))
    return Colour(np.clip(inflation, 0.3, 30.0), 1.0 if white else 1.0 / correlation)


def _varying(
    psi: FloatArray, residual: FloatArray, covariance: FloatArray, unknowns: int, inputs: InputNoise | None,
    varying: FloatArray,
) -> Colour:  # fmt: skip
    """Return what noise of changing variance, perhaps common to all channels, adds: each sample speaks for itself.

    The middle is the sum over samples of psi' e e' psi (White, Econometrica 48 (1980) 817); the share is that of noise
    common to all channels, the least that there may be.
    """
    count, p = residual.shape
    pushed = np.einsum("kpq,kp->kq", psi.reshape(count, p, -1), residual)
    middle = pushed.T @ pushed * (count * p / max(count * p - unknowns, 1))
    middle = middle if inputs is None else middle + inputs.middle(psi.reshape(count, p, -1))
    honest = np.diag(covariance @ middle @ covariance)
    white = np.maximum(np.diag(covariance) * float(np.mean(residual**2)), 1e-300)
    total = varying.sum(axis=1)
    share = float(total.sum() ** 2 / (count * p * np.sum(total**2)))
    return Colour(np.clip(np.sqrt(np.maximum(honest, 0.0) / white), 0.3, 30.0), share)


def _spectrum(a: FloatArray, variance: float, size: int) -> tuple[FloatArray, float]:
    """Return the spectral density (size / 2 + 1,) and the sum of squared correlations over all lags."""
    transfer = np.fft.rfft(np.concatenate([[1.0], -a]), n=size)
    density = variance / np.abs(transfer) ** 2
    correlations = np.fft.irfft(density)
    correlations = correlations / correlations[0]
    return np.asarray(density), float(correlations @ correlations)


def _with_slow_part(density: FloatArray, e: FloatArray) -> FloatArray:
    """Raise a spectral density (size / 2 + 1,) to what slower looks at a series (N,) show below their own band.

    A dozen lags cannot show correlations of hundreds of samples, which is where slow regressors (a spring under a slow
    stroke, an offset) live.
    """
    means, factor, size = e, 1, 2 * (len(density) - 1)
    frequency = np.arange(len(density)) / size  # cycles a sample
    while len(means) // SLOWER >= LEAST_VALUES:
        means, factor = means[: len(means) // SLOWER * SLOWER].reshape(-1, SLOWER).mean(axis=1), factor * SLOWER
        a, variance = autoregression(means)
        lags = np.exp(-2j * np.pi * factor * np.outer(frequency, np.arange(1, len(a) + 1)))
        slow = factor * variance / np.abs(1.0 - lags @ a) ** 2
        density = np.where(frequency < 0.5 / factor, np.maximum(density, slow), density)
    return np.asarray(density)
