"""Dense generalised least squares of one window: the covariance of all its readings, built by hand."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.filtering.noise import NoiseModel, Push

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Dense:
    H: FloatArray
    g: FloatArray
    rss: float
    log_det: float
    psi: FloatArray
    residual: FloatArray
    flat: FloatArray
    whiten: FloatArray
    x0: FloatArray

    def estimate(self, precision: FloatArray) -> tuple[FloatArray, FloatArray]:
        cov = np.linalg.inv(self.H + np.diag(precision))
        return cov @ self.g, cov

    def glr(self, columns: FloatArray, precision: FloatArray) -> float:
        """2 log GLR of further columns (W p, q) the drop of the penalised residual."""
        wide = np.hstack([self.psi, columns])
        wide, r = project(self.whiten @ self.flat, self.whiten @ wide), self.residual
        penalty = np.zeros(wide.shape[1])
        penalty[: len(precision)] = precision
        drops = []
        for X, lam in ((wide[:, : len(precision)], precision), (wide, penalty)):
            scale = 1 / np.sqrt(np.sum(X**2, axis=0) + lam)
            A = np.vstack([X * scale, np.diag(np.sqrt(lam)) * scale])
            b = np.concatenate([r, np.zeros(len(lam))])
            left = np.linalg.qr(A)[0]
            drops.append(np.sum((left.T @ b) ** 2))
        return float(drops[1] - drops[0])


def project(flat: FloatArray, X: FloatArray) -> FloatArray:
    left = np.linalg.qr(flat / np.linalg.norm(flat, axis=0))[0]
    for _ in range(2):
        X = X - left @ (left.T @ X)
    return X


def free(model: StateSpace, W: int) -> FloatArray:
    out, power = [], np.eye(model.n)
    for _ in range(W):
        out.append(model.C @ power)
        power = model.A @ power
    return np.concatenate(out)


def forced(model: StateSpace, push: Push, W: int) -> FloatArray:
    """What forces in each direction at each sample do to all outputs from rest, (d, W p, W)."""
    d, p = push.B.shape[1], model.p
    answer, x = [push.D], push.B
    for _ in range(W - 1):
        answer.append(model.C @ x)
        x = model.A @ x
    maps = np.zeros((d, W, p, W))
    for k in range(W):
        maps[:, k:, :, k] = np.stack(answer[: W - k]).transpose(2, 0, 1)
    return maps.reshape(d, W * p, W)


def covariance(model: StateSpace, push: Push, noise: NoiseModel, W: int) -> FloatArray:
    p, d = model.p, push.B.shape[1]
    total = np.diag(np.tile(noise.sigma**2, W))
    lag = np.abs(np.subtract.outer(np.arange(W), np.arange(W)))
    maps = forced(model, push, W)
    for j in range(d):
        total += noise.force[j] ** 2 * maps[j] @ maps[j].T
    for c in noise.coloured:
        colour = c.sd**2 * c.pole**lag
        if c.side == "force":
            total += maps[c.number] @ colour @ maps[c.number].T
        else:
            total[c.number :: p, c.number :: p] += colour
    return total


def mean_and_columns(
    model: StateSpace, u: FloatArray, x0: FloatArray, jump_at: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Mean output (W p,) and its derivatives (W p, c), those of a jump at a sample if it is not 0."""
    r, t = x0.copy(), np.zeros((model.q, model.n))
    y, psi = [], []
    for k, uk in enumerate(u):
        on = float(k >= jump_at)
        y.append(model.C @ r + model.D @ uk)
        psi.append((t @ model.C.T + on * (model.dC @ r + model.dD @ uk)).T)
        t = t @ model.A.T + on * (model.dA @ r + model.dB @ uk)
        r = model.A @ r + model.B @ uk
    return np.concatenate(y), np.concatenate(psi)


def dense(model: StateSpace, push: Push, noise: NoiseModel, y: FloatArray, u: FloatArray) -> Dense:
    W, p = y.shape
    k = np.arange(W)
    lines = np.zeros((W, p, 2 * len(noise.lines)))
    for i, line in enumerate(noise.lines):
        lines[:, line.channel, 2 * i] = np.cos(line.radians_per_sample * k)
        lines[:, line.channel, 2 * i + 1] = np.sin(line.radians_per_sample * k)
    flat = np.hstack([free(model, W), lines.reshape(W * p, -1)])
    sigma = covariance(model, push, noise, W)
    whiten = np.linalg.inv(np.linalg.cholesky(sigma))
    scale = np.linalg.norm(whiten @ flat, axis=0)
    white = whiten @ flat / scale
    silent = y.reshape(-1) - mean_and_columns(model, u, np.zeros(model.n))[0]
    e0 = np.linalg.lstsq(white, whiten @ silent, rcond=None)[0] / scale
    psi = mean_and_columns(model, u, e0[: model.n])[1]
    r, X = project(white, (whiten @ silent)[:, None])[:, 0], project(white, whiten @ psi)
    log_det = np.linalg.slogdet(sigma)[1] + np.linalg.slogdet(white.T @ white)[1] + 2 * np.log(scale).sum()
    return Dense(X.T @ X, X.T @ r, float(r @ r), float(log_det), psi, r, flat, whiten, e0[: model.n])
