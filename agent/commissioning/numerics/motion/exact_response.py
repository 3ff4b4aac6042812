"""The exact transform of a sampled record, to which a rough start is fitted: no window smears a resonance.

Of N samples with z = exp(2πi k/N), whatever moved before and after is a state's worth of unknowns (Pintelon &
Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. 2012, section 6.3.2):

    Y = G U + C (z - A)⁻¹ z (x(0) - x(N))

These are eliminated; errors are weighed by what the model has left so far, averaged over neighbours, so that
a start that is far off is not held by its resonances alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.commissioning import tuning
from agent.commissioning.numerics.design import responses
from agent.numerics.model.mechanics import MassSpringDamper
from agent.numerics.model.statespace import Discrete, Hold, discretise
from agent.types import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class _Piece:
    """Transforms Y (F, p), U (F, m) at omega (F,), and the sds (p,) that the sensors' noise gives them."""

    omega: FloatArray
    Y: ComplexArray
    U: ComplexArray
    sd: FloatArray


@dataclass(frozen=True)
class _Fit:
    """Normal equations A (q, q), g (q,) of a point, and the logarithm of what it leaves, summed."""

    A: FloatArray
    g: FloatArray
    cost: float


@dataclass(frozen=True)
class Minimum:
    """Parameters (q,) of a minimum, and the mean logarithm of the errors' power there."""

    cost: float
    theta: FloatArray


def refined(
    model: MassSpringDamper, pieces: Sequence[tuple[FloatArray, FloatArray]], period_s: float,
    sigma: FloatArray, starts: Sequence[FloatArray],
    *, fastest: float, hold: Hold,
) -> list[Minimum]:  # fmt: skip
    """Return the minima that the best of starts (q,) > 0 come to, the lowest first.

    Bins are those below `fastest`, rad/s.
    """
    longest = sorted(pieces, key=lambda piece: -len(piece[0]))[: tuning.MOST_PIECES]
    part = slice(0, tuning.LONGEST_PIECE)
    chosen = [_piece(y[part], u[part], period_s, sigma, fastest) for y, u in longest]
    fitting = _Fitting(model, chosen, period_s, hold)
    nearer = sorted(
        (fitting.fitted(np.log(theta), tuning.FIRST_STEPS) for theta in starts), key=lambda way: way[0]
    )
    ways = [fitting.fitted(phi, tuning.MOST_ROUNDS) for _, phi in nearer[: tuning.FINALISTS]]
    count = sum(piece.Y.size for piece in chosen)
    return [Minimum(cost / count, np.exp(phi)) for cost, phi in sorted(ways, key=lambda way: way[0])]


def others_near(minima: Sequence[Minimum], telling: BoolArray) -> list[Minimum]:
    """Return minima that are not the first: apart in what is telling (q,), and leaving nearly as little."""
    first = minima[0]
    return [
        found
        for found in minima[1:]
        if found.cost < first.cost + tuning.NEAR_POWER
        and np.abs(np.log(found.theta / first.theta))[telling].max(initial=0.0) > tuning.ALIKE
    ]


