"""Fisher information of a window and the Cramér-Rao bound: the least sd that any unbiased estimate can have.

White sensor noise of known standard deviation, an unknown initial state, known inputs (Ljung, System
Identification, 2nd ed. 1999, section 7.4). Constants of the rig enter with their data sheets as priors, which
makes it the bound of van Trees (Detection, Estimation and Modulation Theory I, 1968, section 2.4.3).
"""

from dataclasses import dataclass

import numpy as np

from agent.commissioning.tuning import SINGULAR
from agent.numerics.inference import tuning
from agent.numerics.inference.spectral.algebra import scales
from agent.numerics.model.singular import singular
from agent.numerics.model.statespace import Discrete
from agent.numerics.model.uncertain import Constant, Rig, Sampled, sampled
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class PredictedSd:
    """The sds to expect of a window's parameters.

    Attributes:
        sd: (q,) against nominal: the constants known as their data sheets say.
        sd_repeat: (q,) against another window of the same rig: the constants as they are.
        scatter: (q,) of the estimates of many such windows, each of which learns the constants by itself.
    """

    sd: FloatArray
    sd_repeat: FloatArray
    scatter: FloatArray


def window_information(discrete: Discrete, x0: FloatArray, u: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the Fisher information (q, q) of a window's parameters, the initial state projected out.

    Args:
        discrete: the sampled model at the true parameters.
        x0: (n,) the physical state at the window's first sample.
        u: (W, m) inputs.
        sigma: (p,) standard deviation of each output's noise.
    """
    m = discrete.model
    states = _run(m.A, (u @ m.B.T)[None], (x0 - discrete.B1 @ u[0])[None])[0]
    columns = _parameters(m.A, m.C, (m.dA, m.dB, m.dC, m.dD), states, u)
    return _information(columns, _free(m.A, m.C, len(u)), sigma)


def predicted_sd(rig: Rig, x0: FloatArray, u: FloatArray, sigma: FloatArray) -> PredictedSd:
    """Return a window's expected sds at nominal; x0 (n,) shifted state, u (W, m) measured inputs, in SI."""
    at = sampled(rig, rig.nominal, np.zeros(rig.masses))
    states = _run(at.A, (u @ at.B.T)[None], (x0 / rig.sizes)[None])[0]
    columns = _parameters(at.A, at.C, (at.dA, at.dB, at.dC, at.dD), states, u)
    sensors = [_sensor(rig, at, constant, states, u) for constant in rig.constants[rig.masses :]]
    whole = np.concatenate([columns, np.array(sensors).reshape(-1, *columns.shape[1:])])
    information = _information(whole, _free(at.A, at.C, len(u)), sigma)
    q = rig.q
    # what is so or not of a force is a hypothesis of its own, in no interval before data speak for it
    sheet = np.array([1e-9 if c.is_binary else max(c.sheet, 1e-9) for c in rig.constants])
    repeat = bound_sd(information[:q, :q])
    sd = np.hypot(repeat, _spread(information, q, sheet))
    return PredictedSd(at.unit * sd, at.unit * repeat, at.unit * _scatter(information, repeat, rig))


def _scatter(information: FloatArray, repeat: FloatArray, rig: Rig) -> FloatArray:
    """Return the sd (q,) of posterior means of windows of one rig: H⁻¹ I H⁻¹, where H = I + the prior's.

    Information is of (q + c, q + c). Of constants that it can measure the estimator believes the narrow prior
    while they are as configured; what windows say of them scatters, and moves the parameters with it.
    """
    if not rig.constants or not np.all(np.isfinite(repeat)):
        return repeat
    share = np.array([tuning.AS_CONFIGURED if constant.shows else 1.0 for constant in rig.constants])
    sheet = np.array([max(constant.sheet, 1e-9) for constant in rig.constants])
    H = information.copy()
    H[rig.q :, rig.q :] += np.diag((share * sheet) ** -2.0)
    d = scales(H)
    inverse = np.linalg.pinv(H * np.outer(d, d), rcond=SINGULAR, hermitian=True) * np.outer(d, d)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse @ information @ inverse)[: rig.q], repeat**2)))


