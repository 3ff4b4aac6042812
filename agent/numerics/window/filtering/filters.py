"""The bank's filters, lifted to sample cells: a predictor that whitens, a mean that nothing random reaches.

    predictor, with noise states      e  = W (y − C x̂ − D u)
                                      x̂' = Φ x̂ + (B − K D) u + K y,   Φ = A − K C
    mean: input and model only        r' = A r + B u
    sensitivities of the mean         ψᵢ = W (C tᵢ + dCᵢ r + dDᵢ u)
                                      tᵢ' = Φ tᵢ + (dAᵢ − K dCᵢ) r + (dBᵢ − K dDᵢ) u

W is the inverse root of the innovations' covariance. ψᵢ is the whitening filter applied to the derivative of
the mean output: no reading enters it, so what no data can separate stays unseparated. A cell of L samples is
a few matrix products: its outputs from its inputs and first states, and the states after it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.numerics.model.riccati import Predictor
from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.filtering.course import Course, powers_of
from agent.numerics.window.filtering.hops import HopPlan, divide
from agent.numerics.window.filtering.noise import Realisation
from agent.numerics.window.filtering.products import row_products
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Sizes:
    """n physical states, a states of the predictor, p outputs, m inputs, c columns."""

    n: int
    a: int
    p: int
    m: int
    c: int

    @property
    def z(self) -> int:
        """States of all filters: x̂, r, t_1 .. t_c."""
        return self.a + self.n + self.c * self.a


@dataclass(frozen=True, slots=True)
class System:
    """All filters as one system of z = (x̂, r, t_1 .. t_c) and v = (y, u).

    Attributes:
        F, N: (nz, nz), (nz, p+m).
        H, J: (1+c, p, nz), (1+c, p, p+m) to e, ψ_1 .. ψ_c.
        size: dimensions.
    """

    F: FloatArray
    N: FloatArray
    H: FloatArray
    J: FloatArray
    size: Sizes


def filter_system(model: StateSpace, real: Realisation, predictor: Predictor) -> System:
    """Return the filters of one model, one gain."""
    n, a, p, m, c = size = (model.n, real.filtered, model.p, model.m, model.q)
    K, C = predictor.K, real.C[:, :a]
    W = whitening(predictor)
    Phi = real.A[:a, :a] - K @ C
    dims = Sizes(*size)
    F = np.zeros((dims.z, dims.z))
    F[:a, :a], F[a : a + n, a : a + n] = Phi, model.A
    F[a + n :, a + n :] = np.kron(np.eye(c), Phi)
    N = np.zeros((dims.z, p + m))
    N[:a] = np.hstack([K, _padded(model.B, a) - K @ model.D])
    N[a : a + n, p:] = model.B
    H = np.zeros((1 + c, p, dims.z))
    J = np.zeros((1 + c, p, p + m))
    H[0, :, :a], J[0] = -W @ C, W @ np.hstack([np.eye(p), -model.D])
    for i in range(c):
        own = slice(a + n + i * a, a + n + (i + 1) * a)
        F[own, a : a + n] = _padded(model.dA[i], a) - K @ model.dC[i]
        N[own, p:] = _padded(model.dB[i], a) - K @ model.dD[i]
        H[1 + i, :, own], H[1 + i, :, a : a + n] = W @ C, W @ model.dC[i]
        J[1 + i, :, p:] = W @ model.dD[i]
    return System(F, N, H, J, dims)


def whitening(predictor: Predictor) -> FloatArray:
    """Return W (p, p), the inverse root of the innovations' covariance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(predictor.S)))


@dataclass(frozen=True, slots=True)
class Cell:
    """The filters lifted to `length` samples; outputs are ordered sample, channel.

    Attributes:
        innovation: (L(p+m) + a, L p), [v, x̂] -> e.
        mean: (L m + n, c L p), [u, r] -> ψ.
        tangent: (a, L p), tᵢ -> ψᵢ, the same for all i.
        into_predictor: (L(p+m), a), v -> x̂ after.
        into_mean: (L m, n + c a), u -> (r, t) after.
        transition: (nz, nz), transposed.
        size: dimensions.
    """

    length: int
    innovation: FloatArray
    mean: FloatArray
    tangent: FloatArray
    into_predictor: FloatArray
    into_mean: FloatArray
    transition: FloatArray
    size: Sizes

    def forced(self, v: FloatArray) -> FloatArray:
        """Return the states (N, nz) that inputs v (N, L, p+m) leave when started from zero."""
        a = self.size.a
        count = len(v)
        out = np.empty((count, self.size.z))
        out[:, :a] = row_products(v.reshape(count, -1), self.into_predictor)
        out[:, a:] = row_products(v[:, :, self.size.p :].reshape(count, -1), self.into_mean)
        return out

    def write(self, v: FloatArray, z: FloatArray, out: FloatArray) -> None:
        """Write e, ψ of N cells with inputs v (N, L, p+m) from states z (N, nz) into out (N, 1+c, L p)."""
        count = len(v)
        a = self.size.a
        n = self.size.n
        out[:, 0] = row_products(_beside(v, z[:, :a]), self.innovation)
        driven = row_products(_beside(v[:, :, self.size.p :], z[:, a : a + n]), self.mean)
        free = row_products(z[:, a + n :].reshape(count, -1, a), self.tangent)
        np.add(driven.reshape(free.shape), free, out=out[:, 1:])


