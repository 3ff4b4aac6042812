"""The filters' step by its blocks, most of which are zero or the same.

    x̂' = Φ x̂,    r' = A r,    tᵢ' = Φ tᵢ + Gᵢ r

so that powers and free responses take products of single blocks. Whole, z = (r, x̂, t_1 .. t_c) has hundreds
of entries where sensors have colours of their own.
"""

from dataclasses import dataclass

import numpy as np

from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Transition:
    """What some samples, or hops, do to the filters' state.

    Attributes:
        predictor: (a, a) of x̂, and of each tᵢ.
        mean: (n, n) of r.
        from_mean: (c, a, n) what r leaves in each tᵢ.
    """

    predictor: FloatArray
    mean: FloatArray
    from_mean: FloatArray

    def after(self, first: "Transition") -> "Transition":
        """Return what `first` and then this one do."""
        from_mean = self.predictor @ first.from_mean + self.from_mean @ first.mean
        return Transition(self.predictor @ first.predictor, self.mean @ first.mean, from_mean)

    def power(self, count: int) -> "Transition":
        """Return what it does `count` times over, by squaring."""
        a, n = len(self.predictor), len(self.mean)
        total = Transition(np.eye(a), np.eye(n), np.zeros_like(self.from_mean))
        square = self
        while count:
            if count & 1:
                total = square.after(total)
            count >>= 1
            square = square.after(square) if count else square
        return total

    def whole(self) -> FloatArray:
        """Return it as one matrix (n + a + c a, ..) of z."""
        a, n, c = len(self.predictor), len(self.mean), len(self.from_mean)
        F = np.zeros((n + a + c * a,) * 2)
        F[:n, :n] = self.mean
        F[n:, n:] = np.kron(np.eye(1 + c), self.predictor)
        F[n + a :, :n] = self.from_mean.reshape(c * a, n)
        return F

    def of_responses(self) -> FloatArray:
        """Return P (a + c n, ..) with G(k+1) = G(k) P, G = [Γ, D_1 .. D_c] as in `responses`."""
        a, n, c = len(self.predictor), len(self.mean), len(self.from_mean)
        P = np.zeros((a + c * n,) * 2)
        P[:a, :a] = self.predictor
        P[:a, a:] = self.from_mean.transpose(1, 0, 2).reshape(a, c * n)
        P[a:, a:] = np.kron(np.eye(c), self.mean)
        return P

    def responses(self, gamma: FloatArray, drift: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Return outputs of free responses from sample 0 on: of x̂ or a tᵢ, and of r by each tᵢ it drives.

        Args:
            gamma: (p, a) what sample 0 shows of x̂ or tᵢ.
            drift: (c, p, n) what it shows of r in ψᵢ.
            count: samples.

        Returns:
            Γ (count, p, a), D (count, p, c, n).
        """
        c, p, n = drift.shape
        Gamma, D = np.empty((count, *gamma.shape)), np.empty((count, p, c, n))
        left = self.from_mean.transpose(1, 0, 2).reshape(-1, c * n)
        drifts = np.ascontiguousarray(drift.transpose(1, 0, 2)).reshape(p * c, n)
        for each, of_mean in zip(Gamma, D, strict=True):
            each[:] = gamma
            of_mean[:] = drifts.reshape(p, c, n)
            drifts = drifts @ self.mean + (gamma @ left).reshape(p * c, n)
            gamma = gamma @ self.predictor
        return Gamma, D
