"""The posterior of an intensity between the nodes of its grid, from what it is on them."""

import numpy as np

from agent.numerics.inference import tuning
from agent.types import FloatArray

H = np.log(tuning.NODE_RATIO)
_PARTS = 8
"""Parts of the step from node to node."""
_t = np.arange(1, _PARTS) / _PARTS
_HERMITE = np.stack([
    (1 + 2 * _t) * (1 - _t) ** 2, _t * (1 - _t) ** 2, _t**2 * (3 - 2 * _t), _t**2 * (_t - 1),
])
"""(4, parts - 1) cubic by the values and slopes at both ends."""
_UP, _DOWN = np.expm1(-2 * H), np.expm1(2 * H)


def slopes(logs: FloatArray) -> FloatArray:
    """Return slopes (k,) a node of log posteriors (k,) by that of a variance, c - a x - b exp(-2 x)."""
    if len(logs) < 3:
        return np.full(len(logs), logs[-1] - logs[0] if len(logs) > 1 else 0.0)
    step = np.diff(logs)
    up, down = step[1:], -step[:-1]
    b = -(up + down) / (_UP + _DOWN)
    out = np.empty(len(logs))
    out[1:-1] = up + b * _UP + 2 * H * b
    out[0], out[-1] = step[0], step[-1]
    return out


def mean(logs: FloatArray, nodes: FloatArray, absent: float) -> float:
    """Return the mean of an intensity of log posteriors (k,) on nodes (k,), uniform between; absent: log
    prior of the first of them, in place of a node's, or 0."""
    logs = np.maximum(logs - logs.max(), -700.0)
    first = int(absent > 0)
    inner, at = logs[first:], nodes[first:]
    weight, total = 0.0, 0.0
    if first:
        weight = float(np.exp(logs[0] + absent))
        total = weight * nodes[0]
    if len(inner) > 1:
        s = slopes(inner)
        ends = np.stack([inner[:-1], s[:-1], inner[1:], s[1:]], axis=1)
        between = ends @ _HERMITE
        top = max(0.0, float(between.max()))
        w = np.exp(between - top) / _PARTS
        v = at[:-1, None] * tuning.NODE_RATIO**_t
        own = np.exp(inner - top) / _PARTS
        own[[0, -1]] += 0.5 * (1 - 1 / _PARTS) * np.exp(inner[[0, -1]] - top)
        scale = np.exp(-top)
        return float((total * scale + own @ at + (w * v).sum()) / (weight * scale + own.sum() + w.sum()))
    own = np.exp(inner)
    return float((total + own @ at) / (weight + own.sum()))


def moved(
    logs: FloatArray, nodes: FloatArray, lo: int, to: float
) -> tuple[FloatArray, FloatArray]:
    """Return a grid (G,) with a node at `to`, and log weights (G,) there, of logs (k,) on nodes lo .. lo + k.

    The first node, which stands for "absent", stays; the others are a step apart.
    """
    count = len(nodes)
    floor = tuning.LOWEST_LOG_WEIGHT
    wanted = np.log(max(to, nodes[0]) / nodes[0]) / H
    offset = wanted - np.round(wanted)
    places = np.arange(count) + offset  # in steps from the first
    old = np.arange(count) + np.log(nodes[1] / nodes[0]) / H - 1
    logs = np.maximum(logs - logs.max(), 10 * floor)
    first = int(lo == 0)
    inner, start = logs[first:], lo + first
    out = np.full(count, -np.inf)
    if first:
        out[0] = logs[0]
    if len(inner):
        at = places[1:] - old[start]
        i = np.clip(np.floor(at).astype(np.int64), 0, max(len(inner) - 2, 0))
        inside = (at > -1) & (at < len(inner))
        t = np.clip(at - i, 0.0, 1.0)
        s, j = slopes(inner), np.minimum(i + 1, len(inner) - 1)
        values = (
            inner[i] * (1 + 2 * t) * (1 - t) ** 2 + s[i] * t * (1 - t) ** 2
            + inner[j] * t**2 * (3 - 2 * t) + s[j] * t**2 * (t - 1)
        )  # fmt: skip
        out[1:] = np.where(inside, values, -np.inf)
    grid = nodes[0] * np.exp(H * places)
    grid[0] = nodes[0]
    return grid, np.maximum(out - out.max(), floor)
