"""The estimators that the paper argues against, built from public parts: joint EKF and UKF (filterpy), recursive LS.

EKF and UKF carry the parameters as extra states with a random walk; recursive least squares with forgetting runs on
the regression of `agent.numerics.paper.seed`. All three know the model, the force and the noise of the sensors.
Each runs over y (N, p), u (N, m) and returns estimates and standard deviations after every sample, (N, q) each.

The sampled model as a function of theta is a second-order Taylor polynomial about nominal, exact to 1e-9 over the
changes met here: an exponential of a matrix at every step would cost twenty times the filter itself.
"""

from dataclasses import dataclass

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from agent.numerics.model.statespace import Model, discretise
from agent.numerics.paper.seed import observe

FloatArray = NDArray[np.float64]
Track = tuple[FloatArray, FloatArray]


class Polynomial:
    """[A B](theta) of the sampled model to second order about nominal, and its derivatives."""

    def __init__(self, model: Model, period_s: float) -> None:
        def sampled(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
            s = discretise(model.continuous(theta), period_s, "first").model
            return np.hstack([s.A, s.B]), np.concatenate([s.dA, s.dB], axis=2)

        self.nominal = np.array(model.nominal, dtype=float)
        base = discretise(model.continuous(self.nominal), period_s, "first").model
        self.C, self.D = base.C, base.D
        self.n, self.m, self.q = base.n, base.m, base.q
        self.zeroth, self.first = sampled(self.nominal)
        second = np.zeros((self.q, *self.first.shape))
        for j, size in enumerate(self.nominal):
            step = np.zeros(self.q)
            step[j] = 1e-3 * size
            second[j] = (sampled(self.nominal + step)[1] - sampled(self.nominal - step)[1]) / (2 * step[j])
        self._second = second.reshape(self.q, -1)
        self._flat = self.first.reshape(-1)
        self._shape = self.first.shape

    def derivatives(self, change: FloatArray) -> FloatArray:
        """d[A B] by each parameter, (q, n, n+m), at nominal + change."""
        return (self._flat + change @ self._second).reshape(self._shape)

    def matrix(self, change: FloatArray, derivatives: FloatArray) -> FloatArray:
        """[A B] at nominal + change (n, n+m) from the derivatives there: Taylor asks their mean with nominal ones."""
        mean = 0.5 * (self._flat + derivatives.reshape(-1))
        return self.zeroth + (change @ mean.reshape(self.q, -1)).reshape(self.zeroth.shape)


@dataclass(frozen=True, slots=True)
class Tuning:
    """What a joint filter is told beside the noise of the sensors.

    Attributes:
        walk: random walk of each parameter a sample, as a share of its nominal value.
        spread: standard deviation of each parameter at the start, as a share of its nominal value.
    """

    walk: float
    spread: float = 0.5


def _start(polynomial: Polynomial, tuning: Tuning, first: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Initial joint state, its covariance and the covariance of the process a sample."""
    n, q = polynomial.n, polynomial.q
    x = np.zeros(n + q)
    x[n - len(first) : n] = first
    state = np.concatenate([np.full(n - len(first), 0.05), np.full(len(first), 1e-3)])
    P = np.diag(np.concatenate([state, tuning.spread * polynomial.nominal]) ** 2)
    # the states need some process noise of their own, or round-off makes P indefinite
    Q = np.diag(np.concatenate([1e-9 * state, tuning.walk * polynomial.nominal]) ** 2)
    return x, P, Q


class JointEkf(ExtendedKalmanFilter):
    """filterpy's EKF; only the prediction of state and Jacobian is ours."""

    def __init__(self, polynomial: Polynomial, sigma: float, tuning: Tuning, first: FloatArray) -> None:
        n, q, p = polynomial.n, polynomial.q, len(polynomial.C)
        super().__init__(dim_x=n + q, dim_z=p)
        self.polynomial = polynomial
        self.x, self.P, self.Q = _start(polynomial, tuning, first)
        self.R = sigma**2 * np.eye(p)
        self.H = np.hstack([polynomial.C, np.zeros((p, q))])
        self._xu = np.zeros(n + polynomial.m)

    def predict_x(self, u: FloatArray = 0) -> None:
        """Advance the joint state and set F to the analytic Jacobian at the state it starts from."""
        poly, n = self.polynomial, self.polynomial.n
        xu, change = self._xu, self.x[n:]
        xu[:n], xu[n:] = self.x[:n], u
        dW = poly.derivatives(change)
        W = poly.matrix(change, dW)
        self.F[:n, :n] = W[:, :n]
        self.F[:n, n:] = (dW @ xu).T
        self.x = np.concatenate([W @ xu, change])

    def jacobian(self, _x: FloatArray) -> FloatArray:
        return self.H

    def measure(self, x: FloatArray) -> FloatArray:
        return self.H @ x


def run_ekf(polynomial: Polynomial, sigma: float, tuning: Tuning, y: FloatArray, u: FloatArray) -> Track:
    n = polynomial.n
    z = y - u @ polynomial.D.T
    ekf = JointEkf(polynomial, sigma, tuning, z[0])
    theta, sd = np.empty((len(y), polynomial.q)), np.empty((len(y), polynomial.q))
    for k, zk in enumerate(z):
        ekf.update(zk, ekf.jacobian, ekf.measure)
        theta[k], sd[k] = ekf.x[n:], ekf.P.diagonal()[n:]
        ekf.predict(u[k])
    return polynomial.nominal + theta, np.sqrt(sd)


def run_ukf(polynomial: Polynomial, sigma: float, tuning: Tuning, y: FloatArray, u: FloatArray) -> Track:
    """filterpy's UKF with its scaled sigma points (alpha 0.1, beta 2, kappa 0)."""
    n, p = polynomial.n, len(polynomial.C)
    C = polynomial.C

    def advance(x: FloatArray, _dt: float, u: FloatArray) -> FloatArray:
        change = x[n:]
        W = polynomial.matrix(change, polynomial.derivatives(change))
        return np.concatenate([W @ np.concatenate([x[:n], u]), change])

    points = MerweScaledSigmaPoints(n + polynomial.q, alpha=0.1, beta=2.0, kappa=0.0)
    ukf = UnscentedKalmanFilter(n + polynomial.q, p, 1.0, lambda x: C @ x[:n], advance, points)
    z = y - u @ polynomial.D.T
    ukf.x, ukf.P, ukf.Q = _start(polynomial, tuning, z[0])
    ukf.R = sigma**2 * np.eye(p)
    # sigma points exist only after a prediction; the first reading is used to set the state
    theta, sd = np.empty((len(y), polynomial.q)), np.empty((len(y), polynomial.q))
    for k, zk in enumerate(z):
        if k:
            ukf.predict(u=u[k - 1])
            ukf.update(zk)
        theta[k], sd[k] = ukf.x[n:], ukf.P.diagonal()[n:]
    return polynomial.nominal + theta, np.sqrt(sd)


def run_rls(model: Model, period_s: float, gain: FloatArray, forget: float, y: FloatArray, u: FloatArray) -> Track:
    """Recursive least squares with forgetting on b(k) = sum (dA_i x + dB_i u) theta_i of the seed's regression."""
    s = discretise(model.continuous(model.nominal), period_s, "first").model
    x = observe(s, gain, y, u, np.zeros(s.n))
    b = x[1:] - x[:-1] @ s.A.T - u @ s.B.T
    rows = np.einsum("kj,qij->kiq", np.hstack([x[:-1], u]), np.concatenate([s.dA, s.dB], axis=2))
    # in units of the correction's own size, so that the start weighs like a hundredth of a sample whatever the units
    size = float(np.sqrt(np.mean(b**2)))
    b, rows = b / size, rows / size
    change, P = np.zeros(s.q), np.diag((10.0 * model.nominal) ** 2)
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
        theta[k], sd[k] = change, P.diagonal() * max(square, 0.0) / max(weight - s.q, 1.0)
    return model.nominal + theta, np.sqrt(sd)
