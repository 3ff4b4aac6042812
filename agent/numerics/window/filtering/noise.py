"""Noise of a rig as a state-space model: sensors, unknown forces, their colours, and lines.

    x(k+1) = A x + B u + B_f (f + Σ c_j),   y = C x + D u + D_f (f + Σ c_j) + s + l + v

v white sensor noise, f white force, c and s first-order Gauss-Markov (Ljung, System Identification, 1999,
section 4.3), l sinusoids of unknown amplitude and phase.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import block_diag

from agent.numerics.model.riccati import NoSteadyStateError, Predictor, spectral_radius, steady_predictor
from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.tuning import FORGOTTEN_SAMPLES, STABLE
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Push:
    """How forces in d directions enter: B (n, d) the shifted state, D (p, d) the outputs, both at once."""

    B: FloatArray
    D: FloatArray


@dataclass(frozen=True, slots=True)
class Coloured:
    """A first-order Gauss-Markov force or sensor error of stationary `sd`.

    Its spectrum is sd² (1 − a²)/|1 − a/z|² with a = pole.
    """

    side: Literal["force", "sensor"]
    number: int
    pole: float
    sd: float


@dataclass(frozen=True, slots=True)
class Line:
    """A sinusoid of unknown amplitude and phase on one output, new in each window."""

    channel: int
    radians_per_sample: float


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of a rig.

    Attributes:
        sigma: (p,) sd of each sensor's white noise, positive.
        force: (d,) sd of a white force in each direction, held over a sample like the measured one.
        coloured: Gauss-Markov forces and sensor errors.
        lines: sinusoids on outputs.
    """

    sigma: FloatArray
    force: FloatArray
    coloured: tuple[Coloured, ...] = ()
    lines: tuple[Line, ...] = ()


@dataclass(frozen=True, slots=True)
class Realisation:
    """The model with its noise states: n physical, then coloured, then two for each line.

    Attributes:
        A, C: (n_a, n_a), (p, n_a).
        Q, R, S: (n_a, n_a), (p, p), (n_a, p) covariance of process and measurement noise and between them.
        prior_var: (n_a,) variance of each state at a window's start: inf where nothing is known of it.
        n, coloured: number of physical and of coloured states.
    """

    A: FloatArray
    C: FloatArray
    Q: FloatArray
    R: FloatArray
    S: FloatArray
    prior_var: FloatArray
    n: int
    coloured: int

    @property
    def filtered(self) -> int:
        """Number of states that the predictor follows: all but the lines', whose gain is 0 in the limit."""
        return self.n + self.coloured


def realise(model: StateSpace, push: Push, noise: NoiseModel) -> Realisation:
    """Return the model augmented by the states of its noise."""
    poles = np.array([c.pole for c in noise.coloured])
    sds = np.array([c.sd for c in noise.coloured])
    enters = [_enters(c, push, model.p) for c in noise.coloured]
    into_x = np.stack([e[0] for e in enters], 1) if enters else np.zeros((model.n, 0))
    into_y = np.stack([e[1] for e in enters], 1) if enters else np.zeros((model.p, 0))
    rotations = [_rotation(line.radians_per_sample) for line in noise.lines]
    A = block_diag(model.A, np.diag(poles), *rotations)
    A[: model.n, model.n : model.n + len(poles)] = into_x
    C = np.hstack([model.C, into_y, *(_seen(line, model.p) for line in noise.lines)])
    Bf, Df = push.B * noise.force, push.D * noise.force
    Q = block_diag(
        Bf @ Bf.T, np.diag(sds**2 * (1 - poles**2)), np.zeros((2 * len(rotations), 2 * len(rotations)))
    )
    S = np.zeros((len(A), model.p))
    S[: model.n] = Bf @ Df.T
    prior = np.concatenate([np.full(model.n, np.inf), sds**2, np.full(2 * len(rotations), np.inf)])
    return Realisation(A, C, Q, np.diag(noise.sigma**2) + Df @ Df.T, S, prior, model.n, len(poles))


def predictor_of(model: StateSpace, push: Push, noise: NoiseModel) -> tuple[Realisation, Predictor]:
    """Return the augmented model and its steady-state predictor over the physical and coloured states.

    Without process noise a model that decays needs no gain; one that does not gets the smallest force that is
    assumed.

    Raises:
        ValueError: a sensor has no noise at all, or coloured noise no stationary sd.
        NoSteadyStateError: the model has a state that no force moves and that does not decay.
    """
    if not np.all(noise.sigma > 0):
        raise ValueError(f"sensor noise {noise.sigma} must be positive")
    if any(abs(c.pole) >= 1 for c in noise.coloured):
        raise ValueError(
            f"the poles of coloured noise {[c.pole for c in noise.coloured]} must be within (-1, 1)"
        )
    real = realise(model, push, noise)
    k = real.filtered
    if not real.Q.any() and spectral_radius(model.A) < 1 - STABLE:
        return real, Predictor(np.zeros((k, model.p)), real.R, np.zeros((k, k)))
    try:
        return real, _steady(real)
    except NoSteadyStateError:
        floor = smallest_force(model, push, noise.sigma)
        pushed = NoiseModel(noise.sigma, np.hypot(noise.force, floor), noise.coloured, noise.lines)
        real = realise(model, push, pushed)
        return real, _steady(real)


def smallest_force(model: StateSpace, push: Push, sigma: FloatArray) -> FloatArray:
    """Return the sd (d,) of white forces, each of which alone moves no output by more than its sensor's sd.

    That is over FORGOTTEN_SAMPLES; one output moves by just as much.
    """
    covariances = np.stack([_pushed(model.A, b) for b in push.B.T])
    spread = np.sqrt(np.einsum("pi,dij,pj->dp", model.C, covariances, model.C)) / sigma
    return np.asarray(1 / spread.max(axis=1))


def _pushed(A: FloatArray, b: FloatArray) -> FloatArray:
    """Return Σ Aᵏ b b' A'ᵏ over FORGOTTEN_SAMPLES, by doubling."""
    total = np.outer(b, b)
    power = A
    for _ in range(FORGOTTEN_SAMPLES.bit_length() - 1):
        total, power = total + power @ total @ power.T, power @ power
    return total


def _steady(real: Realisation) -> Predictor:
    k = real.filtered
    return steady_predictor(real.A[:k, :k], real.C[:, :k], real.Q[:k, :k], real.R, real.S[:k])


def _enters(noise: Coloured, push: Push, p: int) -> tuple[FloatArray, FloatArray]:
    """Return how a noise state enters the physical states (n,) and the outputs (p,)."""
    if noise.side == "force":
        return push.B[:, noise.number], push.D[:, noise.number]
    return np.zeros(len(push.B)), np.eye(p)[noise.number]


def _rotation(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def _seen(line: Line, p: int) -> FloatArray:
    """Return the (p, 2) output of a line's states, its cosine part."""
    return np.outer(np.eye(p)[line.channel], [1.0, 0.0])
