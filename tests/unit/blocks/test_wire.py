"""What channels come in, by their configuration."""

import numpy as np
import pytest

from agent.blocks.rig_model import wire_of
from agent.config.model.tables import Channel


def test_values_are_as_they_came_but_for_the_sign_of_a_scale() -> None:
    load = Channel(name="load", quantity="force", at="m1", unit="kN", scale=0.5, offset=-2.0)
    stroke = Channel(name="x", quantity="displacement", at="m1", unit="mm", scale=-0.01, offset=3.0)
    wire = wire_of([load, stroke])
    readings = np.array([[12.5, 101.0], [-0.3, 7.0]])
    values = (readings * [0.5, -0.01] + [-2.0, 3.0]) * [1e3, 1e-3]
    assert wire.readings(values) == pytest.approx(readings * [1.0, -1.0])
    assert wire.part(slice(1, 2)).readings(values[:, 1:]) == pytest.approx(-readings[:, 1:])
