"""The sensitivity filters run over blocks of samples ("cells"), and what a cell leaves behind.

A cell of L samples is two matrix products: o = O z + T v, z' = F^L z + R v. Of its outputs [e, psi] only two summaries
are kept, which adjacent cells merge associatively:

    gram = [e psi]'[e psi]          moment = G'[e psi],  G = [Gamma, d_1 Gamma .. d_q Gamma],  Gamma_k = C Phi^k

G is what an unknown initial state of the observer does to e and psi; G(k + L) = G(k) Pi_L.

Where the observer does not correct (gain 0), readings enter e at their own sample only: their half of T is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.sensitivity import SensitivityFilter
from agent.numerics.window.products import column_products, row_products

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CellOperator:
    """The filters lifted to a cell of `length` samples.

    Attributes:
        length: samples, L.
        outputs: (L(p+m) + nz, L p (1+q)): [v, z] @ outputs gives o, ordered (e, psi_1 .. psi_q), sample, output;
            (L m + nz, ..) where readings only enter e, through `direct`.
        direct: (p, p) e += direct y at the same sample; None where readings are among the inputs of `outputs`.
        state_from_inputs: (L(p+m), nz).
        state_from_state: (nz, nz), F^L.
        G: (L p, nz).
        Pi: (nz, nz).
        n, p, q: states, outputs, parameters.
    """

    length: int
    outputs: FloatArray
    state_from_inputs: FloatArray
    state_from_state: FloatArray
    G: FloatArray
    Pi: FloatArray
    n: int
    p: int
    q: int
    direct: FloatArray | None = None

    def after(self, v: FloatArray, z: FloatArray) -> FloatArray:
        """Return the states (N, nz) that cells with inputs v (N, L(p+m)) leave when started from z (N, nz)."""
        return row_products(z, self.state_from_state.T) + row_products(v, self.state_from_inputs)

    def columns(self, v: FloatArray, z: FloatArray) -> FloatArray:
        """Return (e, psi_1 .. psi_q) of N cells, (N, 1+q, L p), with inputs v (N, L(p+m)) from states z (N, nz)."""
        count = len(v)
        if self.direct is None:
            return row_products(np.hstack([v, z]), self.outputs).reshape(count, 1 + self.q, -1)
        y, u = np.split(v.reshape(count, self.length, -1), [self.p], axis=2)
        o = row_products(np.hstack([u.reshape(count, -1), z]), self.outputs).reshape(count, 1 + self.q, -1)
        o[:, 0] += (y @ self.direct.T).reshape(count, -1)
        return o


@dataclass(frozen=True, slots=True)
class Summary:
    """What is kept of N stretches of equal length.

    Attributes:
        gram: (N, 1+q, 1+q).
        moment: (nz, N, 1+q).
        Pi: (nz, nz) carries G over one stretch.
        GG: (nz, nz) G'G over one stretch.
    """

    gram: FloatArray
    moment: FloatArray
    Pi: FloatArray
    GG: FloatArray

    def __len__(self) -> int:
        return len(self.gram)

    def part(self, which: slice) -> "Summary":
        """Return some of the stretches."""
        return Summary(self.gram[which], self.moment[:, which], self.Pi, self.GG)


def cell_operators(system: SensitivityFilter, lengths: Sequence[int]) -> dict[int, CellOperator]:
    """Lift the filters to each of the lengths (all cut from the longest)."""
    longest = max(lengths)
    nz, width = system.N.shape
    rows = len(system.H)
    free = np.empty((longest + 1, rows, nz))  # H F^k
    forced = np.empty((longest, nz, width))  # F^k N
    power = np.eye(nz)
    for k in range(longest):
        free[k] = system.H @ power
        forced[k] = power @ system.N
        power = system.F @ power
    markov = np.concatenate([system.J[None], np.einsum("rz,kzw->krw", system.H, forced[: longest - 1])])
    T = np.zeros((longest, rows, longest, width))
    for k in range(longest):
        T[k, :, : k + 1] = markov[k::-1].transpose(1, 0, 2)
    return {L: _cut(system, L, free, forced, T) for L in sorted(set(lengths))}


def _cut(system: SensitivityFilter, L: int, free: FloatArray, forced: FloatArray, T: FloatArray) -> CellOperator:
    n, p, q = system.n, system.p, system.q
    rows, (nz, width) = p * (1 + q), system.N.shape
    O = free[:L].reshape(L * rows, nz)  # noqa: E741 (the letter of the books)
    quiet = not system.N[:, :p].any()
    T = T[:L, :, :L, p if quiet else 0 :].reshape(L * rows, -1)
    outputs = np.hstack([T, O]).reshape(L * p, 1 + q, -1).swapaxes(0, 1).reshape(L * rows, -1).T
    direct = np.ascontiguousarray(system.J.reshape(p, 1 + q, width)[:, 0, :p]) if quiet else None
    from_inputs = forced[:L][::-1].transpose(0, 2, 1).reshape(L * width, nz)
    # e answers the initial state with -Gamma, psi_i with +d_i Gamma: the first n columns of H F^k, signs mended
    initial = free[:L, :, :n].reshape(L * p, 1 + q, n).copy()
    initial[:, 0] *= -1.0
    state_power = np.linalg.matrix_power(system.F, L)
    return CellOperator(
        L, np.ascontiguousarray(outputs), np.ascontiguousarray(from_inputs), state_power,
        initial.reshape(L * p, nz), _transition(state_power, n, q), n, p, q, direct,
    )  # fmt: skip


def _transition(state_power: FloatArray, n: int, q: int) -> FloatArray:
    """Pi = [[Phi^L, S_1 .. S_q], [0, blockdiag(Phi^L)]], S_i the (s_i <- x) block of F^L."""
    Phi = state_power[:n, :n]
    Pi = np.asarray(np.kron(np.eye(1 + q), Phi), dtype=np.float64)
    for i in range(1, 1 + q):
        Pi[:n, n * i : n * (i + 1)] = state_power[n * i : n * (i + 1), :n]
    return Pi


def run_cells(operator: CellOperator, v: FloatArray, z: FloatArray) -> FloatArray:
    """Return the outputs (N, L p, 1+q) of N cells with inputs v (N, L(p+m)) and initial states z (N, nz)."""
    return np.ascontiguousarray(operator.columns(v, z).transpose(0, 2, 1))


def summarise_cells(operator: CellOperator, v: FloatArray, z: FloatArray) -> Summary:
    """Return the summary of N cells with inputs v (N, L(p+m)) and initial states z (N, nz)."""
    o = operator.columns(v, z)
    count, width, size = o.shape
    moment = row_products(o.reshape(count * width, size), operator.G).reshape(count, width, -1)
    gram = np.matmul(o, o.transpose(0, 2, 1))
    return Summary(gram, np.ascontiguousarray(moment.transpose(2, 0, 1)), operator.Pi, operator.G.T @ operator.G)


def merge(first: Summary, second: Summary) -> Summary:
    """Return the summaries of N stretches, each `first` followed at once by `second`."""
    count, width = first.gram.shape[:2]
    carried = column_products(first.Pi.T, second.moment.reshape(-1, count * width)).reshape(-1, count, width)
    return Summary(
        first.gram + second.gram,
        first.moment + carried,
        first.Pi @ second.Pi,
        first.GG + first.Pi.T @ second.GG @ first.Pi,
    )


def joined(first: Summary, second: Summary) -> Summary:
    """Append stretches in time, all of equal length."""
    gram = np.concatenate([first.gram, second.gram])
    return Summary(gram, np.concatenate([first.moment, second.moment], axis=1), second.Pi, second.GG)


def repeated(stretch: Summary, count: int) -> Summary:
    """Return Pi and GG of `count` stretches on end, without data."""
    power = Summary(np.zeros_like(stretch.gram[:1]), np.zeros_like(stretch.moment[:, :1]), stretch.Pi, stretch.GG)
    total: Summary | None = None
    while True:
        if count & 1:
            total = power if total is None else merge(total, power)
        count >>= 1
        if not count:
            return total if total is not None else power
        power = merge(power, power)


def sliding(hops: Summary, count: int) -> Summary:
    """Return the summaries of every `count` consecutive stretches, N - count + 1 of them, by doubling.

    Summaries merge associatively and are never subtracted, so the cost is one product a level and log2(count) levels
    (cf. Tangwongsan et al., General incremental sliding-window aggregation, VLDB 2015).
    """
    total: Summary | None = None
    power, remaining, taken = hops, count, 0
    while True:
        if remaining & 1:
            usable = len(hops) - count + 1
            piece = power.part(slice(taken, taken + usable))
            total = piece if total is None else merge(total, piece)
            taken += count_of(power, hops)
        remaining >>= 1
        if not remaining:
            return total if total is not None else power
        step = count_of(power, hops)
        power = merge(power.part(slice(0, len(power) - step)), power.part(slice(step, None)))


def count_of(power: Summary, hops: Summary) -> int:
    """Return how many stretches each entry of a doubled summary covers."""
    return len(hops) - len(power) + 1


def propagate(z: FloatArray, transition: FloatArray, forced: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve z(j+1) = transition z(j) + forced(j) over N steps; return all z(0..N-1), (N, nz), and z(N).

    Blocked: within blocks of about sqrt(N) steps all blocks advance together, then the blocks are joined.
    """
    count, nz = forced.shape
    block = max(1, int(np.sqrt(count)))
    blocks = count // block
    states = np.empty((count, nz))
    if blocks > 1:
        _propagate_blocks(z, transition, forced[: blocks * block].reshape(blocks, block, nz), states)
        z = transition @ states[blocks * block - 1] + forced[blocks * block - 1]
        start = blocks * block
    else:
        start = 0
    for j in range(start, count):
        states[j] = z
        z = transition @ z + forced[j]
    return states, z


def _propagate_blocks(z: FloatArray, transition: FloatArray, forced: FloatArray, states: FloatArray) -> None:
    """Fill states (at least blocks * block, nz) from z over forced (blocks, block, nz)."""
    blocks, block, nz = forced.shape
    local = np.zeros((block + 1, blocks, nz))
    for j in range(block):
        local[j + 1] = local[j] @ transition.T + forced[:, j]
    over_block = np.linalg.matrix_power(transition, block)
    starts = np.empty((blocks, nz))
    for b in range(blocks):
        starts[b] = z
        z = over_block @ z + local[block, b]
    out = states[: blocks * block].reshape(blocks, block, nz)
    carried = starts
    for j in range(block):
        out[:, j] = local[j] + carried
        carried = carried @ transition.T
