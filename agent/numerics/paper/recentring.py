"""Where re-centred passes of the paper's estimator go: whether the right parameters attract them.

A pass solves, over a window, min over d of the sum of |L e - sum_i phi_i d_i|^2: by (2) the regressand of
(10) is the observer's correction L e, and phi_i = dA_i x + dB_i u. Near the right parameters the innovation
is e = - sum_j psi_j (theta - theta*)_j, psi_j its sensitivity, so that a pass takes the error to M times the
error with

    M = I - G^-1 H,      G_ij = sum phi_i' phi_j,      H_ij = sum phi_i' L psi_j

The right parameters are always a fixed point. They attract when every eigenvalue of M lies within the unit
circle; the largest is the ratio of successive steps. H knows the window by phi_i' L alone, which are the q
combinations L' [dA_i dB_i] of the p (n + m) products of innovations and regressors: are these combinations
dependent, H is singular, M has the eigenvalue 1, and fixed points form a curve through the right one.
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.statespace import StateSpace
from agent.numerics.paper.seed import observe
from agent.numerics.paper.sensitivity import sensitivity_filter
from agent.numerics.paper.tuning import DEPENDENT, SLOWEST
from agent.types import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class Recentring:
    """What passes do near the right parameters.

    Attributes:
        eigenvalues: (q,) of M.
        independent: the least singular value of the combinations L' [dA_i dB_i].
    """

    eigenvalues: ComplexArray
    independent: float

    @property
    def ratio(self) -> float:
        """The ratio of successive steps in the end."""
        return float(np.abs(self.eigenvalues).max(initial=0.0))

    @property
    def converges(self) -> bool:
        """Whether passes reach the right parameters within reason."""
        return self.ratio <= SLOWEST and self.independent >= DEPENDENT


def recentring(
    model: StateSpace, gain: FloatArray, scale: FloatArray, u: FloatArray, x0: FloatArray, window: int
) -> Recentring:
    """Return what passes do about a sampled model that is right.

    Args:
        model: with its derivatives.
        gain: (n, p) the observer's.
        scale: (q,) size of each parameter.
        u: (N, m) inputs.
        x0: (n,) the model's state at the first of them.
        window: the last so many samples count.
    """
    y = _readings(model, u, x0)
    states = observe(model, gain, y, u, x0)[-window - 1 : -1]
    phi = np.einsum("kn,qdn->kdq", states, model.dA) + np.einsum("km,qdm->kdq", u[-window:], model.dB)
    pushed = np.einsum("dp,kpq->kdq", gain, _sensitivities(model, gain, y, u, x0)[-window:])
    left, right = (part.reshape(-1, model.q) * scale for part in (phi, pushed))
    M = np.eye(model.q) - np.linalg.lstsq(left, right, rcond=None)[0]
    return Recentring(np.linalg.eigvals(M).astype(np.complex128), independence(model, gain))


def independence(model: StateSpace, gain: FloatArray) -> float:
    """Return the least singular value of combinations L' [dA_i dB_i] of length 1; 0 where one is nothing."""
    whole = np.concatenate([model.dA, model.dB], axis=2)
    combined = np.einsum("dp,qdr->qpr", gain, whole).reshape(model.q, -1)
    lengths = np.linalg.norm(combined, axis=1)
    if not lengths.all() or combined.shape[1] < model.q:
        return 0.0
    return float(np.linalg.svd(combined / lengths[:, None], compute_uv=False)[-1])


def _readings(model: StateSpace, u: FloatArray, x0: FloatArray) -> FloatArray:
    unread = np.zeros((model.n, model.p))
    states = observe(model, unread, np.zeros((len(u), model.p)), u, x0)[:-1]
    return np.asarray(states @ model.C.T + u @ model.D.T)


def _sensitivities(
    model: StateSpace, gain: FloatArray, y: FloatArray, u: FloatArray, x0: FloatArray
) -> FloatArray:
    """Return d y_predicted by each parameter (N, p, q), the observer's gain held."""
    system = sensitivity_filter(model, gain)
    z = np.concatenate([x0, np.zeros(len(system.F) - model.n)])
    v = np.hstack([y, u])
    rows = np.empty((len(v), len(system.H)))
    for k, push in enumerate(v @ system.N.T):
        rows[k] = system.H @ z
        z = system.F @ z + push
    return np.asarray((rows + v @ system.J.T).reshape(len(v), model.p, 1 + model.q)[:, :, 1:])