def _spread(information: FloatArray, q: int, sheet: FloatArray) -> FloatArray:
    """Return the sd (q,) that constants known to `sheet` (c,) add; information (q + c, q + c)."""
    if not len(sheet):
        return np.zeros(q)
    d = scales(information[:q, :q])
    V = np.linalg.pinv(information[:q, :q] * np.outer(d, d), rcond=SINGULAR, hermitian=True) * np.outer(d, d)
    sensitivity = V @ information[:q, q:]
    own = information[q:, q:] - information[q:, :q] @ sensitivity
    # round-off may leave what the window does not tell of them slightly negative
    values, vectors = np.linalg.eigh(own * np.outer(sheet, sheet))
    root = sheet[:, None] * vectors / np.sqrt(1.0 + np.maximum(values, 0.0))
    return np.asarray(np.linalg.norm(sensitivity @ root, axis=1))


def bound_sd(information: FloatArray) -> FloatArray:
    """Return the Cramér-Rao standard deviations (q,) of an information matrix; inf where it says nothing."""
    diagonal = np.diag(information)
    if not np.all(diagonal > 0):
        return np.full(len(diagonal), np.inf)
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if values[0] <= SINGULAR * values[-1]:
        return np.full(len(diagonal), np.inf)
    return np.asarray(scale * np.sqrt(np.sum(vectors**2 / values, axis=1)))


def _run(A: FloatArray, pushed: FloatArray, start: FloatArray) -> FloatArray:
    """Return states (r, W, n) of r runs x(k+1) = A x(k) + pushed(k), pushed (r, W, n), from start (r, n).

    Each turn doubles from how many samples before a state it is summed.
    """
    states = np.concatenate([start[:, None], pushed[:, :-1]], axis=1)
    summed = 1
    while summed < states.shape[1]:
        states[:, summed:] += states[:, :-summed] @ A.T
        A, summed = A @ A, 2 * summed
    return states


def _free(A: FloatArray, C: FloatArray, count: int) -> FloatArray:
    """Return how outputs follow from each initial state, (n, W, p)."""
    n = len(A)
    return _run(A, np.zeros((n, count, n)), np.eye(n)) @ C.T


def _parameters(
    A: FloatArray, C: FloatArray, derivatives: tuple[FloatArray, ...], states: FloatArray, u: FloatArray
) -> FloatArray:
    """Return d y by each parameter (k, W, p)."""
    dA, dB, dC, dD = derivatives
    pushed = np.einsum("kij,wj->kwi", dA, states) + np.einsum("kij,wj->kwi", dB, u)
    moved = _run(A, pushed, np.zeros((len(dA), len(A)))) @ C.T
    return np.asarray(moved + np.einsum("kij,wj->kwi", dC, states) + np.einsum("kij,wj->kwi", dD, u))


def _sensor(rig: Rig, at: Sampled, constant: Constant, states: FloatArray, u: FloatArray) -> FloatArray:
    """Return d y (W, p) by the logarithm of a gain, or by the delay of the measured inputs in samples."""
    if constant.kind == "output":
        column = np.zeros((len(u), len(at.C)))
        column[:, constant.number] = states @ at.C[constant.number] + u @ at.D[constant.number]
        return column
    change = np.zeros_like(u)
    if constant.kind == "input":
        change[:, constant.number] = u[:, constant.number]
    else:
        change = np.where(rig.driven, -np.diff(u, axis=0, prepend=u[:1]), 0.0)
    return np.asarray(_run(at.A, (change @ at.B.T)[None], np.zeros((1, at.n)))[0] @ at.C.T + change @ at.D.T)


def _information(columns: FloatArray, free: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the information (k, k) of columns (k, W, p) with the initial state's (n, W, p) projected out."""
    psi = (columns / sigma).reshape(len(columns), -1).T
    gamma = (free / sigma).reshape(len(free), -1).T
    length = np.linalg.norm(gamma, axis=0)
    basis, size, _ = singular(gamma / np.where(length > 0, length, 1.0))
    basis = basis[:, size > SINGULAR * size[0]]
    for _ in range(2):  # the second time takes what round-off left of the first
        psi = psi - basis @ (basis.T @ psi)
    return np.asarray(psi.T @ psi)
