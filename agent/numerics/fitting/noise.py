"""What disturbs a rig: white sensor noise and unknown forces, found by the likelihood of the innovations.

An observer without correction is efficient under sensor noise alone; with unknown forces only the Kalman gain of the
right intensities is. One intensity a mass, each of which may be nothing (Ljung, System Identification, 2nd ed. 1999,
sections 7.4 and 10.5).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from agent.numerics.fitting.fit import least_cost
from agent.numerics.model.observer import Gain, Noise, matched_gain
from agent.numerics.model.statespace import Discrete
from agent.numerics.preprocessing.bridge import Bridge

FloatArray = NDArray[np.float64]

EVIDENCE = 12.0
"""Gain in log likelihood that an unknown force must bring for each mass that it is assumed on."""
_QUIETEST = -8.0  # decades of force noise below the strongest that is tried
_UNLIKELY = 1e300
"""What stands for an infinite cost, since the simplex subtracts costs."""
_SCAN = (-6.5, -5.0, -3.5, -2.0, -0.5)


def sensor_noise(y: FloatArray) -> FloatArray:
    """Return the noise sd (p,) that fourth differences of y (N, p) show: motion is smooth over five samples."""
    differences = np.diff(y, n=4, axis=0)
    spread = np.median(np.abs(differences - np.median(differences, axis=0)), axis=0) / 0.6745
    return np.asarray(spread / np.sqrt(70.0))


@dataclass(frozen=True, slots=True)
class Record:
    """A calibration record: v (N, p+m), where the observer starts, x0 (n,), and what v lacks."""

    v: FloatArray
    x0: FloatArray
    bridge: Bridge | None = None


@dataclass(frozen=True, slots=True)
class Likelihood:
    """Log likelihood of a noise model, and the factor on all its standard deviations that maximises it."""

    value: float
    scale: float


def likelihood(discrete: Discrete, gain: Gain, record: Record, *, scale_known: bool) -> Likelihood:
    """Return the log likelihood of the innovations under a gain, the initial state projected out."""
    model = discrete.model
    squares = least_cost(model, gain, record.v, record.x0, record.bridge)
    free = 0 if record.bridge is None else record.bridge.free
    count = len(record.v) * model.p - model.n - free
    log_det = len(record.v) * np.log(np.linalg.det(gain.whitening))
    if scale_known:
        return Likelihood(float(log_det - 0.5 * squares), 1.0)
    scale2 = max(squares / count, 1e-300)
    return Likelihood(float(log_det - 0.5 * count * (np.log(scale2) + 1.0)), float(np.sqrt(scale2)))


def find_process(
    discrete: Discrete, disturbance: FloatArray, sigma: FloatArray, record: Record, *,
    scale_known: bool, unless_above: float | None = None, roughly: bool = False,
) -> tuple[Noise, float] | None:  # fmt: skip
    """Return the disturbances that are most likely, with at least one unknown force, and their log likelihood.

    Intensities are continuous in their logarithm; the search starts with equal ones and with each direction alone.
    None where no intensities have a stable observer, as with parameters that a fit ran away to. With unless_above, None
    too where a coarse scan does not come near that log likelihood. Roughly: to half a decade, for
    a model that is rough itself.
    """
    directions = disturbance.shape[1]
    strongest = _strongest(discrete, disturbance, sigma)

    known: dict[bytes, float] = {}

    def value(process: FloatArray) -> float:
        # the scans of several starts meet the same points
        key = process.tobytes()
        if key not in known:
            known[key] = _value(discrete, disturbance, Noise(sigma, process), record, scale_known=scale_known)
        return known[key]

    starts = [np.ones(directions)]
    starts += [np.eye(directions)[i] for i in range(directions) if directions > 1]
    if unless_above is not None and not any(_worth(value, start * strongest, unless_above) for start in starts):
        return None
    found = [_climb(value, start * strongest, 5.0 if roughly else 1.0) for start in starts]
    best, process = max(found, key=lambda item: item[0] - EVIDENCE * np.count_nonzero(item[1]))
    if not np.isfinite(best):
        return None
    noise = Noise(sigma, process)
    if scale_known:
        return noise, best
    scale = likelihood(discrete, matched_gain(discrete, disturbance, noise), record, scale_known=False).scale
    return Noise(sigma * scale, process * scale), best


def _value(discrete: Discrete, disturbance: FloatArray, noise: Noise, record: Record, *, scale_known: bool) -> float:
    """Return the log likelihood of a record; -inf where the disturbances have no stable observer."""
    try:
        gain = matched_gain(discrete, disturbance, noise)
    except ValueError:
        return -np.inf
    found = likelihood(discrete, gain, record, scale_known=scale_known).value
    return found if np.isfinite(found) else -np.inf


def _strongest(discrete: Discrete, disturbance: FloatArray, sigma: FloatArray) -> FloatArray:
    """Forces (d,) whose displacement within one sample would be like the sensors' noise: no stronger are searched."""
    effect = np.linalg.norm(discrete.model.C @ discrete.model.A @ disturbance, axis=0) * discrete.period_s
    return np.asarray(np.sqrt(np.mean(sigma**2)) / np.maximum(effect, 1e-300))


def _worth(value: Callable[[FloatArray], float], strongest: FloatArray, above: float) -> bool:
    return any(value(strongest * 10.0**exponent) > above for exponent in _SCAN)


def _climb(value: Callable[[FloatArray], float], strongest: FloatArray, tolerance: float) -> tuple[float, FloatArray]:
    """Maximise over the logarithms of the nonzero intensities: a scan together, then a simplex for each its own."""
    active = strongest > 0

    def process(exponents: FloatArray) -> FloatArray:
        full = np.zeros(len(strongest))
        full[active] = strongest[active] * 10.0 ** np.clip(exponents, _QUIETEST, 1.0)
        return full

    count = int(active.sum())
    together = max(_SCAN, key=lambda exponent: value(process(np.full(count, exponent))))

    def cost(exponents: FloatArray) -> float:
        return min(-value(process(exponents)), _UNLIKELY)

    start = np.full(count, together)
    if cost(start) >= _UNLIKELY:
        return -np.inf, process(start)  # a simplex finds no way down where nothing is finite
    tolerances = {"xatol": 0.1 * tolerance, "fatol": 0.1 * tolerance**2, "maxfev": 60 * count}
    result = minimize(cost, start, method="Nelder-Mead", options=tolerances)  # type: ignore[call-overload]
    return float(-result.fun), process(np.asarray(result.x))


def share_of_motion(discrete: Discrete, disturbance: FloatArray, noise: Noise, v: FloatArray) -> float:
    """Return how much of what the outputs of a record v (N, p+m) do the unknown forces cause: rms over rms."""
    model = discrete.model
    push = disturbance * noise.process * discrete.period_s
    # sum over the first 2^k samples after each push, by doubling, as many as the record has
    power, caused, samples = model.A, push @ push.T, 1
    while 2 * samples <= len(v):
        caused, power, samples = caused + power @ caused @ power.T, power @ power, 2 * samples
    variance = np.diag(model.C @ caused @ model.C.T)
    seen = np.maximum(v[:, : model.p].var(axis=0), noise.sigma**2)
    return float(np.sqrt(np.mean(variance / seen)))
