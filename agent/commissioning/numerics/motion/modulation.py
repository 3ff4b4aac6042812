"""Modulating functions: smooth test functions of compact support that leave a motion no derivative to take.

    ψ(t) = w(t) exp(-iωt),   w = sin^s(π t / L) on [0, L], so that ψ and s - 1 derivatives vanish at both ends

The transforms of a signal y by the derivatives of ψ are sums of windowed Fourier transforms (Leibniz):

    S_j(y) = ∫ ψ^(j) y dt = Σ_a C(j, a) (-iω)^(j-a) ∫ w^(a) y exp(-iωt) dt

Sums over samples are integrals here: the integrand vanishes at both ends with many derivatives (Shinbrot,
Trans. ASME 79 (1957) 547; Pearson & Lee, Automatica 21 (1985) 573).
"""

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from agent.commissioning.tuning import FASTEST
from agent.types import FloatArray

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Modulation:
    """Transforms of stretches of one length by the derivatives of ψ, at the bins of that length.

    Attributes:
        length: samples of a stretch.
        period_s: between samples.
        order: highest derivative.
    """

    length: int
    period_s: float
    order: int

    @property
    def omega(self) -> FloatArray:
        """(b,) angular frequencies, rad/s: from rest to the fastest that samples show well."""
        count = max(2, int(FASTEST * self.length / 2))
        return np.asarray(2 * np.pi * np.arange(count) / (self.length * self.period_s))

    def transforms(self, signals: FloatArray) -> ComplexArray:
        """Return S_j of signals (length, c) as (order + 1, b, c)."""
        omega = self.omega
        windowed = [np.fft.rfft(w[:, None] * signals, axis=0)[: len(omega)] for w in self._window()]
        turning = -1j * omega[:, None]
        rows = [
            sum(comb(j, a) * turning ** (j - a) * windowed[a] for a in range(j + 1))
            for j in range(self.order + 1)
        ]
        return np.asarray(self.period_s * np.array(rows), dtype=np.complex128)

    def _window(self) -> FloatArray:
        """(order + 1, length) w and its derivatives, from the cosines of an even power of a sine."""
        power = 2 * (self.order // 2 + 1)
        k = np.arange(-power // 2, power // 2 + 1)
        weight = np.array([(-1.0) ** abs(j) * comb(power, power // 2 + j) for j in k.tolist()]) / 2.0**power
        turn = 2 * np.pi / (self.length * self.period_s) * k
        phase = np.exp(1j * np.outer(np.arange(self.length), 2 * np.pi * k / self.length))
        return np.array([(phase * (1j * turn) ** a @ weight).real for a in range(self.order + 1)])


def held(omega: FloatArray, period_s: float, *, straight: bool) -> ComplexArray:
    """Return (b,) what lies between samples: straight lines, or steps that last until the next sample."""
    step = np.sinc(omega * period_s / (2 * np.pi))
    late = np.zeros_like(omega) if straight else 0.5 * omega * period_s
    return np.asarray((step**2 if straight else step) * np.exp(-1j * late), dtype=np.complex128)
