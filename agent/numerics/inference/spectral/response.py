"""Transfer functions of the sampled model on a window's bins, and its free and forced states at the ends.

A finite window is exactly diagonal in the DFT once its ends are accounted for: with z = e^{iω} on the DFT's
grid

    (zI − A) X = B U + z (x(0) − x(W)) / √W,      x(W) = A^W x(0) + f_W

so the response to anything is its periodic response and a free response, which lies in the span of Γ = z C R
(I − A^W), R = (zI − A)⁻¹. Modulo Γ (flat e0) the covariance of any stationary force is block diagonal here
without Whittle's approximation (Agüero et al., Automatica 46 (2010) 1632; Harville, Biometrika 61 (1974)
383).

Where a mass is free, I − A^W is singular: with w (I − A^W) = 0 the momentum w x moves by what was pushed
only,

    w (x(W) − x(0)) = √W w (B U(0) + E F(0))

so bin 0, which lies on the pole, is left out, and what is driven by v(k) closes with −z C R r w V(0), w r =
1. Unknown forces leave one random column a free direction, z C R r, of variance Σ (w E_j)² |F_j(0)|².
"""

from functools import cached_property

import numpy as np

from agent.numerics.inference.spectral.bins import Bins
from agent.numerics.inference.tuning import FREE_SHARE, ON_A_POLE
from agent.numerics.model.singular import singular
from agent.numerics.model.uncertain import Sampled
from agent.types import ComplexArray, FloatArray


def end_states(A: FloatArray, w: FloatArray) -> FloatArray:
    """Return Σ A^(L−1−k) w(k) of stretches w (s, L, n), by halving: x(L) of x(k+1) = A x(k) + w(k) from 0."""
    length = w.shape[1]
    size = 1 << max(0, (length - 1).bit_length())
    w = np.concatenate([np.zeros((len(w), size - length, w.shape[2])), w], axis=1)
    while w.shape[1] > 1:
        w = w[:, 0::2] @ A.T + w[:, 1::2]
        A = A @ A
    return np.asarray(w[:, 0])


