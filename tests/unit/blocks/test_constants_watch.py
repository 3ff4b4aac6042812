"""Alarms of a sensor that is surely off for ten windows, however seldom a window is learnt from."""

import numpy as np
import pytest

from agent.blocks.constants_watch import ConstantsWatch
from agent.numerics.inference.verdicts import Belief
from agent.runtime.assembly.stages import make_stages
from tests.statistical.chains import TWO

WINDOW = 250


def changes(said: list[tuple[int, float]]) -> list[tuple[int, bool]]:
    """(window, whether it begins) of the alarms that (window, probability) of a sensor that is off raise."""
    watch = ConstantsWatch("rig", 1e-3, WINDOW, frozenset({"x1"}))
    found = []
    for window, probability in said:
        sample = window * WINDOW - 1
        off = Belief("x1", False, "output", probability, 0.05, 0.002)
        found += [(window, e.standing) for e in watch.step([(sample, (off,))], {sample: 0}).events]
    return found


def test_every_window_learnt_from_the_alarm_comes_with_the_tenth() -> None:
    assert changes([(window, 0.995) for window in range(1, 20)]) == [(10, True)]


@pytest.mark.parametrize("doubtful", [3, 11])
def test_a_window_that_is_less_sure_begins_the_count_anew(doubtful: int) -> None:
    said = [(window, 0.9 if window == doubtful else 0.995) for window in range(1, 30)]
    assert changes(said)[0] == (doubtful + 10 if doubtful < 10 else 10, True)


def test_few_windows_learnt_from_count_for_those_between_them() -> None:
    assert changes([(1, 0.5), (8, 0.995), (12, 0.995), (20, 0.995), (36, 0.995)]) == [(20, True)]
    assert changes([(40, 0.5), (72, 0.995), (136, 0.995)]) == [(136, True)]


def test_a_window_that_is_less_sure_raises_nothing_however_long_the_last_one_was_sure() -> None:
    assert changes([(8, 0.995), (20, 0.9), (24, 0.995)]) == []


def test_windows_are_those_of_the_configuration() -> None:
    stages = make_stages(TWO.configuration(), np.zeros(3))
    assert stages.constants.window == TWO.window


def test_an_alarm_ends_when_it_is_rather_not_believed() -> None:
    said = [(window, 0.995) for window in range(1, 12)] + [(12, 0.6), (13, 0.4)]
    assert changes(said) == [(10, True), (13, False)]
