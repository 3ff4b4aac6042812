"""Estimators that window-ml is compared with, and what they share: the sampled model as a function of theta.

Here are recursive least squares with forgetting, on the regression of `agent.numerics.paper.seed`, and the
adaptive observer; the joint Kalman filters are in `joint`. All know the model, the force and the noise of the
sensors. Each runs over y (N, p), u (N, m) and returns estimates and standard deviations after every sample,
(N, q) each.

The sampled model is a second-order Taylor polynomial about nominal: an exponential of a matrix at every step
would cost twenty times a filter itself.
"""

from dataclasses import dataclass

import numpy as np

from agent.evaluation.tuning import SETTLING_SAMPLES
from agent.numerics.model.statespace import Hold, Model, discretise, simulate
from agent.numerics.paper.seed import observe
from agent.types import FloatArray

Track = tuple[FloatArray, FloatArray]


class Polynomial:
    """[A B; C D](theta) of the sampled model to second order about nominal, and its derivatives.

    Rows of C and D are there only where they depend on theta: of accelerometers, of outputs' gains and
    offsets.

    Attributes:
        size: (q,) what a parameter's change is counted in: its nominal, or what is given for one whose
            nominal is 0.
        direct: they do not, and C and D are those at nominal.
    """

    def __init__(
        self, model: Model, period_s: float, hold: Hold = "first", size: FloatArray | None = None
    ) -> None:  # fmt: skip
        def sampled(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
            s = discretise(model.continuous(theta), period_s, hold).model
            rows = (s.A, s.B, s.dA, s.dB), (s.C, s.D, s.dC, s.dD)
            wanted = rows[: 1 if self.direct else 2]
            whole = np.vstack([np.hstack([left, right]) for left, right, _, _ in wanted])
            derivatives = [np.concatenate([left, right], axis=2) for _, _, left, right in wanted]
            return whole, np.concatenate(derivatives, axis=1)

        self.nominal = np.array(model.nominal, dtype=float)
        self.size = np.where(self.nominal != 0, np.abs(self.nominal), 1.0) if size is None else size
        continuous = model.continuous(self.nominal)
        self.direct = not (continuous.dC.any() or continuous.dD.any())
        self.base = discretise(continuous, period_s, hold)
        base = self.base.model
        self.C, self.D = base.C, base.D
        self.n, self.m, self.q, self.p = base.n, base.m, base.q, base.p
        self.zeroth, self.first = sampled(self.nominal)
        second = np.zeros((self.q, *self.first.shape))
        for j, size_j in enumerate(self.size):
            step = np.zeros(self.q)
            step[j] = 1e-3 * size_j
            second[j] = (sampled(self.nominal + step)[1] - sampled(self.nominal - step)[1]) / (2 * step[j])
        self._second = second.reshape(self.q, -1)
        self._flat = self.first.reshape(-1)
        self._shape = self.first.shape

    def derivatives(self, change: FloatArray) -> FloatArray:
        """d[A B; C D] by each parameter, (q, n or n+p, n+m), at nominal + change."""
        return (self._flat + change @ self._second).reshape(self._shape)

    def matrix(self, change: FloatArray, derivatives: FloatArray) -> FloatArray:
        """[A B; C D] at nominal + change from derivatives there: Taylor asks their mean with nominal ones."""
        mean = 0.5 * (self._flat + derivatives.reshape(-1))
        return self.zeroth + (change @ mean.reshape(self.q, -1)).reshape(self.zeroth.shape)


@dataclass(frozen=True, slots=True)
class Start:
    """Where a filter begins: state x (n,) of the sampled model and how far it may be off."""

    x: FloatArray
    sd: FloatArray


def start_of(polynomial: Polynomial, y: FloatArray, u: FloatArray) -> Start:
    """Return the state the first reading shows, as uncertain as the states of a rig so moved are large."""
    x = np.linalg.pinv(polynomial.C) @ (y[0] - polynomial.D @ u[0])
    states, _ = simulate(polynomial.base, x + polynomial.base.B1 @ u[0], u[:SETTLING_SAMPLES])
    return Start(x, np.sqrt(np.mean(states**2, axis=0)) + 1e-3 * float(np.abs(states).max()) + 1e-300)


@dataclass(frozen=True, slots=True)
class Tuning:
    """What a joint filter is given beside the noise of the sensors.

    Attributes:
        walk: random walk of each parameter a sample, as a share of its size.
        spread: standard deviation of each parameter at the start, as a share of its size.
        push: random walk of each state a sample, as a share of its size: unknown forces. Never 0: round-off
            would make P indefinite.
    """

    walk: float
    spread: float = 0.5
    push: float = 1e-9


def run_rls(
    model: Model, period_s: float, gain: FloatArray, forget: float, y: FloatArray, u: FloatArray,
    hold: Hold = "first",
    size: FloatArray | None = None,
) -> Track:  # fmt: skip
    """Recursive least squares with forgetting on the seed's b(k) = sum (dA_i x + dB_i u) theta_i."""
    s = discretise(model.continuous(model.nominal), period_s, hold).model
    x = observe(s, gain, y, u, np.zeros(s.n))
    b = x[1:] - x[:-1] @ s.A.T - u @ s.B.T
    rows = np.einsum("kj,qij->kiq", np.hstack([x[:-1], u]), np.concatenate([s.dA, s.dB], axis=2))
    # in units of the correction's own size, so that the start weighs like a hundredth of a sample whatever
    # the units
    scale = float(np.sqrt(np.mean(b**2)))
    b, rows = b / scale, rows / scale
    change = np.zeros(s.q)
    P = np.diag((10.0 * (model.nominal if size is None else size)) ** 2)
    square, weight = 0.0, 0.0
    theta, sd = np.empty((len(y), s.q)), np.empty((len(y), s.q))
    eye = np.eye(s.n)
    for k, (row, bk) in enumerate(zip(rows, b, strict=True)):
        PR = P @ row.T
        S = forget * eye + row @ PR
        K = np.linalg.solve(S, PR.T).T
        error = bk - row @ change
        change = change + K @ error
        P = (P - K @ PR.T) / forget
        P = 0.5 * (P + P.T)
        left = bk - row @ change
        square, weight = forget * square + left @ error, forget * weight + s.n
        theta[k] = change
        sd[k] = P.diagonal() * max(square, 0.0) / max(weight - s.q, 1.0)
    return model.nominal + theta, np.sqrt(sd)


def run_observer(
    polynomial: Polynomial, gain: FloatArray, rate: float, sigma: FloatArray, y: FloatArray, u: FloatArray
) -> Track:
    """Run the adaptive Luenberger observer (Guyader & Zhang, IFAC SYSID 2003), its gain normalised.

        Y(k+1) = (A - L C) Y + Psi          th(k+1) = th + mu G Y'C' R^-1 e / (1 + tr C Y G Y'C' R^-1)
        x(k+1) = A x + B u + Psi th + L e + Y(k+1) (th(k+1) - th)

    with Psi = dA x + dB u, G the squares of the parameters' sizes, R those of sigma (p,), mu the rate. It
    states no standard deviation: those returned are NaN.
    """
    poly, n = polynomial, polynomial.n
    C = poly.C
    R = 1.0 / np.square(sigma)
    z = y - u @ poly.D.T
    x = start_of(poly, y, u).x
    change, spread = np.zeros(poly.q), np.zeros((n, poly.q))
    theta = np.empty((len(y), poly.q))
    G = poly.size**2
    xu = np.empty(n + poly.m)
    for k, zk in enumerate(z):
        xu[:n], xu[n:] = x, u[k]
        derivatives = poly.derivatives(change)
        W = poly.matrix(change, derivatives)[:n]
        error = zk - C @ x
        shown = C @ spread
        weighed = G[:, None] * shown.T * R
        step = rate * (weighed @ error) / (1.0 + float(np.sum(weighed.T * shown)))
        spread = (W[:, :n] - gain @ C) @ spread + (derivatives[:, :n] @ xu).T
        x = W @ xu + gain @ error + spread @ step
        change = change + step
        theta[k] = change
    return poly.nominal + theta, np.full_like(theta, np.nan)
