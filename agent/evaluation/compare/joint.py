"""Joint extended and unscented Kalman filters of filterpy: parameters are further states with a random walk.

Imported where it is used: filterpy takes 0.7 s to import.
"""

from collections.abc import Iterator

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from agent.evaluation.compare.rivals import Polynomial, Track, Tuning, start_of
from agent.types import FloatArray

ALPHA, BETA, KAPPA = 0.1, 2.0, 0.0
"""Fixed by van der Merwe 2004: of the scaled sigma points (van der Merwe 2004): narrow, Gaussian, none
besides."""


def _start(
    polynomial: Polynomial, tuning: Tuning, y: FloatArray, u: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the joint state at the start, its covariance and the covariance of the process a sample."""
    start = start_of(polynomial, y, u)
    x = np.concatenate([start.x, np.zeros(polynomial.q)])
    P = np.diag(np.concatenate([start.sd, tuning.spread * polynomial.size]) ** 2)
    Q = np.diag(np.concatenate([tuning.push * start.sd, tuning.walk * polynomial.size]) ** 2)
    return x, P, Q


def _noise(polynomial: Polynomial, sigma: float | FloatArray) -> FloatArray:
    return np.diag(np.broadcast_to(sigma, (polynomial.p,)) ** 2)


class JointEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's EKF; only the prediction of state and Jacobian is ours."""

    def __init__(
        self, polynomial: Polynomial, sigma: float | FloatArray, tuning: Tuning, y: FloatArray, u: FloatArray
    ) -> None:
        n, q, p = polynomial.n, polynomial.q, polynomial.p
        super().__init__(dim_x=n + q, dim_z=p)
        self.polynomial = polynomial
        self.x, self.P, self.Q = _start(polynomial, tuning, y, u)
        self.R = _noise(polynomial, sigma)
        self.H = np.hstack([polynomial.C, np.zeros((p, q))])
        self._xu = np.zeros(n + polynomial.m)
        self._derivatives = polynomial.first
        self._matrix = polynomial.zeroth

    def predict_x(self, u: FloatArray | float = 0) -> None:
        """Advance the joint state and set F to the analytic Jacobian at the state it starts from."""
        poly, n = self.polynomial, self.polynomial.n
        xu, change = self._xu, self.x[n:]
        xu[:n], xu[n:] = self.x[:n], u
        dW = self._derivatives = poly.derivatives(change)
        W = self._matrix = poly.matrix(change, dW)
        self.F[:n, :n] = W[:n, :n]
        self.F[:n, n:] = (dW[:, :n] @ xu).T
        self.x = np.concatenate([W[:n] @ xu, change])

    def look(self, u: FloatArray) -> None:
        """Set H to the reading's Jacobian under inputs u (m,); where it depends on no parameter it stays."""
        n, xu = self.polynomial.n, self._xu
        xu[:n], xu[n:] = self.x[:n], u
        self.H[:, :n] = self._matrix[n:, :n]
        self.H[:, n:] = (self._derivatives[:, n:] @ xu).T

    def jacobian(self, _x: FloatArray) -> FloatArray:
        """Return H."""
        return np.asarray(self.H)

    def measure(self, x: FloatArray) -> FloatArray:
        """Return the reading that a joint state gives, less what the inputs give at once."""
        return np.asarray(self.H @ x)

    def reading(self, _x: FloatArray) -> FloatArray:
        """Return the reading where C and D depend on parameters; the state is that of the last `look`."""
        return np.asarray(self._matrix[self.polynomial.n :] @ self._xu)


def ekf_steps(
    polynomial: Polynomial, sigma: float | FloatArray, tuning: Tuning, y: FloatArray, u: FloatArray
) -> Iterator[JointEkf]:
    """Run the filter over y (N, p), u (N, m); yield it after each update."""
    ekf = JointEkf(polynomial, sigma, tuning, y, u)
    z = y - u @ polynomial.D.T if polynomial.direct else y
    measure = ekf.measure if polynomial.direct else ekf.reading
    for k, zk in enumerate(z):
        if not polynomial.direct:
            ekf.look(u[k])
        ekf.update(zk, ekf.jacobian, measure)
        yield ekf
        ekf.predict(u[k])


def run_ekf(
    polynomial: Polynomial, sigma: float | FloatArray, tuning: Tuning, y: FloatArray, u: FloatArray
) -> Track:  # fmt: skip
    """Return what the joint EKF estimates."""
    n = polynomial.n
    theta, sd = np.empty((len(y), polynomial.q)), np.empty((len(y), polynomial.q))
    for k, ekf in enumerate(ekf_steps(polynomial, sigma, tuning, y, u)):
        theta[k], sd[k] = ekf.x[n:], ekf.P.diagonal()[n:]
    return polynomial.nominal + theta, np.sqrt(sd)


def likelihood(
    polynomial: Polynomial, sigma: float | FloatArray, tuning: Tuning, y: FloatArray, u: FloatArray
) -> float:  # fmt: skip
    """Return the logarithm of the innovations' likelihood, the first tenth left out as start."""
    total = 0.0
    first = len(y) // 10
    for k, ekf in enumerate(ekf_steps(polynomial, sigma, tuning, y, u)):
        if k >= first:
            sign, size = np.linalg.slogdet(ekf.S)
            total -= 0.5 * float(ekf.y @ ekf.SI @ ekf.y + size) if sign > 0 else np.inf
    return total


def run_ukf(
    polynomial: Polynomial, sigma: float | FloatArray, tuning: Tuning, y: FloatArray, u: FloatArray
) -> Track:  # fmt: skip
    """Return what filterpy's UKF with its scaled sigma points estimates."""
    n, p = polynomial.n, polynomial.p
    C = polynomial.C

    def moved(x: FloatArray) -> FloatArray:
        change = x[n:]
        return polynomial.matrix(change, polynomial.derivatives(change))

    def advance(x: FloatArray, _dt: float, u: FloatArray) -> FloatArray:
        return np.concatenate([moved(x)[:n] @ np.concatenate([x[:n], u]), x[n:]])

    def read(x: FloatArray, u: FloatArray) -> FloatArray:
        return C @ x[:n] if polynomial.direct else moved(x)[n:] @ np.concatenate([x[:n], u])

    points = MerweScaledSigmaPoints(n + polynomial.q, alpha=ALPHA, beta=BETA, kappa=KAPPA)
    ukf = UnscentedKalmanFilter(n + polynomial.q, p, 1.0, read, advance, points)
    z = y - u @ polynomial.D.T if polynomial.direct else y
    ukf.x, ukf.P, ukf.Q = _start(polynomial, tuning, y, u)
    ukf.R = _noise(polynomial, sigma)
    # sigma points exist only after a prediction; the first reading is used to set the state
    theta, sd = np.empty((len(y), polynomial.q)), np.empty((len(y), polynomial.q))
    for k, zk in enumerate(z):
        if k:
            ukf.predict(u=u[k - 1])
            ukf.update(zk, u=u[k])
        theta[k], sd[k] = ukf.x[n:], ukf.P.diagonal()[n:]
    return polynomial.nominal + theta, np.sqrt(sd)
