"""The noise of a window: S(z) on its cells, its inverse, and Grams of columns under it."""

from dataclasses import dataclass

import numpy as np

from agent.numerics.inference.spectral.response import Response
from agent.types import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class Cells:
    """What does not change while the noise of a window is learnt.

    Attributes:
        response: gives the cells' weights.
        D: (C, p, a) directions of the sources;  spectra: (a, C) their shapes.
    """

    response: Response
    D: ComplexArray
    spectra: FloatArray

    @property
    def kept(self) -> int:
        """Cells that are single bins."""
        return self.response.bins.kept

    @property
    def weight(self) -> FloatArray:
        """(C,) bins of the full DFT that each cell stands for."""
        return self.response.weight

    def covariance(self, white: FloatArray, levels: FloatArray, intensity: FloatArray) -> ComplexArray:
        """Return S (C, p, p) for white noise of variance (p,), bin levels (K, p) and intensities (a,)."""
        p = len(white)
        power = (intensity**2)[:, None] * self.spectra
        S = (self.D * power.T[:, None, :]) @ self.D.conj().transpose(0, 2, 1)
        S[:, range(p), range(p)] += white * self.cell_levels(levels)
        return S

    def cell_levels(self, levels: FloatArray) -> FloatArray:
        """Return the cells' levels (C, p): their own for single bins, 1 for groups (normalised before)."""
        out = np.ones((len(self.weight), levels.shape[1]))
        out[: self.kept] = levels[: self.kept]
        return out

    def gram(self, inverse: ComplexArray, X: ComplexArray) -> FloatArray:
        """Return Re Σ w X* S⁻¹ X (c, c) over the single bins."""
        return self.products(inverse, X, X)

    def products(self, inverse: ComplexArray, left: ComplexArray, right: ComplexArray) -> FloatArray:
        """Return Re Σ w left* S⁻¹ right (l, r) over the single bins."""
        weighted = (inverse[: self.kept] @ right) * self.weight[: self.kept, None, None]
        return real_gram(left, weighted)


def real_gram(a: ComplexArray, b: ComplexArray) -> FloatArray:
    """Return Re Σ a* b (c, c) of columns (cells, p, c)."""
    left, right = a.reshape(-1, a.shape[-1]), b.reshape(-1, b.shape[-1])
    return np.asarray(
        np.ascontiguousarray(left.real).T @ right.real + np.ascontiguousarray(left.imag).T @ right.imag
    )


def inverse_of(S: ComplexArray) -> ComplexArray:
    """Return S⁻¹ of Hermitian S (C, p, p), in closed form for one and two outputs."""
    p = S.shape[1]
    if p == 1:
        return np.asarray(1.0 / S)
    if p > 2:
        return np.asarray(np.linalg.inv(S))
    a, b, d = S[:, 0, 0].real, S[:, 0, 1], S[:, 1, 1].real
    determinant = a * d - np.abs(b) ** 2
    out = np.empty_like(S)
    out[:, 0, 0], out[:, 1, 1] = d / determinant, a / determinant
    out[:, 0, 1], out[:, 1, 0] = -b / determinant, -b.conj() / determinant
    return out


def log_determinants(S: ComplexArray) -> FloatArray:
    """Return log det S (C,)."""
    return np.asarray(np.linalg.slogdet(S)[1])


class HighPower:
    """Residual power above the kept bins, normalised by the bins' levels and summed in groups.

    Attributes:
        r: (h, p) normalised residual;  R: (groups, p, p) Σ w r r*.
    """

    def __init__(self, response: Response, residual: ComplexArray, levels: FloatArray) -> None:
        bins, p = response.bins, residual.shape[1]
        self.bins = bins
        self.r = residual / np.sqrt(levels[bins.high])
        weight = bins.multiplicity[bins.high]
        self.R = np.zeros((0, p, p), dtype=complex)
        if bins.groups:
            outer = weight[:, None, None] * self.r[:, :, None] * self.r[:, None, :].conj()
            self.R = np.add.reduceat(outer, bins.starts, axis=0)

    def quadratic(self, inverse: ComplexArray) -> float:
        """Return Σ tr S⁻¹ R over the groups; inverse (C, p, p) of all cells."""
        return float(np.einsum("kab,kba->", inverse[self.bins.kept :], self.R).real)
