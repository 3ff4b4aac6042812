"""Steps of a parameter: where the level left its own noise at one instant, and stayed."""

from dataclasses import dataclass

import numpy as np

from agent.prognosis.history import History, blocks, sound
from agent.prognosis.tuning import APART, ASIDE, MANY, MOST_TAKEN, PARTS
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Step:
    """A step: when the first row after it was taken, how large it is and how sure that is."""

    t: float
    size: float
    sd: float


def find_steps(history: History) -> list[Step]:
    """Return steps in order of time, the MOST_TAKEN largest.

    The difference of the means on both sides is held against its own robust scatter over the history: a
    random walk or a drift has such differences everywhere, a step has one. What is no less on either side of
    it is a fast change.
    """
    thin = blocks(sound(history), PARTS)
    if len(thin) < 6 * ASIDE:
        return []
    found: list[Step] = []
    for _ in range(MOST_TAKEN):
        step = _largest(thin)
        if step is None:
            break
        found.append(step)
        thin = without(thin, [step])
    return sorted(found, key=lambda step: step.t)


def events(steps: list[Step]) -> list[Step]:
    """Return the steps that are events: none where there are MANY and all go one way, which is wear in steps.

    A repair, a sensor put elsewhere or a new reference moves a level once; layers that come off and cracks
    that jump move it again and again, and will.
    """
    one_way = len({step.size > 0.0 for step in steps}) == 1
    return [] if one_way and len(steps) >= MANY else steps


def without(history: History, steps: list[Step]) -> History:
    """Return the history as it were had its level always been where it is since the newest step."""
    value = history.value.copy()
    for step in steps:
        value[history.t < step.t] += step.size
    return History(history.t, value, history.sd)


def _running(values: FloatArray) -> FloatArray:
    """Return the means of each ASIDE neighbours."""
    sums = np.cumsum(np.r_[0.0, values])
    mean: FloatArray = (sums[ASIDE:] - sums[:-ASIDE]) / ASIDE
    return mean


def _largest(thin: History) -> Step | None:
    mean = _running(thin.value)
    variance = _running(thin.sd**2) / ASIDE
    apart = mean[ASIDE:] - mean[:-ASIDE]
    middle = float(np.median(apart))
    scatter = max(1.4826 * float(np.median(np.abs(apart - middle))), 1e-300)
    sds = np.maximum(scatter, np.sqrt(variance[ASIDE:] + variance[:-ASIDE]))
    k = int(np.argmax(np.abs(apart - middle) / sds))
    size = float(apart[k])
    sd = float(sds[k])
    inside = ASIDE <= k < len(apart) - ASIDE
    if not inside or abs(size - middle) < APART * sd:
        return None
    beside = max(abs(apart[k - ASIDE] - middle), abs(apart[k + ASIDE] - middle))
    return None if beside > 0.5 * abs(size - middle) else Step(float(thin.t[k + ASIDE]), size - middle, sd)
