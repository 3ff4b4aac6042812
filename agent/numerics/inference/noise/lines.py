"""Lines: bins that stand out from those about them, such as mains hum and its leakage.

What is known of the levels of other bins says nothing of a line. Were its level learnt as slowly as theirs,
noise of some colour would have to explain it, and that reaches the bins that tell of the parameters.
"""

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from agent.numerics.inference import tuning
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.spectral.columns import Regression
from agent.numerics.inference.spectral.covariance import Cells
from agent.numerics.inference.tuning import LEAKAGE_ROUNDS
from agent.types import FloatArray, IntArray

MEDIAN = float(np.log(2))
"""Median of a bin's power whose mean is 1."""


def with_lines(noise: Noise, cells: Cells, regression: Regression) -> Noise:
    """Return what was known with the levels of lines raised to what they are in a window."""
    bins = cells.response.bins
    bin_of = np.concatenate([np.arange(bins.kept), bins.high])
    cell_of = np.concatenate([np.arange(bins.kept), bins.kept + bins.group_of]).astype(np.int64)
    residual = np.vstack([regression.X[..., -1], regression.high])
    places = noise.places.after(residual, bin_of)
    power = np.abs(residual) ** 2 / noise.white
    off = places.off[bin_of]
    level = noise.levels[bin_of]
    columns = slice(regression.layout.psi.start, regression.layout.base)  # parameters and constants
    for channel in range(power.shape[1]):
        own = power[:, channel]
        if len(_loud(own / level[:, channel], bin_of)):
            shapes = np.column_stack([
                regression.driven[:, channel], np.abs(cells.D[cell_of, channel]) ** 2,
                np.abs(regression.X[np.minimum(cell_of, bins.kept - 1), channel, columns]) ** 2,
            ])  # fmt: skip
            _raise(level[:, channel], own, bin_of, shapes[:, (shapes > 0).all(axis=0)])
        leakage = _leakage(level[:, channel], own, bin_of, off[:, channel], noise.shows_colours)
        level[:, channel] = np.maximum(level[:, channel], leakage)
    raised = noise.power.copy()
    raised[bin_of] = noise.dof[bin_of] * level
    return replace(noise, power=raised, places=places)


def _loud(above: FloatArray, bin_of: IntArray) -> IntArray:
    """Return places of what may be lines; above (b,): power in units of what is known."""
    return np.flatnonzero((above > tuning.LINE_POWER) & (bin_of >= tuning.LINE_CYCLES))


def _raise(level: FloatArray, power: FloatArray, bin_of: IntArray, shapes: FloatArray) -> None:
    """Raise levels (b,) to the lines' power, those that leak into others first."""
    for _ in range(LEAKAGE_ROUNDS):
        places, sizes = _standing_out(power / level, bin_of, power, shapes)
        if not len(places):
            break
        level[places] *= sizes


def _standing_out(
    above: FloatArray, bin_of: IntArray, power: FloatArray, shapes: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return places of lines, and their power in that of the bins about them.

    above (b,): power in units of what is known. A peak that the response to some force has too, the measured
    motion, or what a parameter that is off would leave, is none: shapes (b, s).
    """
    loud = _loud(above, bin_of)
    usual = np.maximum(_medians(above, loud) / MEDIAN, 1.0)
    high = above[loud] > tuning.LINE_POWER * usual
    places = loud[high]
    sizes = above[places] / usual[high]
    relative = power[:, None] / shapes
    peaks = relative[places] > tuning.LINE_POWER * _medians(relative, places) / MEDIAN
    lines = peaks.all(axis=1)
    return places[lines], sizes[lines]


def _medians(values: FloatArray, places: IntArray) -> FloatArray:
    """Return medians (k, ...) of values (b, ...) about each place (k,); fewer neighbours at the ends."""
    reach = tuning.LINE_NEIGHBOURS
    out = np.empty((len(places), *values.shape[1:]))
    inner = (places >= reach) & (places < len(values) - reach)
    if inner.any():
        # where noise has a colour that is not known yet, thousands of bins are loud: all of them at once
        about = sliding_window_view(values, 2 * reach + 1, axis=0)
        out[inner] = np.median(about[places[inner] - reach], axis=-1)
    for i in np.flatnonzero(~inner):
        out[i] = np.median(values[max(0, places[i] - reach) : places[i] + reach + 1], axis=0)
    return out


def between(here: float, left: float, right: float) -> float:
    """Return a line's place between its bin and its stronger neighbour, from their amplitudes (-½ .. ½)."""
    beside = max(left, right)
    off = beside / max(here + beside, 1e-300)  # a window may show nothing where there was a line
    return off if right > left else -off


def _leakage(
    level: FloatArray, power: FloatArray, bin_of: IntArray, off: FloatArray, alone: bool
) -> FloatArray:
    """Return lines' leakage into bins about them (b,), in σ²: A² sin²(π δ) / (π (k − f))², 0 elsewhere.

    off (b,): δ, places of lines from the middles of their bins. alone: of the lines alone. In windows too
    short to show colours what a model lacks is no force's either, and leaks with them, from where it stands
    in this one.
    """
    out = np.zeros(len(level))
    inner = level[1:-1]
    for k in 1 + np.flatnonzero((inner > tuning.LINE_POWER) & (inner >= level[:-2]) & (inner > level[2:])):
        if bin_of[k + 1] - bin_of[k - 1] > 2:
            continue  # only an even spread of the high bins is at hand there
        apart = bin_of - bin_of[k]
        others = apart != 0
        size, place = power[k], off[k]
        if alone:  # what forces leave in the bins about it is no part of the line
            about = power[max(0, k - tuning.LINE_NEIGHBOURS) : k + tuning.LINE_NEIGHBOURS + 1]
            size = min(max(size - np.median(about) / MEDIAN, 0.0), level[k])
        else:
            left, here, right = np.sqrt(power[k - 1 : k + 2])
            place = between(here, left, right)
            others = np.abs(apart) > 1
        share = np.sin(np.pi * place) / max(abs(np.sinc(place)), 1e-6)
        leaks = 1 + size * (share / (np.pi * np.where(others, apart - place, np.inf))) ** 2
        out = np.maximum(out, leaks)
    return np.where(out > 1.2, out, 0.0)
