"""How much change of the sampled matrices the observer bears: the paper's conditions (3) and (8).

Condition (8), the largest delta for which the LMI (7) has a solution, is the discrete bounded-real lemma, so
delta is exactly 1 / ||(zI - A)^-1|| (the H-infinity norm) = the least singular value of zI - A on the unit
circle, with A = diag(A0, A0 - L C0). No LMI is solved for it. A margin in the parameters' own units is in
`margins_box`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigvals

from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Condition3:
    """(3): both spectral radii must be below 1, for constant parameters."""

    radius_model: float
    radius_observer: float

    @property
    def holds(self) -> bool:
        """Whether model and observer are both stable."""
        return self.radius_model < 1.0 and self.radius_observer < 1.0


@dataclass(frozen=True, slots=True)
class Condition8:
    """(8): parameters may vary in time in any way while the norm of the perturbation stays below delta."""

    delta: float
    perturbation_norm: float

    @property
    def h_infinity(self) -> float:
        """||(zI - A)^-1||, 1/delta; inf where the margin is zero."""
        return 1.0 / self.delta if self.delta > 0 else np.inf

    @property
    def holds(self) -> bool:
        """Whether the perturbation is small enough."""
        return self.perturbation_norm < self.delta


def condition_3(A: FloatArray, gain: FloatArray, C: FloatArray, dA: FloatArray | None = None) -> Condition3:
    """Evaluate (3) for A0 + dA (n, n) and A0 - L C0."""
    changed = A if dA is None else A + dA
    return Condition3(_radius(changed), _radius(A - gain @ C))


def _radius(A: FloatArray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))


def condition_8(A: FloatArray, gain: FloatArray, C: FloatArray, dA: FloatArray, dC: FloatArray) -> Condition8:
    """Evaluate (8) for perturbations dA (n, n), dC (p, n) of the sampled model."""
    # the norm of a block diagonal is the larger of its blocks' norms, so delta is the smaller of two
    delta = min(stability_margin(A), stability_margin(A - gain @ C))
    return Condition8(delta, perturbation_norm(gain, dA, dC))


def perturbation_norm(gain: FloatArray, dA: FloatArray, dC: FloatArray) -> float:
    """Return the spectral norm of the Delta of (4): [[dA, 0], [L dC - dA, 0]]."""
    return float(np.linalg.norm(np.vstack([dA, gain @ dC - dA]), 2))


def stability_margin(A: FloatArray) -> float:
    """Return min over |z| = 1 of the least singular value of zI - A (n, n); 0 unless A is stable.

    delta is a singular value at z where (z I - A) v = delta w and (I/z - A') w = delta v, that is, where z is
    an eigenvalue on the unit circle of the symplectic pencil z [[I, 0], [-delta I, -A']] - [[A, delta I], [0,
    -I]] (Boyd & Balakrishnan, Systems & Control Letters 15 (1990) 1). Instead of halving an interval the
    level is lowered to the least value at and half-way between the eigenvalues' angles, which converges
    quadratically (Bruinsma & Steinbuch, ibid. 14 (1990) 287). All eigenvalues are tried, not those within
    some distance of the circle, so that poles next to it cost no accuracy: each value is one that zI - A
    takes.
    """
    if not len(A) or _radius(A) >= 1.0:
        return 0.0 if len(A) else np.inf
    angles = np.concatenate([[0.0, np.pi], np.abs(np.angle(np.linalg.eigvals(A)))])
    level = _least(A, angles)
    for _ in range(100):
        crossings = np.unique(np.concatenate([[0.0, np.pi], _crossings(A, level * (1.0 - 1e-12))]))
        lower = _least(A, np.concatenate([crossings, 0.5 * (crossings[1:] + crossings[:-1])]))
        if lower >= level * (1.0 - 1e-12):
            break
        level = lower
    return level


def _least(A: FloatArray, angles: FloatArray) -> float:
    """Return the least singular value of zI - A over z = exp(j angle), angles (K,)."""
    z = np.exp(1j * angles)
    return float(np.linalg.svd(z[:, None, None] * np.eye(len(A)) - A, compute_uv=False)[:, -1].min())


def _crossings(A: FloatArray, delta: float) -> FloatArray:
    """Return the angles in [0, pi] of the finite eigenvalues of the symplectic pencil at a level."""
    n = len(A)
    one = np.eye(n)
    none = np.zeros((n, n))
    left = np.block([[A, delta * one], [none, -one]])
    right = np.block([[one, none], [-delta * one, -A.T]])
    z = eigvals(left, right)
    z = z[np.isfinite(z) & (np.abs(z) > 0.5) & (np.abs(z) < 2.0)]
    return np.asarray(np.abs(np.angle(z)), dtype=float)
