"""One window along which every parameter runs a straight line: theta(k) = theta_end + slope (k - W) / W.

Observer and sensitivities of `sensitivity`, with matrices that change from sample to sample: each window is sampled at
a few places of the line and interpolated between them, which is exact to the order of the line's bend in A and B.
Samples are taken in blocks that advance side by side; what the initial state does is carried through and projected out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.fit import Problem
from agent.numerics.fitting.window_filter import orthogonal
from agent.numerics.model.observer import Gain
from agent.numerics.model.statespace import StateSpace

FloatArray = NDArray[np.float64]
NODES = np.array([-1.0, -0.5, 0.0])
"""Places of the line at which the model is sampled: the window's ends and its middle."""
BLOCK = 32
"""Samples that one block takes in turn; all blocks take theirs together."""
STEPS, HALVINGS = 8, 5
SMALL = 0.01
"""A step that explains less than this, in units of the residual variance, changes nothing: a tenth of an sd."""


@dataclass(frozen=True, slots=True)
class Line:
    """The best straight line of a window.

    Attributes:
        theta: (q,) at the window's end.
        slope: (q,) change over the window.
        covariance: (2q, 2q) of theta and slope for unit noise variance.
        residual: (W, p) innovations left, in units of their standard deviation.
        psi: (W p, 2q) their sensitivities, the initial state projected out.
    """

    theta: FloatArray
    slope: FloatArray
    covariance: FloatArray
    residual: FloatArray
    psi: FloatArray


@dataclass(frozen=True, slots=True)
class _Here:
    """A window along one line, its initial state projected out: e (W p,) and psi (W p, 2q)."""

    e: FloatArray
    psi: FloatArray

    @property
    def cost(self) -> float:
        return float(self.e @ self.e)


def fit_line(problem: Problem, gain: Gain, theta: FloatArray, slope: FloatArray) -> Line | None:
    """Return the line of maximum likelihood near one (theta, slope (q,)); None where the steps do not converge."""
    line = np.concatenate([theta, slope])
    scale = np.concatenate([problem.scale, problem.scale])
    here = _at(problem, gain, line)
    for _ in range(STEPS):
        step, explained = _step(here, scale)
        if explained <= SMALL * here.cost / len(here.e):
            return _finished(here, line + step, scale, len(gain.whitening))
        moved = _accepted(problem, gain, here, line, step)
        if moved is None:
            return None
        line, here = moved
    return None


def _step(here: _Here, scale: FloatArray) -> tuple[FloatArray, float]:
    """Return a Gauss-Newton step (2q,) and the sum of squares that it explains while the window is linear."""
    psi = here.psi * scale
    norms = np.maximum(np.linalg.norm(psi, axis=0), 1e-300)
    step = np.clip(np.linalg.lstsq(psi / norms, here.e, rcond=1e-9)[0] / norms, -0.5, 0.5)
    fitted = psi @ step
    return np.asarray(step * scale), float(2 * here.e @ fitted - fitted @ fitted)


def _accepted(
    problem: Problem, gain: Gain, here: _Here, line: FloatArray, step: FloatArray
) -> tuple[FloatArray, _Here] | None:
    """Halve a step until it makes the window better told; None where no part of it does."""
    for _ in range(HALVINGS):
        there = _at(problem, gain, line + step)
        if there.cost <= here.cost:
            return line + step, there
        step = 0.5 * step
    return None


def _finished(here: _Here, line: FloatArray, scale: FloatArray, p: int) -> Line | None:
    psi = here.psi * scale
    norms = np.maximum(np.linalg.norm(psi, axis=0), 1e-300)
    left, values, right = np.linalg.svd(psi / norms, full_matrices=False)
    if values[-1] <= 1e-7 * values[0]:
        return None
    root = (scale / norms)[:, None] * (right.T / values)
    residual = here.e - left @ (left.T @ here.e)
    q = len(line) // 2
    return Line(line[:q], line[q:], root @ root.T, residual.reshape(-1, p), here.psi)


