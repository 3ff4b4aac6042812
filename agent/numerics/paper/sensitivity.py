"""Observer and sensitivity filters as one linear system.

    e = y - C x - D u,      x' = Phi x + (B - L D) u + L y,      Phi = A - L C
    s_i' = Phi s_i + (dA_i - L dC_i) x + (dB_i - L dD_i) u,      psi_i = C s_i + dC_i x + dD_i u

psi_i is the derivative of the predicted output by parameter i at fixed gain L, so e ~ sum psi_i (theta -
theta_r)_i + noise (Ljung, System Identification, 2nd ed. 1999, section 10.3: the gradient of the prediction).
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.statespace import StateSpace
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class SensitivityFilter:
    """z' = F z + N v, o = H z + J v with z = (x, s_1 .. s_q) and v = (y, u).

    Attributes:
        F, N: (n(1+q), n(1+q)), (n(1+q), p+m).
        H, J: (p(1+q), n(1+q)), (p(1+q), p+m); rows run over outputs, then over (e, psi_1 .. psi_q).
        n, p, q: states, outputs, parameters.
    """

    F: FloatArray
    N: FloatArray
    H: FloatArray
    J: FloatArray
    n: int
    p: int
    q: int


def sensitivity_filter(model: StateSpace, gain: FloatArray) -> SensitivityFilter:
    """Build the filters of a sampled model for gain L (n, p)."""
    n, m, p, q = model.n, model.m, model.p, model.q
    Phi = model.A - gain @ model.C
    F = np.asarray(np.kron(np.eye(1 + q), Phi), dtype=np.float64)
    N = np.zeros((n * (1 + q), p + m))
    N[:n] = np.hstack([gain, model.B - gain @ model.D])
    H = np.zeros((p, 1 + q, n * (1 + q)))
    J = np.zeros((p, 1 + q, p + m))
    H[:, 0, :n] = -model.C
    J[:, 0] = np.hstack([np.eye(p), -model.D])
    for i in range(q):
        rows = slice(n * (1 + i), n * (2 + i))
        F[rows, :n] = model.dA[i] - gain @ model.dC[i]
        N[rows, p:] = model.dB[i] - gain @ model.dD[i]
        H[:, 1 + i, rows] = model.C
        H[:, 1 + i, :n] = model.dC[i]
        J[:, 1 + i, p:] = model.dD[i]
    size = p * (1 + q)
    return SensitivityFilter(F, N, H.reshape(size, -1), J.reshape(size, -1), n, p, q)
