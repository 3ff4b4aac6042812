"""What became of a forecast: whether and when the limit was reached, and how good the forecast was."""

import numpy as np

from agent.prognosis.scores import crps
from agent.prognosis.tuning import DRAW_DIGITS, DRAWS, NEEDED, NEXT
from agent.types import BoolArray, FloatArray


def beyond(value: FloatArray, limit: float, way: float) -> BoolArray:
    """Tell of each row (n,) whether it lies beyond a limit and most of the next ones do too.

    way: limit less the level that the forecast began with; its sign is the side.
    """
    past = (value - limit) * np.sign(way) >= 0.0
    if not len(past):
        return np.zeros(0, dtype=np.bool_)  # a convolution knows no empty rows
    count = np.convolve(past[::-1], np.ones(NEXT), mode="full")[: len(past)][::-1]
    return np.asarray(past & (count >= NEEDED))


def representative(passages: FloatArray, farthest: float) -> list[float]:
    """Return equally probable draws for sorted ones (n,), in their unit; what never comes is `farthest`."""
    if not len(passages):
        return []
    places = ((np.arange(DRAWS) + 0.5) / DRAWS * len(passages)).astype(np.int64)
    return [float(f"{draw:.{DRAW_DIGITS}g}") for draw in np.minimum(passages[places], farthest)]


def score(draws: FloatArray, came: float, *, censored: bool) -> float | None:
    """Return the CRPS of draws (n,); censored: nothing came until then, and later draws count as then."""
    if not len(draws):
        return None
    return crps(np.minimum(draws, came) if censored else draws, came)
