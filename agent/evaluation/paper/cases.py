"""The paper's rig, two cases and what it printed of them; samples are made anew, nothing else typed in."""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import Hold, discretise
from agent.types import FloatArray

PERIOD_S = 1e-3
MASS_1 = 5.0  # fixed by the paper: sampling period, s, and the first mass, kg
PARAMETERS = ("k1", "k2", "B1", "B2")
UNITS = ("N/m", "N/m", "N s/m", "N s/m")
NOMINAL = np.array([25.0, 100.0, 5.0, 5.0])
SEGMENT = 1000
"""Fixed by the paper: samples of each combination of table 2: samples of each combination of table 2."""
START = np.full(4, 0.01)
"""State at the first sample: both velocities (m/s) and displacements (m)."""
GAIN = np.array([
    [1.24028, -0.192081],
    [-0.192081, 1.24028],
    [0.0731667, -0.00744765],
    [-0.00744765, 0.0731667],
])  # fmt: skip
"""K_e as printed."""
ITERATIONS = 17
"""Fixed by the paper: what it needed for Z in its case 1: what the paper needed for Z in its case 1."""
COST, STEP = 4e-10, 1e-8
"""Fixed by the paper: the cost at the optimum and the last difference of Z, as printed for case 1: the cost
at the optimum and the last difference of Z, as printed for case 1."""
MATRIX = np.array([
    [2.49e-05, -1.66e-05, -0.0149, 0.0099],
    [-2.76e-05, 2.76e-05, 0.0166, -0.0166],
    [-5.26e-07, -5.62e-07, -9.27e-08, -1.01e-07],
    [-2.19e-07, -2.34e-07, -3.87e-08, -4.25e-08],
])  # fmt: skip
"""The estimated ΔA of case 1, as printed."""
OBSERVER_POLES = (-45.0, -40.0, -35.0, -30.0)
"""Fixed by the paper: where K_e is said to put them, 1/s: where K_e is said to put them, 1/s."""


@dataclass(frozen=True, slots=True)
class Combination:
    """One combination of changes: what was applied and what the paper's table gives for it, both (4,)."""

    actual: FloatArray
    published: FloatArray


CASE_2 = (
    Combination(np.array([25.0, 50.0, 0.0, 0.0]), np.array([24.86, 49.74, -0.04, -0.08])),
    Combination(np.array([0.0, 0.0, -3.0, -3.0]), np.array([-0.12, -0.29, -2.99, -2.99])),
    Combination(np.array([50.0, -25.0, 0.0, 0.0]), np.array([49.9, -24.91, -0.08, 0.04])),
)
"""Tables 2 and 3; case 1 (table 1) is the first of them."""


def rig() -> MassSpringDamper:
    """Return the model of (20)-(21) at its nominal parameters, with 1/m2 in B_c as (18) has it."""
    k1, k2, b1, b2 = NOMINAL.tolist()
    structure = Structure(
        (Mass("m1", MASS_1), Mass("m2", 3.0)),
        (Element("k1", ("ground", "m1"), k1), Element("k2", ("m1", "m2"), k2)),
        (Element("B1", ("ground", "m1"), b1), Element("B2", ("m1", "m2"), b2)),
    )
    return MassSpringDamper(
        structure, PARAMETERS, ("m2",), (Output("displacement", "m1"), Output("displacement", "m2"))
    )


def free_decay(changes: tuple[FloatArray, ...], hold: Hold) -> FloatArray:
    """Return displacements (N, 2) of the rig released at `START`, 1000 samples a change, states carried over.

    hold: "euler" for the paper's first-order model (23), anything else for the exact one (the force is zero).
    """
    model = rig()
    x = START.copy()
    outputs = np.empty((len(changes), SEGMENT, 2))
    for change, rows in zip(changes, outputs, strict=True):
        transition = discretise(model.continuous(NOMINAL + change), PERIOD_S, hold).model.A
        for row in rows:
            row[:] = x[2:]
            x = transition @ x
    return outputs.reshape(-1, 2)
