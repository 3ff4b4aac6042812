"""A chain of masses written down by hand, its readings in the time domain, and dense generalised least
squares of them.

Shares no code with `agent.numerics.inference`: the force runs straight between samples (first-order hold),
derivatives are complex steps (Squire & Trapp, SIAM Rev. 40 (1998) 110), the covariance of all readings is one
matrix.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.uncertain import LAG, Constant, Rig

FloatArray = NDArray[np.float64]
STEP = 1e-30


@dataclass(frozen=True)
class ChainRig:
    """Masses, springs and dampers in a row from the ground, the measured force on the last mass.

    Attributes:
        sheet: data-sheet sds of masses, output gains, the force's gain and the delay (samples).
        lag: the same of how late each output is read; 0 for at once.
    """

    masses: tuple[float, ...] = (5.0, 3.0)
    springs: tuple[float, ...] = (250.0, 400.0)
    dampers: tuple[float, ...] = (5.0, 3.0)
    period: float = 0.02
    seen: tuple[str, ...] = ("displacement", "displacement")
    sheet: tuple[float, float, float, float] = (0.02, 0.01, 0.01, 0.25)
    lag: float = 0.0

    @property
    def count(self) -> int:
        return len(self.masses)

    @property
    def theta(self) -> FloatArray:
        return np.array([*self.springs, *self.dampers])

    @property
    def constants(self) -> tuple[Constant, ...]:
        mass, out, force, delay = self.sheet
        found = [Constant(f"m{i + 1}", "mass", i, mass) for i in range(self.count)]
        found += [Constant(f"x{i + 1}", "output", i, out) for i in range(len(self.seen))]
        found += [Constant("force", "input", 0, force), Constant("delay", "delay", 0, delay)]
        lags = range(len(self.seen) if self.lag > 0 else 0)
        return (*found, *(Constant(f"x{i + 1} late", "delay", LAG + i, self.lag) for i in lags))

    @property
    def rig(self) -> Rig:
        """The same for the agent."""
        nodes = ["ground", *(f"m{i + 1}" for i in range(self.count))]
        ends = list(pairwise(nodes))
        springs = tuple(
            Element(f"k{i + 1}", e, k) for i, (e, k) in enumerate(zip(ends, self.springs, strict=True))
        )
        dampers = tuple(
            Element(f"B{i + 1}", e, b) for i, (e, b) in enumerate(zip(ends, self.dampers, strict=True))
        )
        structure = Structure(
            tuple(Mass(n, m) for n, m in zip(nodes[1:], self.masses, strict=True)), springs, dampers
        )
        names = (*(e.name for e in (*springs, *dampers)), *nodes[1:])
        outputs = tuple(Output(kind, nodes[i + 1]) for i, kind in enumerate(self.seen))  # type: ignore[arg-type]
        model = MassSpringDamper(structure, names, (nodes[-1], *nodes[1:]), outputs)
        q = 2 * self.count
        return Rig(
            model, q, np.array([0]), np.array([True]), np.arange(1, 1 + self.count), self.constants,
            self.period,
            "first", self.theta, np.zeros(q),
        )  # fmt: skip

    def step(self, par: FloatArray) -> tuple[NDArray[np.complex128], ...]:
        """Ad, B0, B1 (all masses' forces), C, D for springs, dampers, masses in `par` (3 count,)."""
        n = self.count
        k, b, m = par[:n], par[n : 2 * n], par[2 * n :]
        E = np.eye(n) - np.eye(n, k=-1)
        K, B, inverse = E.T @ np.diag(k) @ E, E.T @ np.diag(b) @ E, np.diag(1 / m)
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ B]])
        G = np.vstack([np.zeros((n, n)), inverse])
        big = np.zeros((4 * n, 4 * n), dtype=complex)
        big[: 2 * n, : 2 * n], big[: 2 * n, 2 * n : 3 * n], big[2 * n : 3 * n, 3 * n :] = (
            A,
            G,
            np.eye(n) / self.period,
        )
        F = expm(big * self.period)
        G1, G2 = F[: 2 * n, 2 * n : 3 * n], F[: 2 * n, 3 * n :]
        rows = {"displacement": np.eye(2 * n)[:n], "velocity": np.eye(2 * n)[n:], "acceleration": A[n:]}
        C = np.array([rows[kind][i] for i, kind in enumerate(self.seen)], dtype=complex)
        D = np.array(
            [inverse[i] if kind == "acceleration" else 0 * inverse[i] for i, kind in enumerate(self.seen)]
        )
        found = F[: 2 * n, : 2 * n], G1 - G2, G2, C, D
        return tuple(np.asarray(part, dtype=np.complex128) for part in found)

    def readings(
        self, par: FloatArray, eta: FloatArray, x0: FloatArray, u: FloatArray, slope: FloatArray,
        later: FloatArray | None = None, cut: int = 0,
    ) -> NDArray[np.complex128]:  # fmt: skip
        """Mean readings (W, p) from x0; eta: log masses, log output gains, log force gain, delay (samples).

        later: the springs and dampers from sample `cut` on.
        """
        n, p = self.count, len(self.seen)
        mass = np.array(self.masses) * np.exp(eta[:n])
        felt = np.exp(eta[n + p]) * (u[:, 0] - eta[-1] * slope[:, 0])
        f = np.zeros((len(u), n), dtype=complex)
        f[:, -1] = felt
        before = self.step(np.concatenate([par, mass]))
        after = before if later is None else self.step(np.concatenate([later, mass]))
        x, out = x0.astype(complex), []
        for k in range(len(u)):
            A, B0, B1, C, D = before if k < cut or later is None else after
            out.append(np.exp(eta[n : n + p]) * (C @ x + D @ f[k]))
            if k + 1 < len(u):
                x = A @ x + B0 @ f[k] + B1 @ f[k + 1]
        return np.array(out)


