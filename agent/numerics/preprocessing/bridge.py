"""Readings that a window lacks, as unknowns of its estimate.

A missing reading is filled with its cubic interpolant, and what the interpolant misses is one more unknown d.
A missing output says nothing at all (d is free). A missing input lies near its interpolant, as near as
interpolants of such gaps lie to the readings elsewhere in the window, which gives d a prior (Ljung, System
Identification, 2nd ed. 1999, section 14.2). To believe an interpolated force would make intervals far too
narrow.
"""

from dataclasses import dataclass

import numpy as np

from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Bridge:
    """The c readings that a window lacks.

    Attributes:
        sample: (c,) their places in the window.
        channel: (c,) their columns among outputs and inputs.
        sd: (c,) how far from its interpolant each may lie; inf where nothing is known.
    """

    sample: IntArray
    channel: IntArray
    sd: FloatArray


def bridge_over(v: FloatArray, missing: BoolArray, outputs: int) -> Bridge | None:
    """Return what a window v (W, p+m), filled where missing (W, p+m), lacks; None when it is complete.

    outputs: p; the columns from there on are inputs.
    """
    if not missing.any():
        return None
    sample, channel = np.nonzero(missing)
    sd = np.full(len(sample), np.inf)
    for column in set(channel[channel >= outputs].tolist()):
        sd[channel == column] = _interpolation_errors(v[:, column], missing[:, column])
    return Bridge(sample.astype(np.int64), channel.astype(np.int64), sd)


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Return start and stop of each run of True in (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _interpolation_errors(signal: FloatArray, missing: BoolArray) -> FloatArray:
    """Return, for each missing reading of a signal (W,), interpolants' rms error over such gaps elsewhere."""
    known: dict[int, FloatArray] = {}
    errors = []
    for start, stop in runs(missing):
        length = stop - start
        if length not in known:
            known[length] = _errors_over(signal, missing, length)
        errors.append(known[length])
    return np.concatenate(errors)


def _errors_over(signal: FloatArray, missing: BoolArray, length: int) -> FloatArray:
    """Return the rms error (length,) by place in a gap of `length` readings, from all complete stretches."""
    span = length + 4
    if len(signal) < 2 * span:
        return np.full(length, max(float(np.std(signal)), 1e-300))
    windows = np.lib.stride_tricks.sliding_window_view(signal, span)
    complete = ~np.lib.stride_tricks.sliding_window_view(missing, span).any(axis=1)
    if not complete.any():
        return np.full(length, max(float(np.std(signal)), 1e-300))
    offsets = np.array([0, 1, span - 2, span - 1])
    weights = np.stack([lagrange(offsets, place) for place in range(2, 2 + length)])
    seen = windows[complete]
    error = seen[:, 2:-2] - seen[:, offsets] @ weights.T
    floor = 1e-12 * max(float(np.abs(signal).max()), 1e-288)
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)) + floor)


def lagrange(offsets: IntArray, place: int) -> FloatArray:
    """Return weights (k,) of readings at offsets (k,) in the polynomial through them, taken at a place."""
    weights = np.ones(len(offsets))
    for i, own in enumerate(offsets):
        for other in offsets:
            if other != own:
                weights[i] *= (place - other) / (own - other)
    return weights


def filled(signal: FloatArray, missing: BoolArray) -> FloatArray:
    """Return a signal (n,) with each missing reading interpolated through up to two readings on either side.

    Before the first and after the last reading the nearest one is repeated.
    """
    result = signal.copy()
    seen = np.flatnonzero(~missing)
    for place in np.flatnonzero(missing).tolist():
        after = int(np.searchsorted(seen, place))
        around = seen[max(0, after - 2) : after + 2]
        if 0 < after < len(seen):
            result[place] = lagrange(around, place) @ signal[around]
        else:
            result[place] = signal[seen[min(after, len(seen) - 1)]] if len(seen) else 0.0
    return result
