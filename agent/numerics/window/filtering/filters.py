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
from itertools import accumulate

import numpy as np

from agent.numerics.model.riccati import Predictor
from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.filtering.course import Course, powers_of
from agent.numerics.window.filtering.hops import HopPlan, divide
from agent.numerics.window.filtering.noise import Realisation
from agent.numerics.window.filtering.products import row_products
from agent.numerics.window.filtering.transition import Transition
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
        """States of all filters: r, x̂, t_1 .. t_c."""
        return self.a + self.n + self.c * self.a


@dataclass(frozen=True, slots=True)
class System:
    """All filters as one system of z = (r, x̂, t_1 .. t_c) and v = (y, u).

    Attributes:
        step: z -> z after a sample.
        N: (nz, p+m), v -> z after.
        H, J: (1+c, p, nz), (1+c, p, p+m) to e, ψ_1 .. ψ_c.
        size: dimensions.
    """

    step: Transition
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
    from_mean = np.zeros((c, a, n))
    N = np.zeros((dims.z, p + m))
    N[:n, p:] = model.B
    N[n : n + a] = np.hstack([K, _padded(model.B, a) - K @ model.D])
    H = np.zeros((1 + c, p, dims.z))
    J = np.zeros((1 + c, p, p + m))
    H[0, :, n : n + a], J[0] = -W @ C, W @ np.hstack([np.eye(p), -model.D])
    for i in range(c):
        own = slice(a + n + i * a, a + n + (i + 1) * a)
        from_mean[i] = _padded(model.dA[i], a) - K @ model.dC[i]
        N[own, p:] = _padded(model.dB[i], a) - K @ model.dD[i]
        H[1 + i, :, own], H[1 + i, :, :n] = W @ C, W @ model.dC[i]
        J[1 + i, :, p:] = W @ model.dD[i]
    return System(Transition(Phi, model.A, from_mean), N, H, J, dims)


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
        into_mean: (L m, nz), u -> (r, 0, t) after.
        along: (a, a), x̂ -> x̂ after, and each tᵢ -> itself.
        from_mean: (n, nz), r -> (r, 0, t) after.
        size: dimensions.
    """

    length: int
    innovation: FloatArray
    mean: FloatArray
    tangent: FloatArray
    into_predictor: FloatArray
    into_mean: FloatArray
    along: FloatArray
    from_mean: FloatArray
    size: Sizes

    def forced(self, v: FloatArray) -> FloatArray:
        """Return the states (N, nz) that inputs v (N, L, p+m) leave when started from zero."""
        a, n = self.size.a, self.size.n
        count = len(v)
        out = row_products(v[:, :, self.size.p :].reshape(count, -1), self.into_mean)
        out[:, n : n + a] = row_products(v.reshape(count, -1), self.into_predictor)
        return out

    def carried(self, z: FloatArray) -> FloatArray:
        """Return the states (N, nz) after cells with no inputs, from states z (N, nz)."""
        a, n = self.size.a, self.size.n
        out = row_products(z[:, :n], self.from_mean)
        out[:, n:] += row_products(z[:, n:].reshape(-1, a), self.along).reshape(len(z), -1)
        return out

    def write(self, v: FloatArray, z: FloatArray, out: FloatArray) -> None:
        """Write e, ψ of N cells with inputs v (N, L, p+m) from states z (N, nz) into out (N, 1+c, L p)."""
        a, n = self.size.a, self.size.n
        count = len(v)
        out[:, 0] = row_products(_beside(v, z[:, n : n + a]), self.innovation)
        driven = row_products(_beside(v[:, :, self.size.p :], z[:, :n]), self.mean)
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
        self._over_hops = powers_of(system.step.power(plan.hop))

    def __reduce__(self) -> tuple[type["Filters"], tuple[System, HopPlan]]:
        """Return what they are made of: the rest is a megabyte, in each state of a rig that is remembered."""
        return Filters, self._made_of

    def over(self, v: FloatArray, course: Course) -> tuple[list[FloatArray], Course]:
        """Run over N units of rest and head, v (N, H, p+m).

        Returns:
            states (N, nz) before each cell of the units, the course after.
        """
        lengths = (*self.rest, *self.head)
        forced = self._forced(lengths, v)
        gained = forced[0]
        for length, one in zip(lengths[1:], forced[1:], strict=True):
            gained = self._cells[length].carried(gained) + one
        states, course = course.over(self._over_hops, gained)
        return self._carried(lengths[:-1], states, forced[:-1]), course

    def through(self, lengths: Sequence[int], v: FloatArray, z: FloatArray) -> list[FloatArray]:
        """Return states (N, nz) before each cell of stretches v (N, L, p+m) from z on, and after the last."""
        return self._carried(lengths, z, self._forced(lengths, v))

    def _carried(
        self, lengths: Sequence[int], z: FloatArray, forced: Sequence[FloatArray]
    ) -> list[FloatArray]:
        states = [z]
        for length, gained in zip(lengths, forced, strict=True):
            states.append(self._cells[length].carried(states[-1]) + gained)
        return states

    def _forced(self, lengths: Sequence[int], v: FloatArray) -> list[FloatArray]:
        """Return the states (N, nz) that inputs of each cell of stretches v (N, L, p+m) leave from zero."""
        starts = accumulate(lengths, initial=0)
        return [self._cells[L].forced(v[:, s : s + L]) for L, s in zip(lengths, starts, strict=False)]

    def outputs(self, lengths: Sequence[int], v: FloatArray, states: Sequence[FloatArray]) -> FloatArray:
        """Return e, ψ (N, 1+c, samples p) of N stretches v, from the states before each of their cells."""
        p = self.size.p
        out = np.empty((len(v), 1 + self.size.c, v.shape[1] * p))
        start = 0
        for length, z in zip(lengths, states, strict=False):
            stop = start + length
            self._cells[length].write(v[:, start:stop], z, out[:, :, start * p : stop * p])
            start = stop
        return out


def lifted(system: System, lengths: Sequence[int]) -> dict[int, Cell]:
    """Lift the filters to each of the lengths, all cut from the longest."""
    longest = max(lengths)
    step, size = system.step, system.size
    a, n = size.a, size.n
    free = step.responses(system.H[1, :, a + n : a + n + a], system.H[1:, :, :n], longest)
    forced = _forced(step.whole(), system.N, longest)
    later = (system.H.reshape(-1, size.z) @ forced[: longest - 1]).reshape(-1, *system.J.shape)
    markov = np.concatenate([system.J[None], later])
    impulse = np.zeros((*system.J.shape[:1], longest, size.p, longest, system.J.shape[-1]))
    for k in range(longest):
        impulse[:, k, :, : k + 1] = markov[k::-1].transpose(1, 2, 0, 3)
    return {L: _cell(size, step.power(L), free, forced[:L], impulse) for L in sorted(set(lengths))}


def _forced(F: FloatArray, N: FloatArray, count: int) -> FloatArray:
    """Return N (nz, k), F N, F² N, .. as (count, nz, k); one by one, as k is far less than nz."""
    out = np.empty((count, *N.shape))
    for each in out:
        each[:] = N
        N = F @ N
    return out


def _cell(
    size: Sizes,
    over: Transition,
    free: tuple[FloatArray, FloatArray],
    forced: FloatArray,
    impulse: FloatArray,
) -> Cell:
    """Cut a cell from what is lifted to at least its length.

    free: Γ (.., p, a), D (.., p, c, n);  forced (L, nz, p+m): states after an input so many samples ago.
    """
    a, n, c = size.a, size.n, size.c
    L = len(forced)
    T = impulse[:, :L, :, :L]
    rows = L * size.p
    tangent = free[0][:L].reshape(rows, a).T
    innovation = np.vstack([T[0].reshape(rows, -1).T, -tangent])
    from_mean = free[1][:L].transpose(2, 0, 1, 3).reshape(c * rows, n).T
    after = forced[::-1]
    into_mean = after[:, :, size.p :].transpose(0, 2, 1).reshape(L * size.m, -1).copy()
    into_mean[:, n : n + a] = 0.0
    return Cell(
        L, innovation, np.vstack([T[1:, ..., size.p :].reshape(c * rows, -1).T, from_mean]),
        np.ascontiguousarray(tangent),
        np.ascontiguousarray(after[:, n : n + a].transpose(0, 2, 1).reshape(-1, a)),
        into_mean,
        np.ascontiguousarray(over.predictor.T),
        np.hstack([over.mean.T, np.zeros((n, a)), over.from_mean.reshape(-1, n).T]), size,
    )  # fmt: skip


def _padded(matrix: FloatArray, rows: int) -> FloatArray:
    """Return a matrix with zero rows for the noise states."""
    return np.vstack([matrix, np.zeros((rows - len(matrix), matrix.shape[1]))])
