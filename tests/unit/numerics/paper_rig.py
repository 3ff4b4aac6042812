"""The paper's rig as the tests of its method need it: printed figures, written down here once more on
purpose."""

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure

FloatArray = NDArray[np.float64]
PERIOD = 1e-3
NOMINAL = np.array([25.0, 100.0, 5.0, 5.0])
GAIN = np.array(
    [[1.24028, -0.192081], [-0.192081, 1.24028], [0.0731667, -0.00744765], [-0.00744765, 0.0731667]]
)  # fmt: skip


def rig(theta: FloatArray = NOMINAL) -> MassSpringDamper:
    k1, k2, b1, b2 = theta.tolist()
    structure = Structure(
        (Mass("m1", 5.0), Mass("m2", 3.0)),
        (Element("k1", ("ground", "m1"), k1), Element("k2", ("m1", "m2"), k2)),
        (Element("B1", ("ground", "m1"), b1), Element("B2", ("m1", "m2"), b2)),
    )
    outputs = (Output("displacement", "m1"), Output("displacement", "m2"))
    return MassSpringDamper(structure, ("k1", "k2", "B1", "B2"), ("m2",), outputs)


def euler(theta: FloatArray) -> FloatArray:
    """The sampled matrix (23), typed out of the paper, independent of the product's model."""
    k1, k2, b1, b2 = theta.tolist()
    m1, m2, T = 5.0, 3.0, PERIOD
    return np.array([
        [1 - (b1 + b2) / m1 * T, b2 / m1 * T, -(k1 + k2) / m1 * T, k2 / m1 * T],
        [b2 / m2 * T, 1 - b2 / m2 * T, k2 / m2 * T, -k2 / m2 * T],
        [T, 0.0, 1.0, 0.0],
        [0.0, T, 0.0, 1.0],
    ])  # fmt: skip


def free_decay(theta: FloatArray, samples: int) -> tuple[FloatArray, FloatArray]:
    """States (N, 4) and displacements (N, 2) of the Euler rig released from 0.01 in every state."""
    A, x = euler(theta), np.full(4, 0.01)
    states = np.empty((samples, 4))
    for k in range(samples):
        states[k] = x
        x = A @ x
    return states, states[:, 2:]
