"""The jump-and-drift scene: the paper's rig and the jumps of its table 2, then a drift, under a measured
random force.

The equations of motion are written down here once more, so that nothing is compared with itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure

FloatArray = NDArray[np.float64]
PERIOD = 1e-3
NOMINAL = np.array([25.0, 100.0, 5.0, 5.0])
JUMPS = ((0, (25.0, 50.0, 0.0, 0.0)), (1000, (0.0, 0.0, -3.0, -3.0)), (2000, (50.0, -25.0, 0.0, 0.0)))
DRIFT_FROM, END = 3000, 6000
DRIFT = np.array([-5.0, 20.0, 1.0, -1.0])
"""Change over the drift, 20 % of nominal each: 6.7 % a second, fast for wear, slow against a window."""
STAIR = 10
"""Samples for which the drifting parameters stand still."""
WINDOW, HOP = 250, 50


@dataclass(frozen=True, slots=True)
class Record:
    """A played record: outputs with noise (N, 2), force (N, 1), parameters (N, 4) that hold from each sample
    on."""

    y: FloatArray
    u: FloatArray
    theta: FloatArray


def rig() -> MassSpringDamper:
    structure = Structure(
        (Mass("m1", 5.0), Mass("m2", 3.0)),
        (Element("k1", ("ground", "m1"), 25.0), Element("k2", ("m1", "m2"), 100.0)),
        (Element("B1", ("ground", "m1"), 5.0), Element("B2", ("m1", "m2"), 5.0)),
    )
    outputs = (Output("displacement", "m1"), Output("displacement", "m2"))
    return MassSpringDamper(structure, ("k1", "k2", "B1", "B2"), ("m2",), outputs)


def schedule() -> FloatArray:
    theta = np.empty((END, 4))
    for start, change in JUMPS:
        theta[start:] = NOMINAL + change
    steps = np.arange(END - DRIFT_FROM) // STAIR * STAIR / (END - DRIFT_FROM)
    theta[DRIFT_FROM:] += steps[:, None] * DRIFT
    return theta


def play(theta: FloatArray, sigma: float, rng: np.random.Generator) -> Record:
    """Play parameters (N, 4) under a random force of 5 N rms, straight between samples; exact in time."""
    u = rng.normal(scale=5.0, size=(len(theta), 1))
    step = _Steps()
    x, y = np.zeros(4), np.empty((len(theta), 2))
    for k in range(len(theta)):
        y[k] = x[2:]
        if k + 1 < len(theta):
            x = (step(theta[k]) @ np.concatenate([x, u[k], u[k + 1] - u[k]]))[:4]
    return Record(y + rng.normal(scale=sigma, size=y.shape), u, theta)


def two_pasts(
    theta: FloatArray, other: FloatArray, samples: int, window: int, sigma: float
) -> tuple[Record, Record]:
    """Two records of `samples`, the last `window` samples the same to the last bit, parameters `other` before
    them.

    The second past runs backwards in time from the state at which the window begins, so that it is one that
    the rig can have had.
    """
    one = play(np.tile(theta, (samples, 1)), 0.0, np.random.default_rng(3))
    rng, step, start = np.random.default_rng(4), _Steps(), samples - window
    x, y = _state_at(one, start), one.y.copy()
    u = np.vstack([rng.normal(scale=5.0, size=(start, 1)), one.u[start:]])
    for k in range(start - 1, -1, -1):
        whole = step(other)
        x = np.linalg.solve(whole[:4, :4], x - whole[:4, 4:] @ np.concatenate([u[k], u[k + 1] - u[k]]))
        y[k] = x[2:]
    noise = rng.normal(scale=sigma, size=y.shape)
    return Record(one.y + noise, one.u, one.theta), Record(y + noise, u, one.theta)


def _state_at(record: Record, sample: int) -> FloatArray:
    step, x = _Steps(), np.zeros(4)
    for k in range(sample):
        x = (step(record.theta[k]) @ np.concatenate([x, record.u[k], record.u[k + 1] - record.u[k]]))[:4]
    return x


class _Steps:
    """Transition matrices by parameters, each made once."""

    def __init__(self) -> None:
        self.known: dict[bytes, FloatArray] = {}

    def __call__(self, theta: FloatArray) -> FloatArray:
        key = theta.tobytes()
        if key not in self.known:
            self.known[key] = _step(theta)
        return self.known[key]


def _step(theta: FloatArray) -> FloatArray:
    """exp of the motion joined with a force f and its slope: (x, f, df) over one period."""
    k1, k2, b1, b2 = theta
    m1, m2 = 5.0, 3.0
    M = np.zeros((6, 6))
    M[0, :4] = [-(b1 + b2) / m1, b2 / m1, -(k1 + k2) / m1, k2 / m1]
    M[1, :5] = [b2 / m2, -b2 / m2, k2 / m2, -k2 / m2, 1 / m2]
    M[2, 0] = M[3, 1] = 1.0
    M *= PERIOD
    M[4, 5] = 1.0
    return expm(M)
