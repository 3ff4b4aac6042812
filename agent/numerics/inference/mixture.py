"""Quantiles of Gaussian mixtures."""

import numpy as np
from scipy.special import ndtr

from agent.numerics.inference.tuning import LEAST_WEIGHT, STANDING_WEIGHT
from agent.types import FloatArray

NORMAL_975 = 1.959963984540054  # fixed by statistics


def interval95(weight: FloatArray, mean: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return 95 % intervals (q,), (q,) of mixtures with weight (h,), mean and sd (h, q).

    They are the 2.5 and 97.5 % quantiles, by bisection, widened to hold the own intervals of all components
    that stand: where explanations tie, the true one may lie at the mixture's edge, and must be held as surely
    as the others.
    """
    kept = weight > LEAST_WEIGHT
    weight, mean, sd = weight[kept] / weight[kept].sum(), mean[kept], sd[kept]
    level = np.array([0.025, 0.975])[:, None]
    # the mixture's quantile lies between those of its components
    ends = mean[:, None] + np.array([-NORMAL_975, NORMAL_975])[:, None] * sd[:, None]
    low = ends.min(axis=0)
    high = ends.max(axis=0)
    for _ in range(24 if (low < high).any() else 0):
        middle = 0.5 * (low + high)
        above = weight @ ndtr((middle[:, None] - mean) / sd) > level
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    found = 0.5 * (low + high)
    standing = ends[weight >= STANDING_WEIGHT * weight.max()]
    lower = np.minimum(found[0], standing[:, 0].min(axis=0, initial=np.inf))
    upper = np.maximum(found[1], standing[:, 1].max(axis=0, initial=-np.inf))
    return lower, upper
