"""The start where motions are missing: responses without nominals come to the graph that made them."""

import numpy as np
import pytest

from agent.commissioning.numerics.motion.exact_response import refined
from agent.commissioning.numerics.motion.response import fitted, measured
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Quantity, Structure
from tests.statistical.unknown_machines import LETTERS, Sensors, machine, name, recorded


def model_of(seed: int, sensors: Sensors) -> tuple[MassSpringDamper, np.ndarray, dict[str, np.ndarray]]:
    """Return a chain whose springs and dampers are all 1, the true ones, and a recording by some sensors."""
    rng = np.random.default_rng(seed)
    one = machine(rng, 2)
    columns = recorded(one, rng, 1e-3, span_s=20.0, sensors=sensors)
    ends = [(i, (name(a), name(b))) for i, (a, b) in enumerate(one.ends, 1)]
    structure = Structure(
        tuple(Mass(f"m{i}", value) for i, value in enumerate(one.masses.tolist(), 1)),
        tuple(Element(f"k{i}", between, 1.0) for i, between in ends),
        tuple(Element(f"B{i}", between, 1.0) for i, between in ends),
    )
    kinds: dict[str, Quantity] = {"displacement": "displacement", "acceleration": "acceleration"}
    outputs = tuple(Output(kinds[quantity], f"m{node}") for quantity, node in sensors)
    forces = tuple(f"m{node}" for node in one.forces)
    return MassSpringDamper(structure, tuple(one.truth), forces, outputs), np.r_[one.k, one.B], columns


@pytest.mark.parametrize(
    "sensors",
    [(("displacement", 1),), (("acceleration", 1), ("acceleration", 2))],
    ids=["one displacement", "accelerometers"],
)
def test_start_without_the_other_displacement_is_near_the_truth(sensors: Sensors) -> None:
    model, truth, columns = model_of(7, sensors)
    period_s = float(columns["t"][1])
    y = np.array([columns[f"{LETTERS[quantity][0]}{node}"] for quantity, node in sensors]).T
    pieces, sigma = [(y, columns["f2"][:, None])], 1e-3 * y.std(axis=0)
    seen = measured(pieces, period_s, sigma, straight=True)
    rough = fitted(model, seen)
    minima = refined(model, pieces, period_s, sigma, rough, fastest=float(seen.omega[-1]), hold="first")
    assert minima[0].theta == pytest.approx(truth, rel=0.02)
    # short stretches smear what the whole record does not
    assert np.abs(rough[0] / truth - 1).max() > 2 * np.abs(minima[0].theta / truth - 1).max()
