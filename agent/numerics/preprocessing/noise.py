"""Sensor noise as readings show it without any model."""

import numpy as np

from agent.types import FloatArray


def sensor_noise(y: FloatArray) -> FloatArray:
    """Return the noise sd (p,) that fourth differences of y (N, p) show: motion is smooth over 5 samples."""
    differences = np.diff(y, n=4, axis=0)
    spread = np.median(np.abs(differences - np.median(differences, axis=0)), axis=0) / 0.6745
    return np.asarray(spread / np.sqrt(70.0))
