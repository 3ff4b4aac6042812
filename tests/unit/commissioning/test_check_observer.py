"""What `deltak check` says of an observer that changes nothing."""

import pytest

from agent.blocks.rig_model import rig_model
from agent.commissioning.advice import warnings
from tests.unit.config.config_texts import PRESS, changed, read, with_fake_driver

__all__ = ["with_fake_driver"]
POLES = 'gain = "poles", poles = [-40, -35, -30, -25]'


def said(*changes: tuple[str, str]) -> list[str]:
    config = read(changed(PRESS, *changes))
    return [
        w.message for w in warnings(config, rig_model(config), [], None) if w.path == "estimator.observer"
    ]


@pytest.mark.parametrize("observer", [POLES, 'gain = "kalman", process_sd = 0.1'])
def test_stated_gain_of_window_ml_is_taken_and_said_to_change_nothing(observer: str) -> None:
    (message,) = said(('gain = "auto"', observer))
    assert "changes nothing" in message


def test_process_sd_of_0_denies_unknown_forces_and_is_not_said_to_change_nothing() -> None:
    assert said(('gain = "auto"', 'gain = "kalman", process_sd = 0')) == []


def test_gain_found_by_itself_and_that_of_the_seed_are_not_remarked() -> None:
    assert said() == []
    assert said(('gain = "auto"', POLES), ('method = "window-ml"', 'method = "seed"')) == []
