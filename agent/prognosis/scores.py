"""Forecast scores: continuous ranked probability score (CRPS), alpha-lambda accuracy."""

import numpy as np

from agent.types import FloatArray


def crps(draws: FloatArray, came: float) -> float:
    """Return the CRPS of finite draws (n,), in their unit (Gneiting & Raftery 2007, equation 21)."""
    ordered = np.sort(draws)
    n = len(ordered)
    pairs = float(ordered @ (2.0 * np.arange(1, n + 1) - n - 1.0)) / n**2
    return float(np.mean(np.abs(ordered - came))) - pairs


def alpha_lambda(p50: float, came: float, alpha: float = 0.2) -> bool:
    """Tell whether the remaining time was right to a share alpha of itself (Saxena et al. 2010)."""
    return abs(p50 - came) <= alpha * came