def _at(problem: Problem, gain: Gain, line: FloatArray) -> _Here:
    """Linearise a window about a line and the initial state that suits it best."""
    q, p = len(line) // 2, len(gain.whitening)
    models = [problem.sample(np.maximum(line[:q] + at * line[q:], problem.lower)).model for at in NODES]
    y, u = problem.v[:, :p], problem.v[:, p:]
    count = len(y)
    place = (np.arange(count) - count) / count
    weights = _weights(place)
    A, B = (_along(weights, [getattr(m, name) for m in models]) for name in ("A", "B"))
    C, D = (_along(weights, [getattr(m, name) for m in models]) for name in ("C", "D"))
    Phi = A - gain.L @ C
    forced = np.einsum("knm,km->kn", B - gain.L @ D, u) + y @ gain.L.T
    free, x = _run(Phi, forced[:, :, None])
    e = y - np.einsum("kpn,kn->kp", C, x[:, :, 0]) - np.einsum("kpm,km->kp", D, u)
    left, back = orthogonal((gain.whitening @ (C @ free)).reshape(count * p, -1))
    e = (e @ gain.whitening.T).ravel()
    x = x[:, :, 0] + free @ (back @ (left.T @ e))
    into, seen = _driven(models, weights, gain, x, u)
    into = np.concatenate([into, place[:, None, None] * into], axis=2)
    seen = np.concatenate([seen, place[:, None, None] * seen], axis=2)
    _, s = _run(Phi, into)
    psi = (gain.whitening @ (C @ s + seen)).reshape(count * p, -1)
    return _Here(e - left @ (left.T @ e), psi - left @ (left.T @ psi))


def _weights(place: FloatArray) -> FloatArray:
    """(W, nodes) Lagrange's polynomials of NODES at each place."""
    columns = []
    for i, node in enumerate(NODES):
        others = np.delete(NODES, i)
        columns.append(np.prod((place[:, None] - others) / (node - others), axis=1))
    return np.stack(columns, axis=1)


def _along(weights: FloatArray, matrices: list[FloatArray]) -> FloatArray:
    """(W, ...) matrices along the line from those at its nodes."""
    return np.asarray(np.tensordot(weights, np.stack(matrices), axes=1))


def _driven(
    models: list[StateSpace], weights: FloatArray, gain: Gain, x: FloatArray, u: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what theta does to the next state (W, n, q) and to the output (W, p, q) at each sample."""
    dA, dB, dC, dD = (_along(weights, [getattr(m, name) for m in models]) for name in ("dA", "dB", "dC", "dD"))
    seen = np.einsum("kipn,kn->kpi", dC, x) + np.einsum("kipm,km->kpi", dD, u)
    into = np.einsum("kirn,kn->kri", dA, x) + np.einsum("kirm,km->kri", dB, u)
    return into - gain.L @ seen, seen


def _run(Phi: FloatArray, into: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what a state at the start does later (W, n, n), and X (W, n, c): X(k+1) = Phi(k) X(k) + into(k) from 0."""
    count, n, columns = into.shape
    blocks = -(-count // BLOCK)
    spare = blocks * BLOCK - count
    Phi = np.concatenate([Phi, np.broadcast_to(np.eye(n), (spare, n, n))]).reshape(blocks, BLOCK, n, n)
    into = np.concatenate([into, np.zeros((spare, n, columns))]).reshape(blocks, BLOCK, n, columns)
    # beside its own course each block carries that of an unknown state at its beginning
    both = np.concatenate([np.zeros((blocks, n, columns)), np.broadcast_to(np.eye(n), (blocks, n, n))], axis=2)
    kept = np.empty((blocks, BLOCK, n, columns + n))
    for j in range(BLOCK):
        kept[:, j] = both
        both = Phi[:, j] @ both
        both[:, :, :columns] += into[:, j]
    starts = np.empty((blocks, n, columns + n))
    carried = np.hstack([np.zeros((n, columns)), np.eye(n)])
    for block in range(blocks):
        starts[block] = carried
        carried = both[block, :, columns:] @ carried
        carried[:, :columns] += both[block, :, :columns]
    whole = kept[..., columns:] @ starts[:, None]
    whole[..., :columns] += kept[..., :columns]
    whole = whole.reshape(-1, n, columns + n)[:count]
    return whole[..., columns:], whole[..., :columns]