@dataclass(frozen=True)
class DenseNoise:
    """sigma (p,); white sd of each mass's force (n,); slow forces (mass, pole, sd); colours (output, pole,
    sd)."""

    sigma: FloatArray
    white: FloatArray
    slow: tuple[tuple[int, float, float], ...] = ()
    coloured: tuple[tuple[int, float, float], ...] = ()


@dataclass
class DenseWindow:
    """Dense generalised least squares of a window at (theta, eta): everything linear in one stack.

    Attributes:
        flat: (Wp, n) free responses;  psi, xi: (Wp, q), (Wp, c) derivatives;  residual: (Wp,);  S: (Wp, Wp).
        x0: (n,) initial state of the mean trajectory: the window's own best, or what was given.
    """

    flat: FloatArray
    psi: FloatArray
    xi: FloatArray
    residual: FloatArray
    S: FloatArray
    x0: FloatArray

    @classmethod
    def of(
        cls, rig: ChainRig, noise: DenseNoise, y: FloatArray, u: FloatArray, slope: FloatArray,
        theta: FloatArray,
        eta: FloatArray, x0: FloatArray | None = None,
    ) -> "DenseWindow":  # fmt: skip
        W, p = y.shape
        n, zero = 2 * rig.count, np.zeros(2 * rig.count)
        flat = np.column_stack([
            rig.readings(theta, eta, e, 0 * u, 0 * slope).real.reshape(-1) for e in np.eye(n)
        ])  # fmt: skip
        S = covariance(rig, noise, theta, eta, W)
        if x0 is None:
            L = np.linalg.cholesky(S)
            silent = (y - rig.readings(theta, eta, zero, u, slope).real).reshape(-1)
            x0 = np.linalg.lstsq(np.linalg.solve(L, flat), np.linalg.solve(L, silent), rcond=None)[0]
        mean = rig.readings(theta, eta, x0, u, slope).real.reshape(-1)

        def slope_of(d: FloatArray, e: FloatArray) -> FloatArray:
            moved = rig.readings(theta + 1j * STEP * d, eta + 1j * STEP * e, x0, u, slope)
            return np.asarray(moved.imag.reshape(-1) / STEP)

        psi = np.column_stack(
            [slope_of(d * t, 0 * eta) for d, t in zip(np.eye(len(theta)), theta, strict=True)]
        )
        xi = (
            np.column_stack([slope_of(0 * theta, e) for e in np.eye(len(eta))])
            if len(eta)
            else np.zeros((W * p, 0))
        )
        return cls(flat, psi, xi, y.reshape(-1) - mean, S, x0)

    def solve(
        self, prior: FloatArray, mean: FloatArray, kept: NDArray[np.bool_] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Relative steps of parameters and constants (q + c,), and their covariance."""
        rows = np.ones(len(self.residual), dtype=bool) if kept is None else kept
        L = np.linalg.cholesky(self.S[np.ix_(rows, rows)])
        X, r = (
            np.linalg.solve(L, np.hstack([self.psi, self.xi])[rows]),
            np.linalg.solve(L, self.residual[rows]),
        )
        Q = np.linalg.qr(np.linalg.solve(L, self.flat[rows]))[0]
        for _ in range(2):
            X, r = X - Q @ (Q.T @ X), r - Q @ (Q.T @ r)
        q = self.psi.shape[1]
        M = X.T @ X
        M[:q, :q] += 1e-6 * np.eye(q)
        M[q:, q:] += prior
        g = X.T @ r
        g[q:] += prior @ mean
        V = np.linalg.inv(M)
        return V @ g, V

    def restricted_log_likelihood(self, prior: FloatArray, mean: FloatArray) -> float:
        """REML with the parameters nearly flat and the constants under their prior, but for a constant."""
        L = np.linalg.cholesky(self.S)
        flat = np.linalg.solve(L, self.flat)
        X, r = np.linalg.solve(L, np.hstack([self.psi, self.xi])), np.linalg.solve(L, self.residual)
        Q = np.linalg.qr(flat)[0]
        for _ in range(2):
            X, r = X - Q @ (Q.T @ X), r - Q @ (Q.T @ r)
        q = self.psi.shape[1]
        M = X.T @ X
        M[:q, :q] += 1e-6 * np.eye(q)
        M[q:, q:] += prior
        g = X.T @ r
        g[q:] += prior @ mean
        logdet = np.linalg.slogdet(self.S)[1] + np.linalg.slogdet(flat.T @ flat)[1] + np.linalg.slogdet(M)[1]
        return float(-0.5 * (logdet + r @ r - g @ np.linalg.solve(M, g)))


def covariance(rig: ChainRig, noise: DenseNoise, theta: FloatArray, eta: FloatArray, W: int) -> FloatArray:
    """(Wp, Wp) covariance of the readings, unknown forces running straight between samples."""
    n, p = rig.count, len(rig.seen)
    mass = np.array(rig.masses) * np.exp(eta[:n])
    A, B0, B1, C, D = (a.real for a in rig.step(np.concatenate([theta, mass])))
    gain = np.exp(eta[n : n + p])
    lag = np.abs(np.subtract.outer(np.arange(W), np.arange(W)))
    total = np.diag(np.tile(noise.sigma**2, W)).astype(float)
    for j in range(n):
        kernel = noise.white[j] ** 2 * np.eye(W)
        kernel += sum(sd**2 * pole**lag for mass_, pole, sd in noise.slow if mass_ == j)
        T = np.zeros((W, p, W))
        for start in range(W):
            x = np.zeros(2 * n)
            for k in range(max(start - 1, 0), W):
                now, after = float(k == start), float(k + 1 == start)
                T[k, :, start] = gain * (C @ x + D[:, j] * now)
                x = A @ x + B0[:, j] * now + B1[:, j] * after
        flat = T.reshape(W * p, W)
        total += flat @ kernel @ flat.T
    for c, pole, sd in noise.coloured:
        total[c::p, c::p] += sd**2 * pole**lag
    return total