def _piece(y: FloatArray, u: FloatArray, period_s: float, sigma: FloatArray, fastest: float) -> _Piece:
    omega = 2 * np.pi * np.fft.rfftfreq(len(y), period_s)
    last = int(np.searchsorted(omega, min(fastest, 0.9 * omega[-1])))
    kept = slice(1, last, -(-last // tuning.MOST_KEPT))  # a constant is an offset, and what rests on it
    Y, U = np.fft.rfft(y, axis=0)[kept], np.fft.rfft(u, axis=0)[kept]
    return _Piece(np.asarray(omega[kept], dtype=float), Y, U, np.sqrt(len(y)) * sigma)


@dataclass(frozen=True)
class _Fitting:
    """Levenberg's and Marquardt's way to the transforms of pieces; unknown are logarithms."""

    model: MassSpringDamper
    pieces: Sequence[_Piece]
    period_s: float
    hold: Hold

    def fitted(self, begun: FloatArray, steps: int) -> tuple[float, FloatArray]:
        """Return cost and logarithms (q,) that so many steps from those begun with come to."""
        phi = begun
        fit = self._at(begun, begun)
        damping = 1e-3
        for _ in range(steps):
            diagonal = np.diag(fit.A)
            step = np.linalg.solve(fit.A + np.diag(damping * diagonal + 1e-9 * diagonal.max()), fit.g)
            step = np.clip(step, -tuning.STRETCH, tuning.STRETCH)
            tried = self._at(phi - step, begun)
            better = tried.cost < fit.cost
            damping = damping / 5 if better else damping * 8
            if better:
                phi, fit = phi - step, tried
            if damping > tuning.HOPELESS or (better and np.abs(step).max() < tuning.RESTS_SHARE):
                break
        return fit.cost, phi

    def _at(self, phi: FloatArray, begun: FloatArray) -> _Fit:
        discrete = discretise(self.model.continuous(np.exp(phi)), self.period_s, self.hold)
        q = len(phi)
        off = (phi - begun) / tuning.VAGUE_LOG**2
        # what no bin shows stays where it began, not at nothing or beyond all bounds
        A = np.eye(q) / tuning.VAGUE_LOG**2
        g = off
        cost = float(off @ (phi - begun))
        for piece in self.pieces:
            rows, power = self._rows(discrete, piece, np.exp(phi))
            A, g = A + rows[:, :q].T @ rows[:, :q], g + rows[:, :q].T @ rows[:, q]
            cost += float(np.sum(np.log(power)))
        return _Fit(A, g, cost)

    def _rows(self, discrete: Discrete, piece: _Piece, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives and errors, weighed (2Fp, q + 1), and the errors' power (F, p)."""
        G, S = responses(discrete, piece.omega)
        z = np.exp(1j * piece.omega * self.period_s)[:, None, None]
        T = discrete.model.C @ np.linalg.inv(z * np.eye(discrete.model.n) - discrete.model.A) * z
        e = np.einsum("fpm,fm->fp", G, piece.U) - piece.Y
        J = np.einsum("fqpm,fm->fpq", S, piece.U) * theta
        power = np.broadcast_to(piece.sd**2, e.shape)
        for _ in range(2):  # the second time with the weights that the first one's rest asks for
            rows, left = _eliminated(e, J, T, np.sqrt(power))
            power = np.maximum(_smoothed(np.abs(left) ** 2), piece.sd**2)
        return rows, power


def _eliminated(
    e: ComplexArray, J: ComplexArray, T: ComplexArray, sd: FloatArray
) -> tuple[FloatArray, ComplexArray]:
    """Return J and e, weighed, without what T can do (2Fp, q + 1), and e in its own units (F, p)."""
    weight = 1.0 / sd[..., None]
    columns: ComplexArray = np.concatenate([J, e[..., None]], axis=2)
    whole = _real(columns * weight)
    first = _real(np.asarray(T * weight, dtype=np.complex128))
    size = np.maximum(np.linalg.norm(first, axis=0), 1e-300)
    basis, _ = np.linalg.qr(first / size)
    whole = whole - basis @ (basis.T @ whole)
    half = len(whole) // 2
    left = (whole[:half, -1] + 1j * whole[half:, -1]).reshape(e.shape) * sd
    return whole, np.asarray(left, dtype=np.complex128)


def _real(columns: ComplexArray) -> FloatArray:
    """Stack real over imaginary parts of columns (F, p, c)."""
    flat = columns.reshape(-1, columns.shape[-1])
    return np.concatenate([flat.real, flat.imag])


def _smoothed(power: FloatArray) -> FloatArray:
    """Return powers (F, p) averaged over neighbours."""
    half = tuning.NEIGHBOURS // 2
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.array([np.convolve(np.pad(row, half, mode="edge"), kernel, "valid") for row in power.T]).T
