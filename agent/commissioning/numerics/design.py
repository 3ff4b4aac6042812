"""D-optimal input: how the power of a periodic force is best spread over frequencies.

A line of unit power at the frequency w adds, each sample, the information

    M(w) = Re sum over outputs of conj(S) S^T / sigma^2,    S = d G(w) / d theta,

to that of the parameters (Mehra 1974, IEEE Trans. Automatic Control 19:753; Goodwin and Payne 1977, chapter
6). Powers that sum to one and make det of the sum greatest are found by the multiplicative algorithm

    p(w) <- p(w) d(w) / q,    d(w) = trace(M^-1 M(w))

(Silvey, Titterington and Torsney 1978), and are optimal where no d(w) exceeds q (Kiefer and Wolfowitz 1960).
"""

from dataclasses import dataclass

import numpy as np

from agent.commissioning.tuning import CHECK, DESIGN_ROUNDS, GAP, LITTLE
from agent.numerics.model.statespace import Discrete
from agent.types import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class Design:
    """Powers (L,) of lines that sum to one, and by which share the greatest d exceeds q."""

    power: FloatArray
    gap: float


def responses(discrete: Discrete, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return G (F, p, m) and its derivatives (F, q, p, m) at angular frequencies (F,), rad/s."""
    m = discrete.model
    z = np.exp(1j * omega * discrete.period_s)
    free = np.linalg.inv(z[:, None, None] * np.eye(m.n) - m.A)
    to_y = m.C @ free
    from_u = free @ m.B
    G = to_y @ m.B + m.D
    S = np.einsum("fpi,kij,fjm->fkpm", to_y, m.dA, from_u) + np.einsum("fpi,kim->fkpm", to_y, m.dB)
    S = S + np.einsum("kpi,fim->fkpm", m.dC, from_u) + m.dD
    return np.asarray(G, dtype=np.complex128), np.asarray(S, dtype=np.complex128)


def line_information(discrete: Discrete, omega: FloatArray, column: int, sigma: FloatArray) -> FloatArray:
    """Return the information (F, q, q) a sample of unit power of one input; sigma (p,) output noise."""
    S = responses(discrete, omega)[1][..., column] / sigma
    return np.asarray(np.einsum("fkp,flp->fkl", S.conj(), S).real)


def optimal(information: FloatArray) -> Design:
    """Return the powers (L,) whose sum of information (L, q, q) has the greatest determinant.

    Raises ValueError where all of them together leave a parameter unknown.
    """
    scaled = _scaled(information)
    power = _multiplied(scaled, np.full(len(scaled), 1.0 / len(scaled)))
    for little in LITTLE:
        few = np.flatnonzero(power >= little * power.max())
        kept = np.zeros(len(power))
        kept[few] = _multiplied(scaled[few], power[few] / power[few].sum())
        gap = excess(scaled, kept)
        if gap <= 2 * GAP:
            break
    return Design(kept, gap)


def excess(information: FloatArray, power: FloatArray) -> float:
    """Return by which share the greatest d of all lines exceeds q: 0 of the best powers."""
    greatest = float(_d(information, power).max())
    return greatest / int(information.shape[1]) - 1.0


def _scaled(information: FloatArray) -> FloatArray:
    """Return information in parameters of which all lines together know the same."""
    total = np.einsum("fkk->k", information)
    if not np.all(total > 0.0):
        raise ValueError("a parameter leaves no trace at any frequency")
    root = 1.0 / np.sqrt(total)
    scaled = information * np.outer(root, root)
    values = np.linalg.eigvalsh(scaled.sum(axis=0))
    if values[0] <= 1e-12 * values[-1]:
        raise ValueError("some parameters cannot be told apart at any frequency")
    return scaled


def _d(information: FloatArray, power: FloatArray) -> FloatArray:
    M = np.einsum("f,fkl->kl", power, information)
    return np.asarray(np.einsum("kl,flk->f", np.linalg.inv(M), information))


def _multiplied(information: FloatArray, power: FloatArray) -> FloatArray:
    q = information.shape[1]
    flat = information.reshape(len(information), -1)
    for step in range(DESIGN_ROUNDS):
        inverse = np.linalg.inv((power @ flat).reshape(q, q))
        d = flat @ inverse.ravel()
        if step % CHECK == 0 and d.max() <= q * (1.0 + GAP):
            break
        power = power * d / q
    return np.asarray(power / power.sum())
