"""The search for unknown forces, where there is nothing to find."""

import numpy as np
import pytest

from agent.numerics.fitting import noise as room
from agent.numerics.fitting.noise import Record, find_process
from agent.numerics.model.observer import Gain
from tests.unit.numerics.paper_rig import rig
from tests.unit.numerics.rigs import disturbance, noisy, sampled


@pytest.mark.parametrize("known", [True, False])
def test_find_process_where_no_observer_is_stable_finds_nothing(known: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def unstable(*_given: object) -> Gain:
        raise ValueError("no stable observer")

    monkeypatch.setattr(room, "matched_gain", unstable)
    record = Record(noisy(np.random.default_rng(1), 200, 1e-6).v, np.zeros(4))
    assert find_process(sampled(), disturbance(rig()), np.full(2, 1e-6), record, scale_known=known) is None


def test_find_process_of_readings_that_are_no_numbers_finds_nothing() -> None:
    v = noisy(np.random.default_rng(1), 200, 1e-6).v
    v[:, 0] *= 1e200
    with np.errstate(over="ignore", invalid="ignore"):
        found = find_process(sampled(), disturbance(rig()), np.full(2, 1e-6), Record(v, np.zeros(4)), scale_known=True)
    assert found is None
