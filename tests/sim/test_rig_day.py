"""A rig-day at 1 kHz."""

import time

import numpy as np
import pytest

from sim_bus.rig.scenario import load_scenario
from sim_bus.rig.trajectory import Rig
from tests.sim.rigs import rig, ring_config

DAY = 86_400_000
PIECE = 65_536


@pytest.mark.soak
def test_rig_day_is_played_in_minutes_and_stays_sound() -> None:
    played, largest = 0, 0.0
    source = Rig(rig(ring_config(1)), load_scenario("steady", {}))
    begun = time.monotonic()
    while played < DAY:
        chunk = source.advance(min(PIECE, DAY - played))
        played += len(chunk)
        largest = max(largest, float(np.abs(chunk.states).max()))
    assert time.monotonic() - begun < 600.0
    assert 0.05 < largest < 1.0
