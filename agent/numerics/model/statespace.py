"""State-space models with their derivatives by every parameter, and exact discretisation of both.

A model is anything with `parameters`, `nominal` and `continuous(theta)`; `discretise` turns what it returns
into the sampled model that observer and estimator use.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from scipy.linalg import expm

from agent.numerics.model.tuning import BLOCK, GONE
from agent.types import ComplexArray, FloatArray

Hold = Literal["first", "zero", "euler", "cubic", "quintic"]


@dataclass(frozen=True, slots=True)
class StateSpace:
    """x' = A x + B u, y = C x + D u (x' the derivative or the next state) with derivatives by q parameters.

    Attributes:
        A, B, C, D: (n, n), (n, m), (p, n), (p, m).
        dA, dB, dC, dD: the same shapes with a leading axis of length q.
        is_sampled: A x + B u is the next state of a model that was given in discrete time.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    dA: FloatArray
    dB: FloatArray
    dC: FloatArray
    dD: FloatArray
    is_sampled: bool = False

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def p(self) -> int:
        """Number of outputs."""
        return len(self.C)

    @property
    def q(self) -> int:
        """Number of parameters."""
        return len(self.dA)

    def in_units(self, sizes: FloatArray) -> "StateSpace":
        """Return the same model of states x / sizes (n,)."""
        into, out = sizes[:, None], sizes
        return replace(
            self, A=self.A * out / into, B=self.B / into, C=self.C * out,
            dA=self.dA * out / into, dB=self.dB / into, dC=self.dC * out,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Discrete:
    """A sampled model in shifted-state form, see `discretise`.

    Attributes:
        model: xs(k+1) = A xs(k) + B u(k), y(k) = C xs(k) + D u(k).
        B1: (n, m) the shift: physical state x = xs + B1 u.
        dB1: (q, n, m) its derivatives.
        ramp: (n, m) state that an input rising from 0 to 1 in a straight line leaves after a sample, whatever
            the hold; half of B where the model was given in discrete time.
        d_ramp: (q, n, m) its derivatives.
        period_s: sampling period, s.
    """

    model: StateSpace
    B1: FloatArray
    dB1: FloatArray
    ramp: FloatArray
    d_ramp: FloatArray
    period_s: float


class Model(Protocol):
    """A parametric continuous-time model."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that theta holds."""
        ...

    @property
    def nominal(self) -> FloatArray:
        """(q,) nominal values."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """(n,) names of the states, for messages."""
        ...

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return the model at theta, shape (q,), in continuous time unless it says `is_sampled`."""
        ...


@dataclass(frozen=True, slots=True)
class AffineModel:
    """A model whose matrices are affine in its parameters (configuration kind "linear").

    Attributes:
        parameters: q names.
        nominal: (q,) values at which `at_nominal` holds.
        at_nominal: A, B, C, D and their constant derivatives.
        state_names: n names.
    """

    parameters: tuple[str, ...]
    nominal: FloatArray
    at_nominal: StateSpace
    state_names: tuple[str, ...]

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return the model at theta, shape (q,)."""
        change = np.asarray(theta, dtype=float) - self.nominal
        base = self.at_nominal

        def moved(matrix: FloatArray, derivative: FloatArray) -> FloatArray:
            return matrix + np.tensordot(change, derivative, axes=1)

        return StateSpace(
            moved(base.A, base.dA), moved(base.B, base.dB), moved(base.C, base.dC), moved(base.D, base.dD),
            base.dA, base.dB, base.dC, base.dD, base.is_sampled,
        )  # fmt: skip


def discretise(continuous: StateSpace, period_s: float, hold: Hold = "first") -> Discrete:
    """Sample a continuous model exactly, derivatives included.

    Between samples the input is a straight line ("first", for a measured force), a constant ("zero", for a
    commanded one); "euler" is the first-order approximation I + T A of the paper's (23), kept for its
    reproduction.

    With a straight line x(k+1) = A x(k) + B0 u(k) + B1 u(k+1); the shifted state xs = x - B1 u makes that
    causal: B = A B1 + B0, D = D_c + C B1. The matrices are blocks of one matrix exponential and their
    derivatives blocks of its Frechet derivative (Van Loan, IEEE Trans. Automatic Control 23 (1978) 395).

    Raises ValueError for polynomials through more readings, which no shift makes causal (see `holds.sample`).
    """
    if hold in ("cubic", "quintic"):
        raise ValueError(f'hold "{hold}" takes readings yet to come: use holds.sample')
    if continuous.is_sampled:
        return _unshifted(continuous, period_s)
    if hold == "euler":
        return _euler(continuous, period_s)
    A, dA, (G1, ramp), (dG1, d_ramp) = chained(continuous, period_s, 2)
    # a zero hold needs no shift
    B1 = ramp if hold == "first" else np.zeros_like(ramp)
    dB1 = d_ramp if hold == "first" else np.zeros_like(d_ramp)
    B0, dB0 = G1 - B1, dG1 - dB1
    C, dC = continuous.C, continuous.dC
    model = StateSpace(
        A=A, B=A @ B1 + B0, C=C, D=continuous.D + C @ B1,
        dA=dA, dB=dA @ B1 + A @ dB1 + dB0, dC=dC, dD=continuous.dD + dC @ B1 + C @ dB1,
    )  # fmt: skip
    return Discrete(model, B1, dB1, ramp, d_ramp, period_s)


def chained(
    continuous: StateSpace, period_s: float, length: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what a sample makes of the state and of the input's first derivatives at its start, in samples.

    A (n, n) and dA (q, n, n); what each of `length` derivatives, the input itself first, leads to at the
    sample's end, (length, n, m) and by every parameter (length, q, n, m).
    """
    n, m, q = continuous.n, continuous.m, continuous.q
    size = n + length * m
    generator, directions = np.zeros((size, size)), np.zeros((q, size, size))
    generator[:n, :n], directions[:, :n, :n] = continuous.A * period_s, continuous.dA * period_s
    generator[:n, n : n + m], directions[:, :n, n : n + m] = continuous.B * period_s, continuous.dB * period_s
    generator[n : size - m, n + m :] = np.eye(size - n - m)
    found, derivatives = _exponential_with_derivatives(generator, directions)
    G = found[:n, n:].reshape(n, length, m).transpose(1, 0, 2)
    dG = derivatives[:, :n, n:].reshape(q, n, length, m).transpose(2, 0, 1, 3)
    return found[:n, :n], derivatives[:, :n, :n], G, dG


def _exponential_with_derivatives(
    generator: FloatArray, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return exp(X) (s, s), and its derivatives along each direction (q, s, s), by exp([[X, E], [0, X]])."""
    size = len(generator)
    if not len(directions):
        return expm(generator), directions
    blocks = np.zeros((len(directions), 2 * size, 2 * size))
    blocks[:, :size, :size] = blocks[:, size:, size:] = generator
    blocks[:, :size, size:] = directions
    # one exponential a parameter: the scaling of each block form is its own, so nothing overflows
    results = expm(blocks)
    return results[0, :size, :size].copy(), results[:, :size, size:].copy()


def _euler(continuous: StateSpace, period_s: float) -> Discrete:
    model = StateSpace(
        A=np.eye(continuous.n) + period_s * continuous.A, B=period_s * continuous.B, C=continuous.C,
        D=continuous.D,
        dA=period_s * continuous.dA, dB=period_s * continuous.dB, dC=continuous.dC, dD=continuous.dD,
    )  # fmt: skip
    return _unshifted(model, period_s)


def _unshifted(model: StateSpace, period_s: float) -> Discrete:
    return Discrete(
        model, np.zeros_like(model.B), np.zeros_like(model.dB), 0.5 * model.B, 0.5 * model.dB, period_s
    )


def modes(model: StateSpace, period_s: float) -> ComplexArray:
    """Return continuous-time poles (n,), 1/s: of a discrete-time model those that sampling maps to its own.

    A mode that is gone after one sample (a pole at 0) decays as fast as can be written; one at -1 is at half
    the rate.
    """
    poles = np.linalg.eigvals(model.A).astype(np.complex128)
    if not model.is_sampled:
        return poles
    return np.asarray(np.log(np.where(np.abs(poles) < GONE, GONE, poles)) / period_s)


def simulate(discrete: Discrete, x0: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Run a sampled model from physical state x0 (n,) over u (N, m); return states (N, n) and outputs (N, p).

    Samples run in blocks from the first one on, each lifted to one product.
    """
    model = discrete.model
    count = len(u)
    free, forced = _lifted(model)
    blocks = np.zeros((-(-count // BLOCK), BLOCK * model.m))
    blocks.ravel()[: u.size] = u.ravel()
    pushed = blocks @ forced.T
    first = np.empty((len(blocks), model.n))
    ends = pushed[:, -model.n :]
    shifted = x0 - discrete.B1 @ u[0]
    for k, end in enumerate(ends):
        first[k] = shifted
        shifted = free[-model.n :] @ shifted + end
    # row j of a block is the state after its sample j; the first state of a block goes before it
    after = (first @ free.T + pushed).reshape(-1, BLOCK, model.n)
    states = np.concatenate([first[:, None], after[:, :-1]], axis=1).reshape(-1, model.n)[:count]
    return states + u @ discrete.B1.T, states @ model.C.T + u @ model.D.T


def _lifted(model: StateSpace) -> tuple[FloatArray, FloatArray]:
    """Return what makes the BLOCK states after a block's samples of its first state and of its inputs."""
    n, m = model.n, model.m
    free = np.empty((BLOCK, n, n))
    forced = np.zeros((BLOCK, n, BLOCK, m))
    power = np.eye(n)
    moved = model.B
    for lag in range(BLOCK):
        power, here = model.A @ power, np.arange(lag, BLOCK)
        free[lag], forced[here, :, here - lag] = power, moved
        moved = model.A @ moved
    return free.reshape(-1, n), forced.reshape(BLOCK * n, BLOCK * m)


def stacked(shape: tuple[int, ...], items: Sequence[FloatArray]) -> FloatArray:
    """Stack matrices along a new first axis; an empty sequence gives shape (0, *shape)."""
    return np.stack(items) if len(items) else np.zeros((0, *shape))