def _beside(v: FloatArray, z: FloatArray) -> FloatArray:
    """Return the inputs of cells v (N, L, w) and states z (N, k) in rows (N, L w + k)."""
    count, length, width = v.shape
    rows = np.empty((count, length * width + z.shape[1]))
    rows[:, : length * width].reshape(v.shape)[:] = v
    rows[:, length * width :] = z
    return rows


class Filters:
    """The filters of a hop's head and rest, and their way from hop to hop."""

    def __init__(self, system: System, plan: HopPlan) -> None:
        self._made_of = system, plan
        self.size = system.size
        self.head, self.rest = divide(plan.head), divide(plan.rest)
        self._cells = lifted(system, (*self.head, *self.rest))
        self._over_hops = powers_of(np.linalg.matrix_power(system.F, plan.hop))

    def __reduce__(self) -> tuple[type["Filters"], tuple[System, HopPlan]]:
        """Return what they are made of: the rest is a megabyte, in each state of a rig that is remembered."""
        return Filters, self._made_of

    def over(self, v: FloatArray, course: Course) -> tuple[FloatArray, list[FloatArray], Course]:
        """Run over N units of rest and head, v (N, H, p+m).

        Returns:
            states (N, nz) before each unit, what each cell's inputs leave (N, nz), the course after.
        """
        lengths = (*self.rest, *self.head)
        forced = self.forced(lengths, v)
        gained = forced[0]
        for length, one in zip(lengths[1:], forced[1:], strict=True):
            gained = row_products(gained, self._cells[length].transition) + one
        states, course = course.over(self._over_hops, gained)
        return states, forced, course

    def forced(self, lengths: Sequence[int], v: FloatArray) -> list[FloatArray]:
        """Return the states (N, nz) that inputs of each cell of stretches v (N, L, p+m) leave from zero."""
        starts = np.cumsum([0, *lengths])
        return [self._cells[L].forced(v[:, s : s + L]) for L, s in zip(lengths, starts, strict=False)]

    def outputs(
        self, lengths: Sequence[int], v: FloatArray, z: FloatArray, forced: Sequence[FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Return e, ψ (N, 1+c, samples p) of N stretches v from states z (N, nz), and the states after."""
        p = self.size.p
        out = np.empty((len(v), 1 + self.size.c, v.shape[1] * p))
        start = 0
        for length, gained in zip(lengths, forced, strict=True):
            stop = start + length
            cell = self._cells[length]
            cell.write(v[:, start:stop], z, out[:, :, start * p : stop * p])
            z = row_products(z, cell.transition) + gained
            start = stop
        return out, z


def carried(first: FloatArray, step: FloatArray, count: int) -> FloatArray:
    """Return first (n, k), step first, step² first, .. as (count, n, k); step (n, n).

    Where k is far less than n, squaring the step would take longer than going on one by one.
    """
    out = np.empty((count, *first.shape))
    for each in out:
        each[:] = first
        first = step @ first
    return out


def lifted(system: System, lengths: Sequence[int]) -> dict[int, Cell]:
    """Lift the filters to each of the lengths, all cut from the longest."""
    longest = max(lengths)
    nz = system.size.z
    rows = system.H.reshape(-1, nz)
    free = carried(rows.T, system.F.T, longest).transpose(0, 2, 1).reshape(longest, *system.H.shape)  # H F^k
    forced = carried(system.N, system.F, longest)  # F^k N
    powers = {length: np.linalg.matrix_power(system.F, length) for length in set(lengths)}
    later = (rows @ forced[: longest - 1]).reshape(-1, *system.J.shape)
    markov = np.concatenate([system.J[None], later])
    impulse = np.zeros((*system.J.shape[:1], longest, system.size.p, longest, system.J.shape[-1]))
    for k in range(longest):
        impulse[:, k, :, : k + 1] = markov[k::-1].transpose(1, 2, 0, 3)
    return {L: _cell(system.size, powers[L], free[:L], forced[:L], impulse) for L in sorted(powers)}


def _cell(
    size: Sizes, transition: FloatArray, free: FloatArray, forced: FloatArray, impulse: FloatArray
) -> Cell:
    a, n, p, c = size.a, size.n, size.p, size.c
    L = len(free)
    T = impulse[:, :L, :, :L]
    rows = L * p
    innovation = np.vstack([T[0].reshape(rows, -1).T, free[:, 0, :, :a].reshape(rows, a).T])
    from_mean = free[:, 1:, :, a : a + n].transpose(1, 0, 2, 3).reshape(c * rows, n).T
    tangent = free[:, 1, :, a + n : 2 * a + n].reshape(rows, a).T
    after = forced[::-1]
    return Cell(
        L, innovation, np.vstack([T[1:, ..., p:].reshape(c * rows, -1).T, from_mean]),
        np.ascontiguousarray(tangent),
        np.ascontiguousarray(after[:, :a].transpose(0, 2, 1).reshape(-1, a)),
        np.ascontiguousarray(after[:, a:, p:].transpose(0, 2, 1).reshape(L * size.m, -1)),
        np.ascontiguousarray(transition.T), size,
    )  # fmt: skip


def _padded(matrix: FloatArray, rows: int) -> FloatArray:
    """Return a matrix with zero rows for the noise states."""
    return np.vstack([matrix, np.zeros((rows - len(matrix), matrix.shape[1]))])
