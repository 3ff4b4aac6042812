"""Observer and sensitivities over whole windows of one length, about one theta_r: built once, run over many windows."""

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.impulses import Impulses, Runs, Written
from agent.numerics.model.observer import Gain
from agent.numerics.model.sensitivity import sensitivity_filter
from agent.numerics.model.statespace import StateSpace
from agent.numerics.preprocessing.bridge import Bridge
from agent.numerics.window.cells import cell_operators, propagate, run_cells

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
CELL = 32
"""Samples a cell: long enough for the matrix products, short enough that their triangular half is not wasted."""
WRITTEN = 2**24
"""Multiplications up to which it is cheaper to write the responses of unknown readings out than to run them."""


class WindowFilter:
    """The filters of a model and gain, lifted to windows of `samples` samples.

    Attributes:
        gain: of the observer.
        samples: W.
        system: the filters.
    """

    def __init__(self, model: StateSpace, gain: Gain, samples: int) -> None:
        self.gain = gain
        self.samples = samples
        self.system = sensitivity_filter(model, gain.L, gain.whitening)
        self._whole, self._rest = divmod(samples, CELL)
        lengths = [length for length in (CELL if self._whole else 0, self._rest) if length]
        self._operators = cell_operators(self.system, lengths)
        self._model = model

    def outputs(self, v: FloatArray, x0: FloatArray) -> FloatArray:
        """Return [e psi] (W p, 1+q) over a window v (W, p+m), the observer starting at x0 (n,)."""
        z = np.zeros(len(self.system.F))
        z[: self.system.n] = x0
        outputs, split = [], self._whole * CELL
        if self._whole:
            operator, inputs = self._operators[CELL], v[:split].reshape(self._whole, -1)
            states, z = propagate(z, operator.state_from_state, inputs @ operator.state_from_inputs)
            outputs.append(run_cells(operator, inputs, states).reshape(-1, 1 + self.system.q))
        if self._rest:
            operator, inputs = self._operators[self._rest], v[split:].reshape(1, -1)
            outputs.append(run_cells(operator, inputs, z[None]).reshape(-1, 1 + self.system.q))
        return np.vstack(outputs)

    @cached_property
    def G(self) -> FloatArray:  # noqa: N802 (the letter of the books)
        """What an unknown initial state does to [e psi], (W p, n(1+q)); not to be written to."""
        leverage, carried = [], np.eye(len(self.system.F))
        for length in (*[CELL] * self._whole, *([self._rest] if self._rest else [])):
            operator = self._operators[length]
            leverage.append(operator.G @ carried)
            carried = operator.Pi @ carried
        return np.vstack(leverage)

    def innovations(self, v: FloatArray, x0: FloatArray) -> FloatArray:
        """Return e (W p,) alone."""
        return self.runs.over(v, x0)

    @cached_property
    def initial(self) -> tuple[FloatArray, FloatArray]:
        """An orthonormal basis of Gamma, (W p, r), and what takes it to initial states, (n, r)."""
        return orthogonal(self.G[:, : self.system.n])

    def responses(self, unknown: Bridge, out: IntArray) -> Impulses | Written:
        """Return what unknown readings do to e, rows out (k,) left out."""
        if self.samples * self.system.p * len(unknown.sample) ** 2 > WRITTEN:
            return Impulses(self.runs, unknown, out, self.samples)
        return Written.of(self._impulse, unknown, out)

    @cached_property
    def _impulse(self) -> FloatArray:
        """The innovations (p+m, W, p) that follow a unit in each channel at sample 0."""
        channels = self.system.N.shape[1]
        units = np.zeros((channels, self.samples, channels))
        units[:, 0] = np.eye(channels)
        at_rest = np.zeros(self.system.n)
        return np.stack([self.runs.over(unit, at_rest).reshape(self.samples, -1) for unit in units])

    @cached_property
    def runs(self) -> Runs:
        """The observer without sensitivities."""
        return Runs.of(sensitivity_filter(without_parameters(self._model), self.gain.L, self.gain.whitening))


def without_parameters(model: StateSpace) -> StateSpace:
    """Return a model without its derivatives."""
    return replace(model, dA=model.dA[:0], dB=model.dB[:0], dC=model.dC[:0], dD=model.dD[:0])


def orthogonal(Gamma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an orthonormal basis (N, r) of the columns of Gamma (N, n), scaled first, and `back` (n, r).

    The pseudo-inverse of Gamma is back basis'.
    """
    norms = np.linalg.norm(Gamma, axis=0)
    scale = np.where(norms > 0, 1.0 / np.where(norms > 0, norms, 1.0), 0.0)
    left, values, right = np.linalg.svd(Gamma * scale, full_matrices=False)
    kept = values > 1e-12 * values[0]
    left, values, right = left[:, kept], values[kept], right[kept]
    return left, scale[:, None] * (right.T / values)
