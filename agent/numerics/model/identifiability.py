"""Whether parameters can be told apart at all, by the structure of a model and the places of its channels.

The test looks at one experiment in the Laplace domain, y(s) = C R (x0 + B U) + D U with R = (sI - A)^-1, at
points s on a ray between the axes (away from the poles), with inputs that differ at every point and an
initial state that nobody knows. Its Jacobian by the parameters, the initial state projected out, has the rank
of the Fisher information of a long window under rich excitation (Ljung, System Identification, 2nd ed. 1999,
sections 4.5 and 13.4), and every model costs the same few milliseconds whatever its time constants are.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from agent.numerics.model.observer import balanced
from agent.numerics.model.singular import singular
from agent.numerics.model.statespace import Model, StateSpace, modes
from agent.numerics.model.tuning import ANGLE, HALF_RATE, SILENT, TOLERANCE
from agent.types import ComplexArray, FloatArray

TINY = 1e-300  # fixed by double precision: what is less may not divide


@dataclass(frozen=True, slots=True)
class Identifiability:
    """What a model's readings tell of its parameters.

    Attributes:
        silent: numbers of the parameters that leave no trace.
        blends: (k, q) changes of several parameters that together leave no trace, in the parameters' units,
            each scaled so that its largest share of `scale` is 1.
    """

    silent: tuple[int, ...]
    blends: FloatArray


def identifiability(model: Model, measured: int, scale: FloatArray) -> Identifiability:
    """Judge a model at a point near nominal parameters; exactly at them a symmetry may hide what it shows.

    Args:
        model: its first `measured` inputs are signals, the others are constant.
        measured: number of inputs that are measured.
        scale: (q,) size of each parameter; 0 where it has none.
    """
    rng = np.random.default_rng(20)
    nearby = model.nominal * (1.0 + 0.02 * rng.uniform(0.5, 1.0, len(model.nominal)))
    return assess(model.continuous(nearby), measured, scale)


def assess(model: StateSpace, measured: int, scale: FloatArray) -> Identifiability:
    """Judge one continuous-time model; arguments as for `identifiability`."""
    if not model.q:
        return Identifiability((), np.zeros((0, 0)))
    jacobian, size = _jacobian(_balanced(model), measured)
    lengths = np.linalg.norm(jacobian, axis=0)
    received = lengths > SILENT * size
    silent = tuple(np.flatnonzero(~received).tolist())
    if not received.any():
        return Identifiability(silent, np.zeros((0, model.q)))
    _, values, vectors = singular(jacobian[:, received] / lengths[received])
    null = np.zeros((int(np.sum(values < TOLERANCE * values[0])), model.q))
    null[:, received] = vectors[len(values) - len(null) :] / lengths[received]
    return Identifiability(silent, readable_blends(null, scale, lengths))


def _balanced(model: StateSpace) -> StateSpace:
    """Return the model with states and time scaled so that rows and columns of A weigh alike."""
    A, T = balanced(model.A)
    similarity = T[None, :] / T[:, None]
    return StateSpace(
        A, model.B / T[:, None], model.C * T, model.D,
        model.dA * similarity, model.dB / T[:, None], model.dC * T, model.dD, model.is_sampled,
    )  # fmt: skip


def _points(model: StateSpace, count: int) -> ComplexArray:
    """Return s (count,) on the ray, from well below the slowest pole to well above the fastest.

    Of a model in discrete time the points are z = exp(s), s in units of a sample and below half the sampling
    rate.
    """
    speeds = np.abs(modes(model, 1.0))
    if model.is_sampled:
        ray = _ray(np.minimum(speeds, np.pi), count)
        return np.asarray(np.exp(ray * np.minimum(1.0, HALF_RATE / np.abs(ray).max())))
    return _ray(speeds, count)


def _ray(speeds: FloatArray, count: int) -> ComplexArray:
    speeds = speeds[speeds > 1e-9 * max(float(speeds.max(initial=0.0)), TINY)]
    slowest, fastest = (float(speeds.min()), float(speeds.max())) if len(speeds) else (1.0, 1.0)
    return np.asarray(np.geomspace(0.1 * slowest, 10 * fastest, count) * np.exp(1j * ANGLE))


def _jacobian(model: StateSpace, measured: int) -> tuple[FloatArray, FloatArray]:
    """Return d(readings)/d(theta) (rows, q), initial state projected out, and how large columns can be (q,).

    Rows (one an output and point, real parts before imaginary ones) are scaled to the state's part in them.
    """
    rng = np.random.default_rng(21)
    s = _points(model, 2 * (model.n + model.q) + 24)
    U = _inputs(model, measured, s, rng)
    R = np.linalg.inv(s[:, None, None] * np.eye(model.n) - model.A)
    CR = model.C @ R
    X = np.einsum("kij,kj->ki", R, rng.standard_normal(model.n) + U @ model.B.T)
    dx = np.einsum("qij,kj->kqi", model.dA, X) + np.einsum("qij,kj->kqi", model.dB, U)
    direct = np.einsum("qij,kj->kiq", model.dC, X) + np.einsum("qij,kj->kiq", model.dD, U)
    Y = np.einsum("kij,kqj->kiq", CR, dx) + direct
    could = np.linalg.norm(CR, axis=2)[:, :, None] * np.linalg.norm(dx, axis=2)[:, None, :] + np.abs(direct)
    weight = 1.0 / np.maximum(np.linalg.norm(CR, axis=2), TINY)[:, :, None]
    basis = np.linalg.qr(_unit(_stacked(CR * weight)))[0]
    rows = _stacked(Y * weight)
    rows = np.asarray(rows - basis @ (basis.T @ rows), dtype=np.float64)
    return rows, np.maximum(np.linalg.norm(_stacked(could * weight), axis=0), TINY)


def _inputs(model: StateSpace, measured: int, s: ComplexArray, rng: np.random.Generator) -> ComplexArray:
    """Return U (K, m): measured inputs differ by point, constant ones are steps; all push the state alike."""
    U = np.empty((len(s), model.m), dtype=complex)
    strength = np.maximum(np.linalg.norm(model.B[:, :measured], axis=0), TINY)
    drawn = rng.standard_normal((2, len(s), measured))
    U[:, :measured] = (drawn[0] + 1j * drawn[1]) / strength
    U[:, measured:] = (s / (s - 1.0) if model.is_sampled else 1.0 / s)[:, None]
    return U


def _stacked(values: ComplexArray | FloatArray) -> FloatArray:
    """Lay (K, p, columns) complex out as (2 K p, columns) real."""
    flat = values.reshape(-1, values.shape[-1])
    return np.vstack([flat.real, flat.imag])


def _unit(columns: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(columns, axis=0)
    return np.asarray(columns / np.where(lengths > 0, lengths, 1.0))


def readable_blends(null: FloatArray, scale: FloatArray, lengths: FloatArray) -> FloatArray:
    """Turn a basis of the null space (k, q) into one where each vector moves as few parameters as can be."""
    if not len(null):
        return null
    size = np.where(scale > 0, scale, 1.0 / np.maximum(lengths, TINY))
    shares = null / size
    _, _, order = qr(shares, pivoting=True)
    pivots = np.asarray(order)[: len(shares)]
    shares = np.asarray(np.linalg.solve(shares[:, pivots], shares), dtype=np.float64)
    shares = np.where(np.abs(shares) < 1e-4, 0.0, shares)
    return np.asarray(shares * size / np.abs(shares).max(axis=1, keepdims=True))
