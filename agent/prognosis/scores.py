"""Forecast scores: coverage, probability integral transform, continuous ranked probability score (CRPS)."""

import numpy as np

from agent.types import FloatArray


def crps(draws: FloatArray, came: float) -> float:
    """Return the CRPS of finite draws (n,), in their unit (Gneiting & Raftery 2007, equation 21)."""
    ordered = np.sort(draws)
    n = len(ordered)
    pairs = float(ordered @ (2.0 * np.arange(1, n + 1) - n - 1.0)) / n**2
    return float(np.mean(np.abs(ordered - came))) - pairs


def pit(draws: FloatArray, came: float) -> float:
    """Return the share of draws before what came; uniform over forecasts that are as sure as they say."""
    return float(np.mean(draws < came))


def held(p10: float, p90: float, came: float) -> bool:
    """Tell whether what came lies in the 80 % band."""
    return p10 <= came <= p90


def alpha_lambda(p50: float, came: float, alpha: float = 0.2) -> bool:
    """Tell whether the remaining time was right to a share alpha of itself (Saxena et al. 2010)."""
    return abs(p50 - came) <= alpha * came


def before_limit(draws: FloatArray, farthest: float) -> FloatArray:
    """Return draws of which those that never come, or later, are `farthest`: a score needs finite ones."""
    return np.minimum(draws, farthest)
