"""Whether forecasts are as sure as they say: probability integral transform and coverage of a band."""

import numpy as np

from agent.types import FloatArray


def pit(draws: FloatArray, came: float) -> float:
    """Return the share of draws before what came; uniform over forecasts that are as sure as they say."""
    return float(np.mean(draws < came))


def held(p10: float, p90: float, came: float) -> bool:
    """Tell whether what came lies in the 80 % band."""
    return p10 <= came <= p90
