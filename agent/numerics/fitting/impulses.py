"""What unknown readings do to a window: a matrix U (W p, c) that need not be written out.

Column i of U is what reading i, one unit off, does to the whitened innovations: nothing before its sample, its direct
share there, and after it the free response of the observer, -w C Phi^(k - t - 1) X. Of many unknowns over a long window
the dense matrix costs W p c^2 in products. Here one state a column is carried from one of their instants to the next:

    U_i' U_j = r_i(t_j)' J_j + z_i(t_j + 1)' Q X_j,   t_i <= t_j,   Q = sum of Phi'^s C'w'w C Phi^s over what follows

and products with U or its transpose are one run of the observer, or of its adjoint, over the window.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.sensitivity import SensitivityFilter
from agent.numerics.preprocessing.bridge import Bridge
from agent.numerics.window.cells import CellOperator, cell_operators, propagate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
CELL = 32
"""Samples a cell of the runs over a window."""


@dataclass(frozen=True, slots=True)
class Runs:
    """An observer without sensitivities, z' = F z + N v, e = H z + J v, and the same lifted to cells."""

    system: SensitivityFilter
    operator: CellOperator

    @classmethod
    def of(cls, system: SensitivityFilter) -> "Runs":
        """Lift an observer."""
        return cls(system, cell_operators(system, [CELL])[CELL])

    def over(self, v: FloatArray, x0: FloatArray) -> FloatArray:
        """Return the innovations e (W p,) over a window v (W, p+m), the observer starting at x0 (n,)."""
        cells = -(-len(v) // CELL)
        padded = np.zeros((cells * CELL, v.shape[1]))
        padded[: len(v)] = v
        inputs = padded.reshape(cells, -1)
        forced = inputs @ self.operator.state_from_inputs
        states, _ = propagate(x0, self.operator.state_from_state, forced)
        return self.operator.columns(inputs, states).reshape(-1)[: len(v) * self.system.p]


@dataclass(frozen=True, slots=True)
class Impulses:
    """The matrix U of unknown readings.

    Attributes:
        runs: the observer.
        unknown: the c readings, in order of their samples.
        out: (k,) rows of U that are left out, zero.
        samples: W.
    """

    runs: Runs
    unknown: Bridge
    out: IntArray
    samples: int

    def times(self, weights: FloatArray) -> FloatArray:
        """Return U weights (W p, k) for weights (c, k)."""
        system = self.runs.system
        v = np.zeros((weights.shape[1], self.samples, system.N.shape[1]))
        v[:, self.unknown.sample, self.unknown.channel] = weights.T
        result = np.stack([self.runs.over(column, np.zeros(system.n)) for column in v], axis=1)
        result[self.out] = 0.0
        return result

    def against(self, columns: FloatArray) -> FloatArray:
        """Return U' columns (c, k) for columns (W p, k)."""
        p = self.runs.system.p
        padded = np.zeros((columns.shape[1], self._cells * CELL * p))
        padded[:, : len(columns)] = columns.T
        padded[:, self.out] = 0.0
        return np.stack([self._adjoint(column) for column in padded.reshape(len(padded), -1, CELL * p)], 1)

    def _adjoint(self, e: FloatArray) -> FloatArray:
        """Return U' e (c,) by the adjoint of the cells, backwards, for e (cells, L p)."""
        operator, nz, p = self.runs.operator, self.runs.system.n, self.runs.system.p
        back = e @ operator.outputs.T
        readings, state = back[:, :-nz], back[:, -nz:]
        later, _ = propagate(np.zeros(nz), operator.state_from_state.T, state[::-1])
        after = later[::-1] @ operator.state_from_inputs.T
        v = after.reshape(len(e) * CELL, -1)
        if operator.direct is None:
            v += readings.reshape(v.shape)
        else:
            v[:, p:] += readings.reshape(len(v), -1)
            v[:, :p] += e.reshape(len(v), -1) @ operator.direct
        return np.asarray(v[self.unknown.sample, self.unknown.channel])

    def gram(self) -> FloatArray:
        """Return U'U (c, c)."""
        system, channel, count = self.runs.system, self.unknown.channel, len(self.unknown.sample)
        out = self.out // system.p
        instants = np.unique(np.concatenate([self.unknown.sample, out]))
        first, last = (np.searchsorted(self.unknown.sample, instants, side) for side in ("left", "right"))
        gaps = np.diff(np.append(instants, self.samples)) - 1
        over, seen = _powers(system, gaps)
        ahead = _ahead(system, over, seen)
        gram = np.zeros((count, count))
        left_out = np.zeros((len(self.out), count))
        z = np.zeros((system.n, 0))
        for i, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
            new = channel[a:b]
            response = np.hstack([system.H @ z, system.J[:, new]])
            z = np.hstack([system.F @ z, system.N[:, new]])
            gram[:b, a:b] = response.T @ response[:, a:] + z.T @ (ahead[i] @ z[:, a:])
            rows = np.flatnonzero(out == instants[i])
            left_out[rows, :b] = response[self.out[rows] % system.p]
            z = over[i] @ z
        gram = np.triu(gram) + np.triu(gram, 1).T
        return np.asarray(gram - left_out.T @ left_out)

    @property
    def _cells(self) -> int:
        return -(-self.samples // CELL)


@dataclass(frozen=True, slots=True)
class Written:
    """The matrix U of few unknown readings, written out.

    Attributes:
        unknown: the c readings.
        U: (W p, c).
    """

    unknown: Bridge
    U: FloatArray

    @classmethod
    def of(cls, impulse: FloatArray, unknown: Bridge, out: IntArray) -> "Written":
        """Write U out from the innovations impulse (p+m, W, p) that follow a unit in each channel at sample 0."""
        _, samples, p = impulse.shape
        rows = np.zeros((len(unknown.sample), samples, p))
        for row, sample, channel in zip(rows, unknown.sample.tolist(), unknown.channel.tolist(), strict=True):
            row[sample:] = impulse[channel, : samples - sample]
        U = rows.reshape(len(rows), -1).T
        U[out] = 0.0
        return cls(unknown, U)

    def times(self, weights: FloatArray) -> FloatArray:
        """Return U weights (W p, k) for weights (c, k)."""
        return np.asarray(self.U @ weights)

    def against(self, columns: FloatArray) -> FloatArray:
        """Return U' columns (c, k) for columns (W p, k)."""
        return np.asarray(self.U.T @ columns)

    def gram(self) -> FloatArray:
        """Return U'U (c, c)."""
        return np.asarray(self.U.T @ self.U)


def _powers(system: SensitivityFilter, gaps: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return F^gap (N, n, n) and the sum over s < gap of F'^s H'H F^s, gaps (N,), by their binary digits."""
    n = system.n
    over, seen = np.tile(np.eye(n), (len(gaps), 1, 1)), np.zeros((len(gaps), n, n))
    power, total = system.F, system.H.T @ system.H
    for digit in range(int(gaps.max(initial=0)).bit_length()):
        taken = (gaps >> digit & 1).astype(bool)
        seen[taken] = total + power.T @ seen[taken] @ power
        over[taken] = over[taken] @ power
        total, power = total + power.T @ total @ power, power @ power
    return over, seen


def _ahead(system: SensitivityFilter, over: FloatArray, seen: FloatArray) -> FloatArray:
    """Return, for each instant, the sum of F'^s H'H F^s over all samples after it (N, n, n)."""
    ahead = np.zeros_like(seen)
    before = np.zeros((system.n, system.n))
    step = system.H.T @ system.H
    for i in range(len(seen) - 1, -1, -1):
        ahead[i] = seen[i] + over[i].T @ before @ over[i]
        before = step + system.F.T @ ahead[i] @ system.F
    return ahead
