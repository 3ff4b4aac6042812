"""Exact sampling with the input between samples a polynomial through several readings, some yet to come.

    x(k+1) = A x(k) + sum_o B_o u(k+o),   y(k) = C x(k) + D u(k),   o = -1..2 for a cubic, -2..3 for a quintic

The Lagrange polynomial through u(k+o) is integrated exactly: its derivatives at the sample's start are a
chain of integrators behind the input, and the blocks of one matrix exponential are what each of them leads to
(Van Loan, IEEE Trans. Automatic Control 23 (1978) 395; a straight line is degree 1). Unlike
`statespace.discretise`, the state here is the physical one.
"""

from dataclasses import dataclass
from math import factorial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.statespace import Discrete, Hold, StateSpace, chained
from agent.types import FloatArray

_TAPS: Final[dict[Hold, tuple[int, ...]]] = {
    "zero": (0,), "first": (0, 1), "cubic": (-1, 0, 1, 2), "quintic": (-2, -1, 0, 1, 2, 3),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Tapped:
    """A sampled model that takes several readings of its inputs at once.

    Attributes:
        model: x(k+1) = A x(k) + B v(k), y(k) = C x(k) + D v(k), with derivatives by every parameter;
            v(k) = [u(k+o) for o in taps], m columns a tap (see `side_by_side`). D acts on u(k) alone.
        taps: offsets of the readings, ascending.
        period_s: sampling period, s.
    """

    model: StateSpace
    taps: tuple[int, ...]
    period_s: float


def taps(hold: Hold) -> tuple[int, ...]:
    """Return the offsets of the readings that the input between samples k and k+1 is made of.

    Raises ValueError for "euler", which is no hold.
    """
    if hold not in _TAPS:
        raise ValueError(f'"{hold}" is no hold: holds are {", ".join(_TAPS)}')
    return _TAPS[hold]


def straight(hold: Hold) -> Hold:
    """Return what stands in for a polynomial where later readings cannot be waited for: a straight line."""
    return "first" if hold in ("cubic", "quintic") else hold


def sample(continuous: StateSpace, period_s: float, hold: Hold) -> Tapped:
    """Sample a continuous model exactly, derivatives included, for any hold."""
    offsets = taps(hold)
    weights = _derivative_weights(offsets)
    A, dA, G, dG = chained(continuous, period_s, len(offsets))
    # B_o = sum_j weights[o, j] G_j
    columns = len(offsets) * continuous.m
    B = np.einsum("oj,jnm->nom", weights, G).reshape(continuous.n, columns)
    dB = np.einsum("oj,jqnm->qnom", weights, dG).reshape(continuous.q, continuous.n, columns)
    D, dD = _direct(continuous.D, offsets), _direct(continuous.dD, offsets)
    return Tapped(StateSpace(A, B, continuous.C, D, dA, dB, continuous.dC, dD), offsets, period_s)


def curvature(
    continuous: StateSpace, discrete: Discrete
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what straight lines between samples take from outputs where an input is smooth in truth.

    A straight line runs T² u'' / 12 beside a smooth input, in the mean of a sample, and the motion that an
    input causes follows it: w = -(T² / 12) y'' + (T⁴ / 240) y'''' but for what is seen directly. With
    x = x̃ + B₁ u that is static in the shifted state x̃, the input u and its change since the sample before s,
    which stands for T u'. Right but for the fourth order in the angle that a motion runs in a sample.

    Returns: w by x̃ (p, n), by u and by s (p, m), and the derivatives of these by each parameter.
    """
    c, T = continuous, discrete.period_s
    AA, dAA = c.A @ c.A, c.dA @ c.A + c.A @ c.dA
    P, dP = (T**4 / 240) * AA - (T**2 / 12) * np.eye(c.n), (T**4 / 240) * dAA
    # outputs of the second derivative's correction by x, then what the input itself adds to that derivative
    CP, dCP = c.C @ P, c.dC @ P + c.C @ dP
    CPA, dCPA = CP @ c.A, dCP @ c.A + CP @ c.dA
    Cx, dCx = CPA @ c.A, dCPA @ c.A + CPA @ c.dA
    Du = Cx @ discrete.B1 + CPA @ c.B
    dDu = dCx @ discrete.B1 + Cx @ discrete.dB1 + dCPA @ c.B + CPA @ c.dB
    return Cx, Du, CP @ c.B / T, dCx, dDu, (dCP @ c.B + CP @ c.dB) / T


def lateness(
    continuous: StateSpace, discrete: Discrete
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what outputs lack that are read a sample late: -T y', first order in how late they are.

    y = C x + D u, x = x̃ + B₁ u with the shifted state x̃, so y' = C A x̃ + C (A B₁ + B) u + D u', and the
    change of the input since the sample before, s, stands for T u'.

    Returns: as `curvature`.
    """
    c, T = continuous, discrete.period_s
    Cx, dCx = -T * c.C @ c.A, -T * (c.dC @ c.A + c.C @ c.dA)
    Du = Cx @ discrete.B1 - T * c.C @ c.B
    dDu = dCx @ discrete.B1 + Cx @ discrete.dB1 - T * (c.dC @ c.B + c.C @ c.dB)
    return Cx, Du, -c.D, dCx, dDu, -c.dD


def _derivative_weights(offsets: tuple[int, ...]) -> FloatArray:
    """Return (taps, degree + 1): what readings add to the polynomial's derivatives at 0, time in samples."""
    from numpy.polynomial import polynomial  # it takes 3 ms to import, and few configurations ask for it

    rows = []
    for o in offsets:
        others = [other for other in offsets if other != o]
        lagrange = polynomial.polyfromroots(others) / np.prod([float(o - other) for other in others])
        rows.append([factorial(j) * c for j, c in enumerate(lagrange)])
    return np.array(rows)


def _direct(D: NDArray[np.float64], offsets: tuple[int, ...]) -> FloatArray:
    """Return D (..., p, m) for readings side by side (..., p, taps * m): only the sample's own acts."""
    m = D.shape[-1]
    out = np.zeros((*D.shape[:-1], len(offsets) * m))
    place = offsets.index(0) * m
    out[..., place : place + m] = D
    return out