class Response:
    """Transfer functions at one point of linearisation, C (kept + groups) cells of the bins.

    Attributes:
        at: the sampled model.
        weight: (C,) bins each cell stands for; 0 where the bin lies on a pole.
        R: (kept, n, n) resolvent (zI − A)⁻¹;  CR: (kept, p, n) C R.
        H: (C, p, d) response to unknown forces;  HU: (kept, p, m) to measured inputs, then to slopes.
        is_free: a mass that nothing holds.
        left: (f, n) momenta w of free masses.
        starts: (n, n − f) initial states that Γ shows;  still: (n, f) places that only bin 0 shows.
        gamma: (kept, p, n) free response, columns scaled to length 1 by gamma_scale (n,); the last f: z C R
            r.
        drift: (kept, p, f) z C R r.
    """

    def __init__(self, at: Sampled, bins: Bins) -> None:
        self.at, self.bins, n, kept = at, bins, at.n, bins.kept
        self._powers: dict[int, FloatArray] = {}
        self.AW = self.power(bins.window)
        left, sizes, right = singular(np.eye(n) - self.AW)
        held = sizes > FREE_SHARE * sizes[0]
        self.left, self.starts, self.still = left[:, ~held].T, right[held].T, right[~held].T
        self.is_free = not held.all()
        poles = np.linalg.eigvals(at.A)
        near = np.abs(bins.z[:, None] - poles).min(axis=1) < ON_A_POLE
        near[0] |= self.is_free
        z = np.where(near, 1.001 * bins.z, bins.z)
        self.weight = bins.without(near)
        self.z = z
        resolvent = np.linalg.inv(z[:, None, None] * np.eye(n) - at.A)
        self.R = resolvent[:kept]
        self.CR = at.C @ self.R
        self.H = at.C @ (resolvent @ at.E) + at.F
        self.RB = self.R @ at.B
        self.HU = at.C @ self.RB + at.D
        self.zR = z[:kept, None, None] * self.R / np.sqrt(bins.window)
        self.free = self.zR @ (np.eye(n) - self.AW)
        self.drift = np.sqrt(bins.window) * at.C @ (self.zR @ self.left.T)
        gamma = np.concatenate([at.C @ self.free @ self.starts, self.drift], axis=2)
        scale = np.sqrt((np.abs(gamma[self.weight[:kept] > 0]) ** 2).sum(axis=(0, 1)))
        self.gamma_scale = np.where(scale > 0, scale, 1.0)
        self.gamma = gamma / self.gamma_scale
        k = len(at.dA)
        width = at.B.shape[1]
        stacked = np.concatenate(
            [np.concatenate([at.dA, at.dB], axis=2), np.concatenate([at.dC, at.dD], axis=2)], axis=1
        )
        self._derivatives = np.ascontiguousarray(stacked.reshape(k * (n + len(at.C)), n + width).T)

    def columns(self, x: ComplexArray, u: ComplexArray) -> ComplexArray:
        """Return dy by each parameter and log mass (kept, p, t k), modulo Γ, of t trajectories in turn.

        x (kept, t, n), u (kept, t, m): DFTs of their states and inputs.
        """
        n = self.at.n
        p = len(self.at.C)
        k = x.shape[1] * len(self.at.dA)
        change = (np.concatenate([x, u], axis=2) @ self._derivatives).reshape(len(x), k, n + p)
        found = self.CR @ change[:, :, :n].transpose(0, 2, 1) + change[:, :, n:].transpose(0, 2, 1)
        return np.asarray(self._closed(found, change[0, :, :n].T.real))

    def driven(self, number: int, signal: ComplexArray) -> ComplexArray:
        """Return the response (kept, p), modulo Γ, to a signal (kept,) at one measured input."""
        found = self.HU[:, :, number] * signal[:, None]
        return np.asarray(self._closed(found[..., None], self.at.B[:, [number]] * signal[0].real)[..., 0])

    def delayed(self, late: FloatArray, slopes: ComplexArray) -> ComplexArray:
        """Return d y (kept, p), modulo Γ, by a delay (n + p, m), from the slopes' DFT (kept, m)."""
        n = self.at.n
        change = slopes @ late.T
        found = (self.CR @ change[:, :n, None])[..., 0] + change[:, n:]
        return np.asarray(self._closed(found[..., None], change[:1, :n].real.T)[..., 0])

    def pushed(self, push: FloatArray, signals: ComplexArray) -> ComplexArray:
        """Return responses (kept, p, r), modulo Γ, to signals (kept, r) that act as `push` (d, r) says."""
        found = (self.H[: self.bins.kept] @ push) * signals[:, None]
        return self._closed(found, self.at.E @ push * signals[0].real)

    def _closed(self, columns: ComplexArray, mean: FloatArray) -> ComplexArray:
        """Columns (kept, p, k) that bin 0 of the states' drive, mean (n, k), closes where a mass is free."""
        return columns - self.drift @ (self.left @ mean) if self.is_free else columns

    def drift_variance(self, power: FloatArray) -> FloatArray:
        """Return the variance (..., f) of the last columns of gamma from forces' power (..., d) in bin 0."""
        gain = (self.left @ self.at.E) ** 2
        return np.asarray(power @ gain.T * self.gamma_scale[len(self.gamma_scale) - len(self.left) :] ** 2)

    def above(self, u: ComplexArray, start: FloatArray, forced: FloatArray) -> ComplexArray:
        """Return outputs (h, p) on the high bins of measured inputs (h, m) and slopes.

        start (n,): the state that the window begins with;  forced (n,): where it would end from rest.
        """
        at, z = self.at, self.bins.z_high
        closing = (start - self.AW @ start - forced) / np.sqrt(self.bins.window)
        pushed = u @ at.B.T + z[:, None] * closing
        if self._modal is None:
            states = np.linalg.solve(z[:, None, None] * np.eye(at.n) - at.A, pushed[..., None])[..., 0]
            return np.asarray(states @ at.C.T + u @ at.D.T)
        into, gain, out = self._modal
        return np.asarray((pushed @ into * gain) @ out + u @ at.D.T)

    @cached_property
    def _modal(self) -> tuple[ComplexArray, ComplexArray, ComplexArray] | None:
        """Forces on the modes (n, n), their resolvents on the high bins (h, n), and outputs by them (n, p).

        None where A cannot be diagonalised well.
        """
        poles, V = np.linalg.eig(self.at.A)
        if np.linalg.cond(V) >= 1e7:
            return None
        apart = self.bins.z_high[:, None] - poles
        gain: ComplexArray = np.asarray(1.0 / np.where(np.abs(apart) < ON_A_POLE, np.inf, apart))
        return np.asarray(np.linalg.inv(V).T), gain, np.asarray((self.at.C @ V).T)

    def power(self, samples: int) -> FloatArray:
        """Return A^samples (n, n); each is worked out once."""
        if samples not in self._powers:
            self._powers[samples] = np.linalg.matrix_power(self.at.A, samples)
        return self._powers[samples]
