"""The estimator of the paper this product grew from: observer first, then uncertainty matrices by descent.

Numbers in brackets are the paper's ("Observer Based Parameter Estimation For Linear Uncertain Discrete-Time
Systems"). The observer (2) gives states x(k); dA x(k) = b(k) with b(k) = x(k+1) - A0 x(k) - B u(k) is (10),
and dC x(k) = y(k) - C0 x(k) likewise. Both are here one matrix equation M r(k) = t(k) over a batch of
samples.

How Z enters. (13) is written for one sample, (16) sums over a batch: were the M(Z) of (16) taken anew at
every sample the cost would be zero for every Z. Taken here: the pseudo-inverse of (13) is that of the batch,
cut to `rank` of its directions (1 is the paper's "Rank(x) = 1"; a batch of one sample is (13) to the letter),
and descent on (16) fills the others. The cut directions are those of the batch's singular vectors, so the
cost separates and its minimum over Z is the least-squares M for every rank; Z is determined up to what the
projector removes. With the full rank the projector is zero and (14) on the batch is the answer at once.

By (2) b(k) is L (y(k) - C0 x(k)): the regressand is the observer's own correction, so M lies in the range of
L and is biased until the observer runs on the right parameters; hence `passes`, see
`agent.numerics.paper.seed_window`.
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.statespace import StateSpace
from agent.numerics.paper.tuning import RANK_TOLERANCE
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Batch:
    """M r(k) = t(k) over N samples: regressors r (N, n), targets t (N, d)."""

    regressors: FloatArray
    targets: FloatArray

    def error(self, M: FloatArray) -> FloatArray:
        """Return t(k) - M r(k), (N, d)."""
        return self.targets - self.regressors @ M.T


@dataclass(frozen=True, slots=True)
class GeneralSolution:
    """All matrices M(Z) = base + Z projector that solve a batch in its `rank` strongest directions, (13)."""

    base: FloatArray
    projector: FloatArray
    rank: int

    def at(self, Z: FloatArray) -> FloatArray:
        """Return M for the free matrix Z, both (d, n)."""
        return self.base + Z @ self.projector


@dataclass(frozen=True, slots=True)
class Existence:
    """Whether one M solves every sample of a batch.

    Attributes:
        defect: ||t r+ r - t|| / ||t||, zero where (11) holds.
        rank: rank of the regressors; rank_joined: rank of regressors and targets, equal where (12) holds.
    """

    defect: float
    rank: int
    rank_joined: int

    def holds(self, tolerance: float = 1e-9) -> bool:
        """Return whether (11) holds to the tolerance."""
        return self.defect <= tolerance


@dataclass(frozen=True, slots=True)
class Stopping:
    """When descent ends: step or cost falls to its tolerance (the paper's rules), or the count is reached."""

    step: float = 1e-12
    cost: float = 0.0
    iterations: int = 20_000

    def goes_on(self, size: float, value: float, iterations: int) -> bool:
        """Tell whether descent goes on after so many steps, the last of `size`, at a cost of `value`."""
        return size > self.step and value > self.cost and iterations < self.iterations


@dataclass(frozen=True, slots=True)
class Descent:
    """Where descent ended.

    Attributes:
        M: (d, n) the uncertainty matrix.
        Z: (d, n) the free matrix.
        iterations: steps taken.
        converged: one of the paper's two rules ended it, not the count.
        cost: (16) at the end.
        step: size of the last step of Z.
    """

    M: FloatArray
    Z: FloatArray
    iterations: int
    converged: bool
    cost: float
    step: float


@dataclass(frozen=True, slots=True)
class Structured:
    """Physical parameters read from an uncertainty matrix.

    Attributes:
        delta: (q,) change of each parameter; NaN where the batch says nothing.
        sd: (q,) standard deviation that the regression's own residual gives; inf where it says nothing.
        dof: degrees of freedom of that residual.
    """

    delta: FloatArray
    sd: FloatArray
    dof: float


def observe(model: StateSpace, gain: FloatArray, y: FloatArray, u: FloatArray, x0: FloatArray) -> FloatArray:
    """Run the observer (2) from x0 (n,) over y (N, p), u (N, m); return its states (N+1, n), the first x0."""
    Phi = model.A - gain @ model.C
    driven = y @ gain.T + u @ (model.B - gain @ model.D).T
    states = np.empty((len(y) + 1, model.n))
    states[0] = x = x0
    for k, push in enumerate(driven):
        states[k + 1] = x = Phi @ x + push
    return states


def state_batch(model: StateSpace, x: FloatArray, u: FloatArray) -> Batch:
    """Return the batch of dA: observer states x (N+1, n) against b of (10), u (N, m)."""
    return Batch(x[:-1], x[1:] - x[:-1] @ model.A.T - u @ model.B.T)


def output_batch(model: StateSpace, x: FloatArray, y: FloatArray, u: FloatArray) -> Batch:
    """Return the batch of dC: states x (N, n) against y - C0 x - D u, y (N, p), u (N, m)."""
    return Batch(x, y - x @ model.C.T - u @ model.D.T)


def general_solution(batch: Batch, rank: int | None = None) -> GeneralSolution:
    """Return (13) on a batch with the pseudo-inverse cut to `rank` directions (None: all non-empty)."""
    left, values, right = np.linalg.svd(batch.regressors, full_matrices=False)
    full = int(np.sum(values > RANK_TOLERANCE * values[0])) if values[0] > 0 else 0
    kept = full if rank is None else min(rank, full)
    base = (batch.targets.T @ left[:, :kept] / values[:kept]) @ right[:kept]
    n = batch.regressors.shape[1]
    # of the full rank nothing is left, not even round-off that descent would follow
    projector = np.eye(n) - right[:kept].T @ right[:kept] if kept < n else np.zeros((n, n))
    return GeneralSolution(base, projector, kept)


def existence(batch: Batch, tolerance: float = 1e-9) -> Existence:
    """Evaluate (11) and (12) on a batch; for one sample that is not zero both hold, whatever the target."""
    M = general_solution(batch).base
    size = float(np.linalg.norm(batch.targets))
    defect = float(np.linalg.norm(batch.error(M))) / size if size > 0 else 0.0
    joined = np.hstack([_unit(batch.regressors), _unit(batch.targets)])
    rank = int(np.linalg.matrix_rank(_unit(batch.regressors), tol=tolerance))
    return Existence(defect, rank, int(np.linalg.matrix_rank(joined, tol=tolerance)))


def _unit(matrix: FloatArray) -> FloatArray:
    norm = float(np.linalg.norm(matrix))
    return matrix / norm if norm > 0 else matrix


def special_case_defect(M: FloatArray, x: FloatArray) -> float:
    """Return ||M x x+ - M|| / ||M|| for one state x (n,): answer (14) may be used where (15) makes this 0."""
    square, size = float(x @ x), float(np.linalg.norm(M))
    if size == 0.0:
        return 0.0
    projected = np.outer(M @ x, x) / square if square > 0 else np.zeros_like(M)
    return float(np.linalg.norm(projected - M)) / size


def cost(batch: Batch, M: FloatArray) -> float:
    """Return (16): the sum of squares of t(k) - M r(k)."""
    return float(np.sum(batch.error(M) ** 2))


def descend(batch: Batch, solution: GeneralSolution, stopping: Stopping | None = None) -> Descent:
    """Minimise (16) over Z from Z = 0 by gradient descent with the steps (17).

    The first step, which the paper leaves open, is the reciprocal of the cost's largest curvature. (17) is
    the second of the steps in Barzilai & Borwein, IMA J. Numer. Anal. 8 (1988) 141; the cost need not fall at
    each of them.
    """
    rule = stopping or Stopping()
    Z = np.zeros_like(solution.base)
    M = solution.at(Z)
    gradient = _gradient(batch, solution, M)
    length = _first_step(batch, solution)
    iterations = 0
    size = float("inf") if length > 0 else 0.0
    value = cost(batch, M)
    while rule.goes_on(size, value, iterations):
        Z = Z - length * gradient
        M = solution.at(Z)
        before, gradient = gradient, _gradient(batch, solution, M)
        size, iterations = float(np.linalg.norm(length * before)), iterations + 1
        length, value = _borwein(-length * before, gradient - before), cost(batch, M)
    return Descent(M, Z, iterations, size <= rule.step or value <= rule.cost, value, size)


def _gradient(batch: Batch, solution: GeneralSolution, M: FloatArray) -> FloatArray:
    return -2.0 * (batch.error(M).T @ batch.regressors) @ solution.projector


def _first_step(batch: Batch, solution: GeneralSolution) -> float:
    curvature = 2.0 * float(np.linalg.norm(batch.regressors @ solution.projector, 2)) ** 2
    return 1.0 / curvature if curvature > 0 else 0.0


def _borwein(dZ: FloatArray, dg: FloatArray) -> float:
    """Return the step (17); 0 where the gradient has stopped to change."""
    square = float(np.sum(dg**2))
    return float(np.sum(dg * dZ)) / square if square > 0 else 0.0


def read_off(dA: FloatArray, mass: float, period_s: float) -> FloatArray:
    """Return (dk1, dk2, dB1, dB2) from row 1 of (24), for the paper's two masses and its Euler model (23)."""
    row = dA[0] * mass / period_s
    dk2, dB2 = row[3], row[1]
    return np.array([-row[2] - dk2, dk2, -row[0] - dB2, dB2])


def structured(batch: Batch, M: FloatArray, derivatives: FloatArray) -> Structured:
    """Return the parameters whose M is nearest to the given one over the batch, for any model.

    Args:
        batch: the samples; they weigh the entries of M by how far they moved the states.
        M: (d, n) what descent found.
        derivatives: (q, d, n) of M by each parameter.

    With the least-squares M this equals least squares of the targets on the parameters themselves.
    """
    count, d = batch.targets.shape
    columns = np.einsum("kn,qdn->kdq", batch.regressors, derivatives).reshape(count * d, -1)
    norms = np.linalg.norm(columns, axis=0)
    scale = np.where(norms > 0, 1.0 / np.where(norms > 0, norms, 1.0), 0.0)
    left, values, right = np.linalg.svd(columns * scale, full_matrices=False)
    dof = float(count * d - columns.shape[1])
    if not norms.all() or values[-1] <= RANK_TOLERANCE * values[0]:
        unknown = np.full(columns.shape[1], np.nan)
        return Structured(unknown, np.full(columns.shape[1], np.inf), dof)
    root = scale[:, None] * (right.T / values)
    delta = root @ (left.T @ (batch.regressors @ M.T).ravel())
    rest = batch.targets.ravel() - columns @ delta
    s2 = float(rest @ rest) / max(dof, 1.0)
    return Structured(delta, np.sqrt(s2 * np.sum(root**2, axis=1)), dof)
