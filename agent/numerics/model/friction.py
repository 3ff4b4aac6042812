"""The sign of a velocity that nobody measures: what dry friction would do where the model has none.

The velocity comes from an observer of its own: the nominal model without friction, corrected fast. It is causal and
does not depend on what is being estimated. It lags where friction acts that it does not know, which matters little to
a suspect; friction that the model has is an input of its own kind (`stick_slip`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.model.mechanics import GROUND, MassSpringDamper
from agent.numerics.model.observer import start_gain
from agent.numerics.model.statespace import Hold, discretise
from agent.types import FloatArray

SPEED = 100.0
"""Slowest pole of the velocity observer, 1/s."""
SLOWEST, FASTEST = 0.02, 0.3
"""Least and most that the slowest pole may forget in one sample, whatever the rate."""
BLOCK = 32
"""Samples a block, counted from the segment's first, so that results do not depend on how the stream is cut."""
DEVIATIONS = 3.0
"""A velocity within this many standard deviations of its own noise has no sign."""
CREEP = 1e-3
"""A velocity below this share of the greatest one so far has no sign either."""

DOUBLINGS = 20
"""Of the samples that an observer's own noise adds up over: a million of them is all that is ever seen."""


@dataclass(frozen=True, slots=True)
class MotionFilter:
    """x(k+1) = Phi x(k) + K v(k), w(k) = W x(k) + V v(k) with v = (y, u), lifted to blocks of BLOCK samples.

    Attributes:
        outputs: (BLOCK r, n + BLOCK (p+m)) makes of (x, v of a block) its relative velocities w (or displacements).
        state: (n, n + BLOCK (p+m)) makes of them the next block's x.
        first: (n, p+m) the state to begin with from the first sample.
        noise: (r,) standard deviation that the sensors' noise leaves in each of w; 0 where it is not known.
    """

    outputs: FloatArray
    state: FloatArray
    first: FloatArray
    noise: FloatArray


def motion_filter(
    model: MassSpringDamper, pairs: Sequence[tuple[str, str]], period_s: float, hold: Hold, sigma: FloatArray,
    *, displacements: bool = False,
) -> MotionFilter:  # fmt: skip
    """Build the observer of relative velocities between pairs of nodes from a model's nominal values.

    Args:
        model: the rig; its friction is left out.
        pairs: r pairs of nodes, ground among them.
        period_s: sampling period, s.
        hold: how the forces run between samples.
        sigma: (p,) standard deviation of each output's noise, NaN where it is not known.
        displacements: give relative displacements instead.

    Raises ValueError when no gain gives a stable observer.
    """
    plain = _without_friction(model)
    continuous = plain.continuous(plain.nominal)
    discrete = discretise(continuous, period_s, hold)
    d = discrete.model
    weights = np.where(np.isfinite(sigma), sigma, np.nanmean(sigma) if np.isfinite(sigma).any() else 1.0)
    L = start_gain(discrete, _pushes(plain), weights, _window(period_s))
    difference = differences(plain, pairs)
    W, direct = difference @ continuous.A, difference @ continuous.B
    if displacements:
        W, direct = difference, np.zeros_like(direct)
    # the physical state is the shifted one plus B1 u
    V = np.hstack([np.zeros((len(pairs), d.p)), W @ discrete.B1 + direct])
    K = np.hstack([L, d.B - L @ d.D])
    seen = np.linalg.pinv(d.C)
    Phi = d.A - L @ d.C
    noise = _noise(Phi, L, W, np.where(np.isfinite(sigma), sigma, 0.0))
    outputs, state = _lifted(Phi, K, W, V)
    return MotionFilter(outputs, state, np.hstack([seen, -seen @ d.D]), noise)


def _lifted(Phi: FloatArray, K: FloatArray, W: FloatArray, V: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Run the filter over a block for every unit of (x, v of the block) at once."""
    n, width = K.shape
    x = np.hstack([np.eye(n), np.zeros((n, BLOCK * width))])
    outputs = []
    for k in range(BLOCK):
        sample = np.zeros((width, x.shape[1]))
        sample[:, n + k * width : n + (k + 1) * width] = np.eye(width)
        outputs.append(W @ x + V @ sample)
        x = Phi @ x + K @ sample
    return np.vstack(outputs), x


def _without_friction(model: MassSpringDamper) -> MassSpringDamper:
    return replace(model, structure=replace(model.structure, frictions=()), parameters=())


def _window(period_s: float) -> int:
    """Samples after which `start_gain` is to have forgotten: exp(-6) at the slowest pole."""
    return max(1, round(6.0 / min(max(SPEED * period_s, SLOWEST), FASTEST)))


def _pushes(model: MassSpringDamper) -> FloatArray:
    """(n, d) an unknown force on each mass, or an unknown velocity of a rig without masses."""
    masses = np.array([m.value for m in model.structure.masses if m.value > 0])
    n = len(model.state_names)
    if not len(masses):
        return np.eye(n)
    return np.vstack([np.diag(1.0 / masses), np.zeros((n - len(masses), len(masses)))])


def differences(model: MassSpringDamper, pairs: Sequence[tuple[str, str]]) -> FloatArray:
    """Return (r, n) rows that take the relative displacement of each pair from the states."""
    names = model.state_names
    difference = np.zeros((len(pairs), len(names)))
    for row, pair in zip(difference, pairs, strict=True):
        for node, sign in zip(pair, (1.0, -1.0), strict=True):
            if node != GROUND:
                row[names.index(f"displacement of {node}")] += sign
    return difference


def _noise(Phi: FloatArray, L: FloatArray, W: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the sd (r,) that white sensor noise leaves in W x."""
    # what the first 2^k samples add up to, by doubling: accelerations do not show where a rig stands, and an observer
    # that hardly forgets that makes the equation of the whole sum singular
    covariance, power = L @ np.diag(sigma**2) @ L.T, Phi
    for _ in range(DOUBLINGS):
        covariance, power = covariance + power @ covariance @ power.T, power @ power
    return np.asarray(np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", W, covariance, W), 0.0)))


def motion(filter_: MotionFilter, y: FloatArray, u: FloatArray) -> FloatArray:
    """Return what moves (N, r) in one stretch y (N, p), u (N, m) from its first sample on."""
    v = np.hstack([y, u])
    x, pieces = filter_.first @ v[0], []
    for start in range(0, len(v), BLOCK):
        stretch = _stretch(x, v[start : start + BLOCK])
        pieces.append((filter_.outputs @ stretch).reshape(BLOCK, -1))
        x = filter_.state @ stretch
    return np.vstack(pieces)[: len(v)]


def _stretch(x: FloatArray, v: FloatArray) -> FloatArray:
    """Return (n + BLOCK (p+m),): a state and up to BLOCK samples, filled up with zeros."""
    block = np.zeros((BLOCK, v.shape[1]))
    block[: len(v)] = v
    return np.concatenate([x, block.ravel()])


def signs(velocities: FloatArray, noise: FloatArray, greatest: FloatArray) -> FloatArray:
    """Return -1, 0 or 1 for velocities (N, r); `greatest` (N, r) is the greatest speed up to each sample."""
    least = np.maximum(DEVIATIONS * noise, CREEP * greatest)
    return np.asarray(np.where(np.abs(velocities) > least, np.sign(velocities), 0.0))
